//! What the messages in a file say, understood through the schemas that stand in that file.

use bustape::frame::{CanFlags, CanFrame};
use prost_reflect::{DescriptorPool, DynamicMessage, Kind, ReflectMessage as _, Value};
use serde_json::{Value as Json, json};

use super::mcap::{Mcap, Message};

/// Something that happened on a bus.
#[derive(Clone, Debug, PartialEq)]
pub enum Raw {
    Can(CanFrame),
    Rx(Vec<u8>),
    Tx(Vec<u8>),
    /// How many, and the reason as the schema numbers it.
    Gap(u64, i32),
}

/// `Gap.Reason` of `schemas/bustape/gap.proto`.
pub const RECORDER_QUEUE: i32 = 2;
pub const LINK_DOWN: i32 = 3;
pub const DISK: i32 = 6;

/// Decodes every message of a file. Panics on one that its own schema does not describe.
#[allow(clippy::disallowed_methods, reason = "what the recorder writes has to please any reader")]
pub fn decoded(mcap: &Mcap) -> impl Iterator<Item = (&Message, DynamicMessage)> {
    let kinds = mcap.schemas.iter().map(|(id, (name, encoding, data))| {
        assert_eq!(encoding, "protobuf");
        // Fails unless the set has every file that it refers to.
        let pool = DescriptorPool::decode(&data[..]).unwrap_or_else(|e| panic!("{name}: {e}"));
        (
            *id,
            pool.get_message_by_name(name).unwrap_or_else(|| panic!("{name} is not in its schema")),
        )
    });
    let kinds: std::collections::BTreeMap<_, _> = kinds.collect();
    mcap.messages.iter().map(move |message| {
        let kind = kinds[&mcap.channels[&message.channel].schema].clone();
        let decoded = DynamicMessage::decode(kind, &message.data[..]).expect("a sound message");
        assert_eq!(decoded.unknown_fields().count(), 0, "{decoded} has fields without a name");
        (message, decoded)
    })
}

/// What is on `/<bus>/raw` and `/<bus>/gaps`, in time order; equal times as in the file.
pub fn raw(mcap: &Mcap, bus: &str) -> Vec<(u64, Raw)> {
    let (raw, gaps) = (format!("/{bus}/raw"), format!("/{bus}/gaps"));
    let mut all = Vec::new();
    for (message, decoded) in decoded(mcap) {
        let topic = mcap.topic(message);
        if topic != raw && topic != gaps {
            continue;
        }
        let time = message.time;
        match decoded.descriptor().full_name() {
            "bustape.CanFrame" => all.push((time, Raw::Can(can_frame(&decoded)))),
            "bustape.CanBatch" => {
                all.extend(can_batch(time, &decoded).map(|(time, can)| (time, Raw::Can(can))));
            }
            "bustape.SerialBytes" => {
                let data = bytes(&decoded, "data");
                let raw = match number(&decoded, "direction") {
                    1 => Raw::Rx(data),
                    2 => Raw::Tx(data),
                    other => panic!("direction {other}"),
                };
                all.push((time, raw));
            }
            "bustape.Gap" => {
                let reason = number(&decoded, "reason") as i32;
                all.push((time, Raw::Gap(number(&decoded, "count"), reason)));
            }
            other => panic!("{other} on {topic}"),
        }
    }
    all.sort_by_key(|(time, _)| *time);
    all
}

/// The CAN frames of a bus.
pub fn cans(mcap: &Mcap, bus: &str) -> Vec<(u64, CanFrame)> {
    let raw = raw(mcap, bus).into_iter();
    raw.filter_map(|(time, raw)| if let Raw::Can(can) = raw { Some((time, can)) } else { None })
        .collect()
}

/// All bytes of a bus: from the device, and to it.
pub fn streams(mcap: &Mcap, bus: &str) -> (Vec<u8>, Vec<u8>) {
    let (mut rx, mut tx) = (Vec::new(), Vec::new());
    for (_, raw) in raw(mcap, bus) {
        match raw {
            Raw::Rx(data) => rx.extend(data),
            Raw::Tx(data) => tx.extend(data),
            Raw::Can(_) | Raw::Gap(..) => {}
        }
    }
    (rx, tx)
}

/// The gaps of a bus: how many, and why.
pub fn gaps(mcap: &Mcap, bus: &str) -> Vec<(u64, i32)> {
    let raw = raw(mcap, bus).into_iter();
    raw.filter_map(|(_, raw)| if let Raw::Gap(n, why) = raw { Some((n, why)) } else { None })
        .collect()
}

fn can_frame(message: &DynamicMessage) -> CanFrame {
    let mut flags = CanFlags::default();
    let names = ["extended", "remote", "error", "fd", "brs", "esi", "tx"];
    for (bit, name) in names.into_iter().enumerate() {
        if message.get_field_by_name(name).and_then(|v| v.as_bool()) == Some(true) {
            flags |= CanFlags(1 << bit);
        }
    }
    CanFrame::new(number(message, "id") as u32, flags, &bytes(message, "data"))
        .with_dlc(number(message, "dlc") as u8)
}

/// The rule that `schemas/bustape/can_batch.proto` tells.
fn can_batch(log_time: u64, batch: &DynamicMessage) -> impl Iterator<Item = (u64, CanFrame)> {
    let list = |name| batch.get_field_by_name(name).unwrap().as_list().unwrap().to_vec();
    let (tick, count) = (number(batch, "tick_ns"), number(batch, "count") as usize);
    let deltas: Vec<u64> = list("delta").iter().map(|v| v.as_u64().unwrap()).collect();
    let kind: Vec<usize> = list("kind").iter().map(|v| v.as_u32().unwrap() as usize).collect();
    let kinds: Vec<DynamicMessage> =
        list("kinds").iter().map(|v| v.as_message().unwrap().clone()).collect();
    assert_eq!((deltas.len(), kind.len()), (count, count));
    let mut data = &bytes(batch, "data")[..];
    let mut payloads: Vec<Vec<Vec<u8>>> = Vec::new();
    for (index, of) in kinds.iter().enumerate() {
        let frames = kind.iter().filter(|k| **k == index).count();
        let mut rows = vec![Vec::new(); frames];
        for _ in 0..number(of, "length") {
            let (column, rest) = data.split_at(frames);
            rows.iter_mut().zip(column).for_each(|(row, byte)| row.push(*byte));
            data = rest;
        }
        rows.reverse();
        payloads.push(rows);
    }
    assert!(data.is_empty(), "{} bytes of no frame", data.len());
    let mut time = log_time;
    (0..count).map(move |i| {
        time += deltas[i] * tick;
        let of = &kinds[kind[i]];
        let payload = payloads[kind[i]].pop().unwrap();
        let flags = CanFlags(number(of, "flags") as u8);
        let frame = CanFrame::new(number(of, "id") as u32, flags, &payload);
        (time, frame.with_dlc(number(of, "dlc") as u8))
    })
}

fn number(message: &DynamicMessage, name: &str) -> u64 {
    match message.get_field_by_name(name).as_deref() {
        Some(Value::U32(n)) => u64::from(*n),
        Some(Value::U64(n)) => *n,
        Some(Value::EnumNumber(n)) => *n as u64,
        other => panic!("{name} of {message} is {other:?}"),
    }
}

fn bytes(message: &DynamicMessage, name: &str) -> Vec<u8> {
    message.get_field_by_name(name).unwrap().as_bytes().unwrap().to_vec()
}

/// A message as `tests/lab/read_mcap.py` prints it.
pub fn as_python(message: &DynamicMessage) -> Json {
    let kind = message.descriptor();
    let fields = kind.fields().filter_map(|field| {
        if field.supports_presence() && !message.has_field(&field) {
            return None;
        }
        let value = message.get_field(&field);
        let json = match value.as_list() {
            Some(list) => list.iter().map(|v| value_json(v, &field.kind())).collect(),
            None => value_json(&value, &field.kind()),
        };
        Some((field.name().to_owned(), json))
    });
    Json::Object(fields.collect())
}

fn value_json(value: &Value, kind: &Kind) -> Json {
    match value {
        Value::Bool(v) => json!(v),
        Value::I32(v) | Value::EnumNumber(v) => json!(v),
        Value::I64(v) => json!(v),
        Value::U32(v) => json!(v),
        Value::U64(v) => json!(v),
        Value::F64(v) => json!(v),
        Value::String(v) => json!(v),
        Value::Bytes(v) => json!(hex(v)),
        Value::Message(v) => as_python(v),
        other => panic!("{kind:?} {other:?}"),
    }
}

/// Lower case, without blanks.
pub fn hex(bytes: &[u8]) -> String {
    let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
    digits.map(|digit| char::from_digit(digit.into(), 16).expect("below 16")).collect()
}
