//! The bus as a recorder would see it.

use std::collections::{BTreeMap, BTreeSet};

use super::*;

const DAY_A_MINUTE: f64 = 1440.0;

fn record(seed: u64, time_scale: f64, seconds: u64) -> Vec<(u64, CanFrame)> {
    HmiCan::new(seed, time_scale).take_while(|(time, _)| *time < seconds * 1_000_000_000).collect()
}

/// Identifier, size and period (ms) of every state packet (HMI CAN protocol, sections 4.1 and
/// question 22).
#[rustfmt::skip]
const STATE: &[(u32, usize, u64)] = &[
    (0x01_0001, 5, 1000), (0x02_0001, 8, 1000),
    (0x03_0001, 7, 500), (0x03_0002, 8, 500), (0x03_0003, 8, 500), (0x03_0004, 8, 500),
    (0x03_0005, 8, 500), (0x03_0006, 8, 500), (0x03_0007, 4, 500),
    (0x04_0001, 7, 500), (0x04_0002, 8, 500), (0x04_0003, 8, 500), (0x04_0004, 4, 500),
    (0x04_0005, 8, 500), (0x04_0006, 8, 500),
    (0x06_0001, 6, 1000), (0x07_0001, 8, 250), (0x07_0002, 8, 250), (0x08_0001, 8, 250),
    (0x08_0002, 8, 250), (0x09_0001, 3, 500), (0x0A_0001, 8, 500), (0x0A_0002, 6, 500),
    (0x0B_0001, 5, 500), (0x0B_0002, 8, 500), (0x0C_0001, 8, 3000), (0x0C_0002, 8, 3000),
    (0x0C_0003, 5, 3000), (0x0D_0001, 4, 1000),
];

#[test]
fn every_state_packet_comes_with_its_size_and_period() {
    let frames = record(3, 1.0, 60);
    for (id, size, period) in STATE {
        let times: Vec<u64> = frames
            .iter()
            .filter(|(_, f)| f.id == *id)
            .inspect(|(_, f)| assert_eq!(f.data().len(), *size, "{id:06X}"))
            .map(|(time, _)| *time / 1000)
            .collect();
        // The discrete inputs also come when they change.
        if *id == 0x01_0001 {
            assert!(times.len() >= 60);
            continue;
        }
        assert_eq!(times.len() as u64, 60_000 / period, "{id:06X}");
        for pair in times.windows(2) {
            let off = (pair[1] - pair[0]).abs_diff(period * 1000);
            assert!(off < 25_000, "{id:06X} off by {off} µs");
        }
    }
}

#[test]
fn jitter_is_that_of_a_controller_and_does_not_add_up() {
    let frames = record(3, 1.0, 600);
    let times: Vec<u64> =
        frames.iter().filter(|(_, f)| f.id == 0x02_0001).map(|(time, _)| *time).collect();
    let first = times[0];
    let late: Vec<i64> = (0..)
        .zip(&times)
        .map(|(i, time)| *time as i64 - (first as i64 + i * 1_000_000_000))
        .collect();
    assert!(late.iter().all(|l| l.abs() < 25_000_000), "{late:?}");
    assert!(late.iter().any(|l| l.abs() > 50_000), "no jitter at all");
}

#[test]
fn the_bus_carries_sixty_to_a_hundred_extended_frames_a_second_in_order() {
    for scale in [1.0, DAY_A_MINUTE] {
        let frames = record(11, scale, 60);
        let rate = frames.len() as f64 / 60.0;
        assert!((58.0..100.0).contains(&rate), "{rate} frames/s at scale {scale}");
        assert!(frames.windows(2).all(|pair| pair[0].0 < pair[1].0), "two frames at once");
        for (_, frame) in &frames {
            assert!(frame.flags == CanFlags::EXTENDED || frame.id == 0x13_0000, "{frame:?}");
            assert!(frame.data().len() <= 8 && frame.id < 0x15_0000);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_frames_and_another_seed_others() {
    assert_eq!(record(1, DAY_A_MINUTE, 20), record(1, DAY_A_MINUTE, 20));
    assert_ne!(record(1, DAY_A_MINUTE, 20), record(2, DAY_A_MINUTE, 20));
}

/// What is checked of the events is their place; the names are those of section 9, EVENT.
#[test]
fn every_kind_of_traffic_of_the_protocol_appears() {
    let mut seen: BTreeMap<u32, usize> = BTreeMap::new();
    for seed in 0..4 {
        for (_, frame) in record(seed, DAY_A_MINUTE, 240) {
            *seen.entry(frame.id).or_default() += 1;
        }
    }
    let expected = [
        0x02_0000, 0x06_0000, 0x0B_0000, 0x0D_0000, 0x11_0000, 0x11_0001, 0x12_0000, 0x12_0001,
        0x12_0002, 0x13_0000, 0x13_0001, 0x13_000F, 0x13_00FF, 0x13_0100, 0x13_0101, 0x13_0400,
        0x14_0500, 0x14_0600, 0x14_0700, 0x14_0800, 0x14_0900, 0x14_0B00,
    ];
    let missing: BTreeSet<u32> = expected.into_iter().filter(|id| !seen.contains_key(id)).collect();
    assert!(missing.is_empty(), "{missing:06X?}");
}

#[test]
fn the_settings_follow_their_request_in_one_run() {
    let frames = record(1, 1.0, 20);
    let config: Vec<&CanFrame> =
        frames.iter().map(|(_, f)| f).filter(|f| f.id >> 16 == 0x13).collect();
    assert!(config[0].flags.has(CanFlags::REMOTE), "{:?}", config[0]);
    let ids: Vec<u32> = config[1..16].iter().map(|f| f.id).collect();
    assert_eq!(ids, (0x13_0001..=0x13_000F).collect::<Vec<u32>>());
}

#[test]
fn numbers_on_the_bus_are_those_of_the_station() {
    let mut bus = HmiCan::new(4, DAY_A_MINUTE);
    let mut checked = 0;
    for _ in 0..2000 {
        let Some((_, frame)) = bus.next() else { panic!("the bus ended") };
        if frame.id != 0x03_0002 {
            continue;
        }
        let f32_at =
            |at: usize| f64::from(f32::from_le_bytes(frame.data()[at..at + 4].try_into().unwrap()));
        let (volts, amperes) = (f32_at(0), f32_at(4));
        assert!((20.5..30.0).contains(&volts), "{volts} V");
        assert!((-170.0..90.0).contains(&amperes), "{amperes} A");
        // The station may have moved on by a moment while the frame waited for the wire.
        assert!((volts - bus.station().monitor().voltage()).abs() < 1.5);
        checked += 1;
    }
    assert!(checked > 20);
}

#[test]
fn the_flags_of_the_transfer_switch_say_what_feeds_the_loads() {
    let mut supplies = BTreeSet::new();
    for seed in 0..6 {
        for (_, frame) in record(seed, DAY_A_MINUTE, 300) {
            if frame.id == 0x09_0001 {
                let [flags, ..] = frame.data() else { panic!("empty") };
                supplies.insert(flags >> 3 & 3);
                assert_eq!(flags & 1, 1, "connected");
            }
        }
    }
    assert!(supplies.contains(&1) && supplies.contains(&3), "{supplies:?}");
}
