//! The built-in database against frames of the device protocol.

use serde_json::{Value as Json, json};

use super::super::can::{CanDecoder, Value};
use super::super::protocol::HMI_CAN;
use super::parse;
use crate::frame::{CanFlags, CanFrame};

const FRAMES: &str = include_str!("../../../tests/data/hmi-can-frames.json");

fn bytes(hex: &str) -> Vec<u8> {
    let pairs = hex.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn number(value: Value) -> Json {
    match value {
        Value::Unsigned(number) => json!(number),
        Value::Signed(number) => json!(number),
        Value::Float(number) => json!(number),
    }
}

/// The JSON parser is off by one unit in the last place for some numbers.
fn same(a: &Json, b: &Json) -> bool {
    let (a, b) = (a.as_object().unwrap(), b.as_object().unwrap());
    let near = |a: &Json, b: &Json| {
        let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
        (a - b).abs() <= a.abs() * f64::EPSILON
    };
    a.len() == b.len() && a.iter().all(|(name, a)| b.get(name).is_some_and(|b| near(a, b)))
}

#[test]
fn the_built_in_database_has_no_oddities_and_knows_every_identifier_once() {
    let parsed = parse(HMI_CAN);
    assert_eq!(parsed.oddities.list(), []);
    assert_eq!(parsed.database.messages.len(), 170);
    assert!(parsed.database.messages.iter().all(|message| message.extended));
}

#[test]
fn frames_of_the_station_decode_as_its_protocol_says() {
    let decoder = CanDecoder::new(parse(HMI_CAN).database, false);
    let expected: Vec<Json> = serde_json::from_str(FRAMES).unwrap();
    assert!(expected.len() > 40);
    for expected in expected {
        let id = u32::from_str_radix(&expected["id"].as_str().unwrap()[2..], 16).unwrap();
        let rtr = if expected["rtr"] == true { CanFlags::REMOTE } else { CanFlags::default() };
        let data = bytes(expected["data"].as_str().unwrap());
        let frame = CanFrame::new(id, CanFlags::EXTENDED | rtr, &data);
        let Some(found) = decoder.find(&frame) else {
            assert_eq!(expected["message"], Json::Null);
            continue;
        };
        assert_eq!(expected["message"], found.message.name);
        assert_eq!(expected["check"], found.check.name(), "{id:08X}");
        let nodes = &decoder.database().nodes;
        assert_eq!(expected["dir"], json!(found.message.direction(nodes)), "{id:08X}");
        assert_eq!(bytes(expected["extra"].as_str().unwrap()), found.extra(&frame));
        let (mut signals, mut labels) = (json!({}), json!({}));
        found.decode(&frame, |reading| {
            let signal = &found.message.signals[reading.signal];
            signals[&signal.name] = number(reading.value);
            if let Some(label) = signal.label(reading.raw) {
                labels[&signal.name] = json!(label);
            }
        });
        assert!(same(&expected["signals"], &signals), "{id:08X} {signals}");
        if !expected["labels"].is_null() {
            assert_eq!(expected["labels"], labels, "{id:08X}");
        }
    }
}
