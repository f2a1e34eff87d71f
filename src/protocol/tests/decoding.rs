//! Rules of decoding that the sample vectors do not show, and other protocols than theirs.

use std::sync::Arc;

use proptest::prelude::*;
use serde_json::{Value, json};

use crate::frame::{Direction, Timestamp};
use crate::protocol::crc::Checksum;
use crate::protocol::{Decoder, Protocol, Settings, json};

fn decoder(definition: &str) -> Decoder {
    let protocol = Protocol::parse("test.toml", definition, Settings::default());
    Decoder::new(Arc::new(protocol.unwrap()))
}

fn zhongheng() -> Decoder {
    let protocol = Protocol::built_in("zhongheng-09", Settings::default());
    Decoder::new(Arc::new(protocol.unwrap().unwrap()))
}

fn items(decoder: &mut Decoder, way: Direction, bytes: &[u8]) -> Vec<Value> {
    let mut items = Vec::new();
    decoder.feed(way, Timestamp(0), bytes, &mut |item| items.push(json::item(&item)));
    items
}

/// A Zhongheng frame, escaped as little as possible.
fn wire(address: u16, control: u8, data: &[u8]) -> Vec<u8> {
    let mut frame = vec![0x7E, (address >> 8) as u8, address as u8, control, data.len() as u8];
    frame.extend(data);
    let crc = Checksum::by_name("CRC_16_XMODEM").unwrap().of(&frame);
    frame.extend((crc as u16).to_be_bytes());
    let escaped = frame[1..].iter().flat_map(|byte| match byte {
        0x7D | 0x7E => vec![0x7D, byte ^ 0x20],
        _ => vec![*byte],
    });
    std::iter::once(0x7E).chain(escaped).collect()
}

fn messages(frames: &[(u16, u8, &[u8])]) -> Vec<Value> {
    let mut decoder = zhongheng();
    let bytes: Vec<u8> =
        frames.iter().flat_map(|(address, control, data)| wire(*address, *control, data)).collect();
    let items = items(&mut decoder, Direction::Rx, &bytes);
    items.into_iter().map(|mut item| item["message"].take()).collect()
}

#[test]
fn a_set_without_the_set_bit_is_known_by_its_data() {
    let found = messages(&[(9, 0x45, &[0, 0xB9, 0, 0, 0, 7, 2]), (9, 0x85, &[0])]);
    assert_eq!((&found[0]["op"], &found[0]["ct_missing"]), (&json!("set"), &json!(true)));
    assert_eq!(found[0]["fields"][0]["value"], 7);
    assert_eq!((&found[1]["op"], &found[1]["check"]), (&json!("set"), &json!("exact")));
    let partial = &messages(&[(9, 0x45, &[0, 0xB9, 0, 0])])[0];
    assert_eq!((&partial["op"], &partial["check"]), (&json!("read"), &json!("long")));
    assert_eq!(partial.get("ct_missing"), None);
}

#[test]
fn a_request_too_short_empties_its_slot_and_an_answer_too_short_is_paired() {
    let found = messages(&[
        (9, 0x45, &[0x40, 0xEF]),
        (9, 0x65, &[0x40]),
        (9, 0x85, &[]),
        (9, 0x45, &[0x40, 0xEF]),
        (9, 0x85, &[]),
    ]);
    assert_eq!(found[1], json!({"kind": "malformed", "reason": "request_too_short"}));
    let short = |paired: bool| json!({"kind": "malformed", "reason": "response_too_short", "paired": paired});
    assert_eq!((&found[2], &found[4]), (&short(false), &short(true)));
}

#[test]
fn an_answer_with_the_other_sequence_bit_leaves_its_request_waiting() {
    let found = messages(&[(9, 0x45, &[0, 0]), (9, 0xA5, &[0, 0x13]), (9, 0x85, &[0, 0x13])]);
    assert_eq!((&found[1]["paired"], &found[1]["reason"]), (&json!(false), &json!("sequence")));
    assert_eq!(found[1]["extra"], "13");
    assert_eq!(
        (&found[2]["paired"], &found[2]["fields"][0]["label"]),
        (&json!(true), &json!("SC100"))
    );
    // A response answers no link frame; other replies answer anything.
    let found = messages(&[(9, 0x40, &[0]), (9, 0x85, &[0]), (9, 0x86, &[0xFF])]);
    assert_eq!((&found[1]["reason"], &found[2]["paired"]), (&json!("no_request"), &json!(true)));
}

#[test]
fn records_beyond_the_limit_are_extra_and_floats_that_are_no_numbers_pass() {
    let cells = [&[0][..], &[0x7F, 0xC0, 0, 0].repeat(49)].concat();
    let found = &messages(&[(9, 0x45, &[1, 0xA9]), (9, 0x85, &cells)])[1];
    assert_eq!((found["fields"].as_array().unwrap().len(), &found["check"]), (48, &json!("long")));
    assert_eq!(
        (&found["fields"][47]["value"], &found["extra"]),
        (&json!("NaN"), &json!("7fc00000"))
    );
    let none = &messages(&[(9, 0x45, &[1, 0xA9]), (9, 0x85, &[0])])[1];
    assert_eq!(none["check"], "short");
}

#[test]
fn both_numbers_of_the_alarm_list_are_decoded() {
    let alarms = [&[0][..], &[5; 80]].concat();
    for number in [0x4B, 0x4F] {
        let found = &messages(&[(9, 0x45, &[0x41, number]), (9, 0x85, &alarms)])[1];
        assert_eq!((&found["cmd"], &found["check"]), (&json!("warn_infor"), &json!("exact")));
        assert_eq!(found["fields"][79]["label"], "none");
    }
}

#[test]
fn after_a_loss_no_answer_is_given_to_an_old_request() {
    let mut decoder = zhongheng();
    items(&mut decoder, Direction::Rx, &wire(9, 0x45, &[0, 0]));
    decoder.finish(&mut |_| {});
    let found = items(&mut decoder, Direction::Rx, &wire(9, 0x85, &[0, 0x13]));
    assert_eq!(found[0]["message"]["reason"], "no_request");
}

#[test]
fn assumed_values_are_used_only_when_asked_for() {
    for (settings, label) in [("", None), ("assume=true", Some("enable"))] {
        let protocol = Protocol::built_in("zhongheng-09", Settings::parse(settings).unwrap());
        let mut decoder = Decoder::new(Arc::new(protocol.unwrap().unwrap()));
        let set = wire(9, 0x45, &[0x82, 0x8C, 0x14]);
        let found = items(&mut decoder, Direction::Rx, &set);
        assert_eq!(found[0]["message"]["fields"][0].get("label").and_then(Value::as_str), label);
    }
}

/// The example of docs/protocols-serial.md.
fn example() -> String {
    let page = include_str!("../../../docs/protocols-serial.md");
    let (_, rest) = page.split_once("```toml\n# meter.toml").unwrap();
    rest.split_once("```").unwrap().0.to_owned()
}

#[test]
fn the_example_of_the_documentation_decodes_as_the_page_says() {
    let mut decoder = decoder(&example());
    // Read holding registers of meter 17; its answer; a refusal.
    let ask = [0x11, 0x03, 0x00, 0x00, 0x00, 0x03];
    let answer = [0x11, 0x03, 0x06, 0x09, 0x1D, 0xFF, 0x9C, 0x00, 0x05];
    let refusal = [0x11, 0x83, 0x02];
    let mut found = Vec::new();
    let frames = [
        (Direction::Tx, &ask[..]),
        (Direction::Rx, &answer),
        (Direction::Tx, &ask),
        (Direction::Rx, &refusal),
    ];
    for (number, (way, frame)) in frames.into_iter().enumerate() {
        let crc = Checksum::by_name("CRC_16_MODBUS").unwrap().of(frame) as u16;
        let bytes = [frame, &crc.to_le_bytes()].concat();
        let mut take =
            |item: crate::protocol::Item| found.push(json::item(&item)["message"].take());
        decoder.feed(way, Timestamp(number as u64 * 10_000_000), &bytes, &mut take);
    }
    decoder.finish(&mut |item| found.push(json::item(&item)["message"].take()));
    assert_eq!(found[0]["args"], json!({"first_register": 0, "registers": 3}));
    let fields = found[1]["fields"].as_array().unwrap();
    assert_eq!((&fields[0]["name"], &fields[0]["scaled"]), (&json!("byte_count"), &Value::Null));
    assert!((fields[1]["scaled"].as_f64().unwrap() - 233.3).abs() < 1e-9);
    assert_eq!(
        (&fields[2]["value"], &fields[3]["flags"]),
        (&json!(-100), &json!(["closed", "remote"]))
    );
    assert_eq!((&found[3]["check"], &found[3]["extra"]), (&json!("long"), &json!("02")));
}

proptest! {
    #[test]
    fn no_bytes_make_the_decoder_panic(
        frames in prop::collection::vec(
            (any::<u16>(), any::<u8>(), prop::collection::vec(any::<u8>(), 0..255)), 0..8),
        noise in prop::collection::vec(any::<u8>(), 0..300),
    ) {
        let mut decoder = zhongheng();
        let mut bytes = noise;
        for (address, control, data) in &frames {
            bytes.extend(wire(*address, *control, data));
        }
        let found = items(&mut decoder, Direction::Rx, &bytes);
        let good = found.iter().filter(|item| item["item"] == "frame").count();
        prop_assert!(good >= frames.len(), "{good} of {} frames", frames.len());
    }
}
