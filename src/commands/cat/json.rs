//! Entries of a recording as JSON objects, one a line.

use std::collections::HashMap;

use prost_reflect::{DynamicMessage, MessageDescriptor, SerializeOptions};
use serde_json::{Value, json};

use crate::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes, Stamped};
use crate::recording::descriptor;
use crate::recording::reader::{Entry, Recording};
use crate::recording::segment::Segment;
use crate::text::{hex, printable_json, rfc3339};

/// Decodes messages of any schema that a recording holds.
pub struct Messages<'a> {
    /// By schema name and data, which say everything about a type.
    types: HashMap<(&'a str, &'a [u8]), MessageDescriptor>,
}

impl<'a> Messages<'a> {
    /// The types of a recording.
    pub fn new(recording: &'a Recording) -> Self {
        let mut types = HashMap::new();
        for schema in recording.segments.iter().flat_map(|s| s.schemas.values()) {
            let key = (schema.name.as_str(), schema.data.as_slice());
            if schema.encoding != "protobuf" || types.contains_key(&key) {
                continue;
            }
            let pool = descriptor::types(&schema.data);
            if let Some(found) = pool.and_then(|pool| pool.get_message_by_name(&schema.name)) {
                types.insert(key, found);
            }
        }
        Self { types }
    }

    /// A message as JSON; as hex where its type is not known.
    pub fn decode(&self, segment: &Segment, channel: u16, data: &[u8]) -> Value {
        let schema = segment.channels.get(&channel).and_then(|c| segment.schemas.get(&c.schema));
        let found = schema.and_then(|s| self.types.get(&(s.name.as_str(), s.data.as_slice())));
        let message = found.and_then(|kind| DynamicMessage::decode(kind.clone(), data).ok());
        // Names as in the schema; numbers as numbers, also those of 64 bits.
        let options = SerializeOptions::new()
            .use_proto_field_name(true)
            .stringify_64_bit_integers(false)
            .skip_default_fields(false);
        message
            .and_then(|m| m.serialize_with_options(serde_json::value::Serializer, &options).ok())
            .unwrap_or_else(|| json!({ "hex": to_hex(data) }))
    }
}

/// Appends an entry as one line.
pub fn put(
    out: &mut Vec<u8>,
    recording: &Recording,
    messages: &Messages<'_>,
    entry: &Stamped<Entry>,
) {
    let time = rfc3339(entry.time);
    let value = match &entry.value {
        Entry::Frame(bus, frame) => {
            let mut value = frame_value(frame);
            value["time"] = json!(time);
            value["time_ns"] = json!(entry.time.nanos());
            value["bus"] = json!(recording.buses[*bus]);
            value
        }
        Entry::Message { segment, channel, data } => {
            let segment = &recording.segments[*segment];
            let topic = segment.channels.get(channel).map(|c| c.topic.as_str());
            let message = messages.decode(segment, *channel, data);
            json!({
                "type": "message",
                "time": time,
                "time_ns": entry.time.nanos(),
                "topic": topic,
                "message": message,
            })
        }
    };
    out.extend_from_slice(printable_json(&value.to_string()).as_bytes());
    out.push(b'\n');
}

fn frame_value(frame: &Frame) -> Value {
    match frame {
        Frame::Can(frame) => can_value(frame),
        Frame::Serial(bytes) => serial_value(bytes),
        Frame::Gap(gap) => json!({
            "type": "gap",
            "count": gap.count,
            "unit": gap.unit.name(),
            "reason": gap.reason.name(),
            "from": rfc3339(gap.from),
            "to": rfc3339(gap.to),
        }),
        Frame::Notice(notice) => json!({ "type": "notice", "text": notice.text }),
    }
}

fn can_value(frame: &CanFrame) -> Value {
    let has = |flag| frame.flags.has(flag);
    let mut value = json!({
        "type": "can",
        "id": frame.id,
        "ext": has(CanFlags::EXTENDED),
        "rtr": has(CanFlags::REMOTE),
        "error": has(CanFlags::ERROR),
        "fd": has(CanFlags::FD),
        "brs": has(CanFlags::BRS),
        "esi": has(CanFlags::ESI),
        "dir": if has(CanFlags::TX) { "tx" } else { "rx" },
        "data": to_hex(frame.data()),
    });
    if frame.dlc != 0 {
        value["dlc"] = json!(frame.dlc);
    }
    value
}

fn serial_value(bytes: &SerialBytes) -> Value {
    let direction = match bytes.direction {
        Direction::Rx => "rx",
        Direction::Tx => "tx",
    };
    let mut value = json!({ "type": "serial", "dir": direction, "data": to_hex(&bytes.data) });
    if !bytes.errors.is_empty() {
        let errors = bytes.errors.iter();
        let errors = errors.map(|e| json!({ "offset": e.offset, "kind": hex::name(e.kind) }));
        value["errors"] = errors.collect();
    }
    value
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        for digit in [byte >> 4, byte & 15] {
            text.push(char::from_digit(u32::from(digit), 16).unwrap_or('?'));
        }
        text
    })
}
