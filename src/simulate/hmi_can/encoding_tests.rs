//! Every bit of the state packets, read back with a reader that is first checked against sample
//! vectors of the protocol.

use super::controller::Controls;
use super::state::{self, GROUPS};
use super::*;
use crate::simulate::station::generator::Stage;

/// `length` bits from bit `start`, least significant first (the DBC "Intel" way).
fn bits(data: &[u8], start: usize, length: usize) -> u64 {
    (0..length).fold(0, |value, i| {
        let at = start + i;
        value | u64::from(data[at / 8] >> (at % 8) & 1) << i
    })
}

fn float(data: &[u8], start: usize) -> f64 {
    f64::from(f32::from_bits(bits(data, start, 32) as u32))
}

#[test]
fn the_reader_of_these_tests_reads_the_sample_vectors() {
    let ports = [0x0f, 0x18, 0x44, 0xed, 0xc2];
    assert_eq!((bits(&ports, 3, 2), bits(&ports, 8, 32)), (1, 3_270_329_368));
    let mppt = [0x1e, 0x02, 0x23, 0x7e, 0x71, 0x7c, 0xed];
    let read = [(0, 1), (4, 1), (8, 8), (16, 8), (24, 16), (40, 16)];
    assert_eq!(read.map(|(s, l)| bits(&mppt, s, l)), [0, 1, 2, 35, 29_054, 60_796]);
    let inv = [0x67, 0x07, 0x01, 0x6d, 0x9f, 0x40, 0xdb, 0x35];
    let read = [(0, 1), (1, 3), (4, 4), (8, 8), (16, 8), (24, 16), (40, 16), (56, 8)];
    assert_eq!(read.map(|(s, l)| bits(&inv, s, l)), [1, 3, 6, 7, 1, 40_813, 56_128, 53]);
    let charger = [0x17, 0x2c, 0xf4, 0xc2, 0xc1, 0x00];
    assert_eq!((bits(&charger, 3, 2), float(&charger, 8)), (2, -24.369_224_548_339_844));
    let tracker = [0x01, 0x32, 0xd6, 0x01, 0x50];
    assert_eq!([(8, 16), (24, 16)].map(|(s, l)| bits(&tracker, s, l)), [54_834, 20_481]);
    let clock = [0x10, 0x08, 0xe4, 0x07, 0x02, 0x14, 0x18, 0x1b];
    let read = [(0, 8), (8, 8), (16, 16), (32, 8), (40, 8), (48, 8), (56, 8)];
    assert_eq!(read.map(|(s, l)| bits(&clock, s, l)), [16, 8, 2020, 2, 20, 24, 27]);
}

const VOLUME: u8 = 7;

fn data(station: &Station, device: u8, number: u8) -> Vec<u8> {
    let packets = GROUPS.iter().flat_map(|group| group.packets);
    let packet = packets.into_iter().find(|p| (p.device, p.number) == (device, number));
    let controls = Controls { volume: VOLUME, ..Controls::default() };
    (packet.expect("no such packet").encode)(station, controls)
}

/// A station at some moment, after `hours`.
fn station(seed: u64, hours: f64) -> Station {
    let mut station = Station::new(seed, orders(&Settings::default()));
    station.advance(hours * 3600.0);
    station
}

/// Integers: (device, packet, start bit, length, value).
fn integers(s: &Station) -> Vec<(u8, u8, usize, usize, u64)> {
    let round = |x: f64| x.round() as u64;
    let now = s.date_time();
    let mut all = vec![
        (1, 1, 1, 1, 1),
        (1, 1, 3, 2, 0),
        (1, 1, 8 + 23, 1, u64::from(s.transfer().supply() as u8 == 1)),
        (1, 1, 8 + 29, 1, u64::from(s.charger().powered())),
        (2, 1, 0, 8, now.day() as u64),
        (2, 1, 8, 8, now.month() as u64),
        (2, 1, 16, 16, now.year() as u64),
        (2, 1, 32, 8, now.weekday().to_sunday_zero_offset() as u64),
        (2, 1, 40, 8, now.hour() as u64),
        (2, 1, 48, 8, now.minute() as u64),
        (2, 1, 56, 8, now.second() as u64),
        (3, 1, 0, 1, 1),
        (3, 1, 1, 1, u64::from(s.monitor().alarm())),
        (3, 1, 8, 16, round(s.monitor().minutes_to_go(s.battery())).min(65_535)),
        (3, 1, 24, 16, u64::from(s.monitor().history.cycles)),
        (3, 1, 40, 16, u64::from(s.monitor().history.full_discharges)),
        (3, 7, 0, 16, (s.monitor().history.since_full / 86_400.0) as u64),
        (3, 7, 16, 16, u64::from(s.monitor().history.low_alarms)),
        (4, 1, 0, 3, 7),
        (4, 1, 3, 1, u64::from(s.solar().connected())),
        (4, 1, 8, 8, s.solar().mode() as u64),
        (4, 1, 16, 8, round(s.battery().soc() * 100.0)),
        (4, 1, 24, 16, (s.solar().seconds().1 / 60.0) as u64),
        (4, 1, 40, 16, (s.solar().seconds().0 / 60.0) as u64),
        (4, 5, 0, 32, s.solar().today().0 as u64),
        (4, 5, 32, 32, s.solar().today().1 as u64),
        (6, 1, 0, 1, u64::from(s.charger().powered())),
        (6, 1, 1, 1, 1),
        (6, 1, 2, 1, u64::from(s.charger().ended())),
        (6, 1, 3, 2, if s.charger().on() { 2 } else { 0 }),
        (6, 1, 40, 8, 0),
        (9, 1, 0, 1, 1),
        (9, 1, 1, 1, u64::from(s.mains().present())),
        (9, 1, 2, 1, u64::from(s.generator().running())),
        (9, 1, 3, 2, s.transfer().supply() as u64),
        (9, 1, 8, 16, round(s.transfer().seconds_left())),
        (0xA, 1, 0, 3, 3),
        (0xA, 1, 20, 4, 3),
        (0xB, 1, 0, 2, 3),
        (0xB, 1, 2, 1, u64::from(s.tracker().moving)),
        (0xB, 1, 24, 16, s.tracker().worked as u64 % 65_536),
        (0xB, 2, 0, 16, round(s.tracker().vertical)),
        (0xB, 2, 16, 16, round(s.tracker().horizontal)),
        (0xB, 2, 32, 16, round(s.tracker().saved.0 * 3.2)),
        (0xB, 2, 48, 16, round(s.tracker().saved.1 * 3.2)),
        (0xC, 3, 32, 8, 0),
        (0xD, 1, 0, 8, 1),
        (0xD, 1, 24, 8, u64::from(VOLUME)),
    ];
    all.extend(generator(s.generator().stage()).into_iter().map(|(p, b, l, v)| (0xA, p, b, l, v)));
    for (device, inverter) in [7, 8].into_iter().zip(s.inverters()) {
        all.extend([
            (device, 1, 0, 1, u64::from(inverter.contactor())),
            (device, 1, 1, 3, inverter.mode() as u64),
            (device, 1, 4, 4, u64::from(inverter.cycle_step())),
            (device, 1, 8, 8, 0),
            (device, 1, 24, 16, round(inverter.ac_voltage())),
            (device, 1, 40, 16, round(inverter.reading().0)),
            (device, 1, 56, 8, round(inverter.reading().1)),
        ]);
    }
    all
}

/// What GEN_1 and GEN_2 say in `stage`: (packet, start bit, length, value).
fn generator(stage: Stage) -> Vec<(u8, usize, usize, u64)> {
    match stage {
        Stage::Off => vec![(1, 8, 4, 4), (1, 32, 16, 65_535)],
        Stage::Waiting(left) => vec![(1, 8, 4, 4), (2, 0, 16, left.round() as u64)],
        Stage::Starting(attempt, _) => {
            vec![(1, 8, 4, 1), (1, 12, 4, 10), (1, 16, 4, u64::from(attempt))]
        }
        Stage::Running(run, left) => {
            vec![(1, 8, 4, 2), (1, 32, 16, run.round() as u64), (1, 48, 16, left.round() as u64)]
        }
        Stage::Stopping(_, left) => vec![(1, 8, 4, 2), (2, 16, 16, left.round() as u64)],
        Stage::Resting(left) => vec![(1, 8, 4, 3), (2, 32, 16, left.round() as u64)],
    }
}

/// Floats: (device, packet, start bit, value).
fn floats(s: &Station) -> Vec<(u8, u8, usize, f64)> {
    let history = s.monitor().history;
    vec![
        (3, 2, 0, s.monitor().voltage()),
        (3, 2, 32, s.monitor().current()),
        (3, 3, 32, s.monitor().soc(s.battery())),
        (3, 4, 0, history.deepest),
        (3, 4, 32, history.last),
        (3, 5, 0, history.average),
        (3, 5, 32, history.drawn),
        (3, 6, 0, history.lowest),
        (3, 6, 32, history.highest),
        (4, 2, 0, s.solar().voltage()),
        (4, 2, 32, s.solar().panel_current()),
        (4, 3, 0, s.solar().out_voltage()),
        (4, 3, 32, s.solar().current()),
        (4, 4, 0, s.battery().current()),
        (4, 6, 0, s.battery().temperature()),
        (4, 6, 32, s.solar().temperature()),
        (6, 1, 8, s.charger().current()),
        (7, 2, 32, s.inverters()[0].temperature()),
        (8, 2, 32, s.inverters()[1].temperature()),
        (0xC, 1, 0, s.day().sunrise),
        (0xC, 1, 32, s.day().sunset),
        (0xC, 2, 0, 90.0 - s.sun().elevation),
        (0xC, 2, 32, s.sun().azimuth),
        (0xC, 3, 0, s.day().duration()),
    ]
}

/// By night and by day, with mains, without, charging, and with the generator in every stage
/// that lasts.
fn moments() -> Vec<Station> {
    let mut moments: Vec<Station> =
        (0..40).map(|i| station(i % 5, 0.5 + 6.37 * i as f64)).collect();
    let mut stages = Vec::new();
    // A seed whose generator is needed on the first night.
    let mut station = station(13, 0.0);
    for _ in 0..4 * 86_400 / 5 {
        station.advance(5.0);
        let stage = std::mem::discriminant(&station.generator().stage());
        if !stages.contains(&stage) {
            stages.push(stage);
            moments.push(station.clone());
        }
    }
    assert!(stages.len() >= 4, "the generator was in {} stages only", stages.len());
    moments
}

#[test]
fn every_field_stands_at_its_documented_bits() {
    for station in moments() {
        let at = station.date_time();
        for (device, packet, start, length, value) in integers(&station) {
            let data = data(&station, device, packet);
            let read = bits(&data, start, length);
            assert_eq!(read, value, "{device:02X}/{packet} bit {start} at {at}: {data:02X?}");
        }
        for (device, packet, start, value) in floats(&station) {
            let data = data(&station, device, packet);
            let read = float(&data, start);
            assert_eq!(read, f64::from(value as f32), "{device:02X}/{packet} bit {start} at {at}");
        }
        assert_eq!(data(&station, device::PORTS, 1), state::ports(&station));
    }
}
