//! Every message of the protocol comes, and means what it should.

use std::collections::{BTreeMap, BTreeSet};

use super::*;
use crate::decode::can::{CanDecoder, Check, Value};
use crate::decode::{dbc, protocol::HMI_CAN};

const DAY_A_MINUTE: f64 = 1440.0;

fn decoder() -> CanDecoder {
    CanDecoder::new(dbc::parse(HMI_CAN.as_bytes()).unwrap().database, false)
}

/// The last packet of a MODBUS structure carries only what is left (section 6).
fn may_be_short(frame: &CanFrame) -> bool {
    let [packet, _, device, _] = frame.id.to_le_bytes();
    matches!(device, device::MODBUS_REQ | device::MODBUS_ANS) && packet > 0
}

#[test]
fn a_quarter_of_an_hour_brings_every_message_of_both_controllers_and_all_of_it_decodes() {
    let decoder = decoder();
    let mut seen: BTreeMap<&str, u32> = BTreeMap::new();
    let (mut requests, mut values) = (0, BTreeMap::<(&str, usize), BTreeSet<u64>>::new());
    let bus = HmiCan::new(13, DAY_A_MINUTE);
    for (_, frame) in bus.take_while(|(time, _)| *time < 900 * 1_000_000_000) {
        if frame.flags.has(CanFlags::REMOTE) {
            requests += 1;
            continue;
        }
        let found = decoder.find(&frame).unwrap_or_else(|| panic!("unknown {frame:?}"));
        let name = found.message.name.as_str();
        assert!(found.check == Check::Exact || may_be_short(&frame), "{name} {frame:?}");
        *seen.entry(name).or_default() += 1;
        found.decode(&frame, |reading| {
            let signal = &found.message.signals[reading.signal];
            let number = match reading.value {
                Value::Unsigned(number) => number as f64,
                Value::Signed(number) => number as f64,
                Value::Float(number) => number,
            };
            assert!(number.is_finite(), "{name}.{} is {number}", signal.name);
            let bounded = (signal.min, signal.max) != (0.0, 0.0);
            let inside = (signal.min..=signal.max).contains(&number);
            assert!(!bounded || inside, "{name}.{} is {number}", signal.name);
            // Message 0 of the tracker means something else than the table says (section 4.4).
            let labelled = signal.labels.is_some() && name != "LOG_TRC";
            assert!(!labelled || signal.label(reading.raw).is_some(), "{name}.{}", signal.name);
            values.entry((name, reading.signal)).or_default().insert(reading.raw);
        });
    }
    let all: BTreeSet<&str> =
        decoder.database().messages.iter().map(|message| message.name.as_str()).collect();
    let missing: Vec<_> = all.iter().filter(|name| !seen.contains_key(*name)).collect();
    assert!(missing.is_empty() && all.len() == 170, "never seen: {missing:?}");
    assert!(requests > 3, "the settings were asked for {requests} times");
    // What is measured moves.
    for (name, least) in [
        ("BATMON_2", 200),
        ("BATMON_3", 200),
        ("MPPT_2", 200),
        ("CHARGER_1", 2),
        ("INV2_2", 20),
        ("SPA_2", 200),
        ("GEN_1", 2),
        ("CFG_DELAY_START_TS", 2),
    ] {
        let most = values.iter().filter(|((n, _), _)| *n == name).map(|(_, v)| v.len()).max();
        assert!(most >= Some(least), "{name}: {most:?} values");
    }
}

#[test]
fn each_controller_alone_sends_its_messages_only() {
    let decoder = decoder();
    for (role, sender) in [(Role::Controller, "ctrl"), (Role::Hmi, "hmi")] {
        let mut bus = HmiCan::new(2, DAY_A_MINUTE).with_role(role);
        for _ in 0..4000 {
            let (_, frames) = bus.step();
            for frame in frames.iter().filter(|frame| !frame.flags.has(CanFlags::REMOTE)) {
                let found = decoder.find(frame).unwrap();
                // One identifier is used in both directions (section 3).
                let both = found.message.name == "CONFIG_1";
                assert!(both || found.message.senders == [sender], "{role:?} {frame:?}");
            }
        }
    }
}

#[test]
fn a_controller_alone_answers_what_it_hears() {
    let mut bus = HmiCan::new(2, 1.0).with_role(Role::Controller);
    let read_out = |bus: &mut HmiCan| {
        let sent = (0..200).flat_map(|_| bus.step().1).filter(|frame| frame.id >> 16 == 0x13);
        sent.collect::<Vec<CanFrame>>()
    };
    assert_eq!(read_out(&mut bus), []);
    let (now, _) = bus.step();
    bus.hear(now, &frame(device::CONFIG, 0x28, 0, &[99, 0]));
    bus.hear(now, &settings::request());
    let read = read_out(&mut bus);
    assert_eq!((read.len(), &read[6].data()[5..]), (15, &[99, 0][..]));
}
