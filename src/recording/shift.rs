//! All times of a recording moved by one amount, so that no interval changes.

use std::collections::{BTreeMap, BTreeSet};

use prost::Message as _;
use prost_reflect::{DynamicMessage, Kind, MessageDescriptor, Value};

use super::definition::Facts;
use super::descriptor;
use super::records::{Channel, Schema};
use super::rewrite::Change;
use super::schema::bustape::Gap;

/// Where a message record has its two times.
const LOG_TIME: std::ops::Range<usize> = 6..14;
const PUBLISH_TIME: std::ops::Range<usize> = 14..22;
/// Where its payload begins.
const PAYLOAD: usize = 22;
/// The type that times inside of messages have.
const TIMESTAMP: &str = "google.protobuf.Timestamp";
/// How deep messages are looked into.
const DEPTH: usize = 8;

/// Moves all times by `nanos`.
pub struct Shift {
    nanos: i64,
    told: Facts,
    /// What the messages of each channel have in them.
    kinds: BTreeMap<u16, Times>,
}

/// Times inside of a message.
enum Times {
    None,
    /// `bustape.Gap`: from and to.
    Gap,
    /// Fields of type `google.protobuf.Timestamp`.
    Timestamps(MessageDescriptor),
}

impl Shift {
    /// `told` becomes the metadata record `bustape.retime`.
    pub fn new(nanos: i64, told: Facts) -> Self {
        Self { nanos, told, kinds: BTreeMap::new() }
    }

    fn moved(&self, nanos: u64) -> u64 {
        // 0 stands for "unknown" wherever there are times, and times may not become it.
        if nanos == 0 { 0 } else { nanos.saturating_add_signed(self.nanos).max(1) }
    }

    fn in_record(&self, body: &mut [u8], place: std::ops::Range<usize>) {
        let Some(bytes) = body.get_mut(place) else { return };
        let Ok(time) = <[u8; 8]>::try_from(&*bytes) else { return };
        bytes.copy_from_slice(&self.moved(u64::from_le_bytes(time)).to_le_bytes());
    }

    fn in_gap(&self, payload: &[u8]) -> Option<Vec<u8>> {
        let mut gap = Gap::decode(payload).ok()?;
        (gap.from_ns, gap.to_ns) = (self.moved(gap.from_ns), self.moved(gap.to_ns));
        Some(gap.encode_to_vec())
    }

    fn in_timestamps(&self, kind: &MessageDescriptor, payload: &[u8]) -> Option<Vec<u8>> {
        let mut message = DynamicMessage::decode(kind.clone(), payload).ok()?;
        self.in_message(&mut message, DEPTH);
        Some(message.encode_to_vec())
    }

    fn in_message(&self, message: &mut DynamicMessage, depth: usize) {
        use prost_reflect::ReflectMessage as _;
        if message.descriptor().full_name() == TIMESTAMP {
            return self.in_timestamp(message);
        }
        let fields: Vec<_> = message.descriptor().fields().collect();
        for field in &fields {
            let messages = matches!(field.kind(), Kind::Message(_)) && !field.is_map();
            if depth == 0 || !messages || !message.has_field(field) {
                continue;
            }
            match message.get_field_mut(field) {
                Value::Message(inner) => self.in_message(inner, depth - 1),
                Value::List(list) => list.iter_mut().for_each(|value| {
                    if let Value::Message(inner) = value {
                        self.in_message(inner, depth - 1);
                    }
                }),
                _ => {}
            }
        }
    }

    fn in_timestamp(&self, message: &mut DynamicMessage) {
        let number = |name: &str| match message.get_field_by_name(name).as_deref() {
            Some(Value::I64(value)) => *value,
            Some(Value::I32(value)) => i64::from(*value),
            _ => 0,
        };
        let nanos = i128::from(number("seconds")) * 1_000_000_000 + i128::from(number("nanos"));
        let Ok(nanos) = u64::try_from(nanos) else { return };
        let moved = self.moved(nanos);
        let seconds = i64::try_from(moved / 1_000_000_000).unwrap_or(i64::MAX);
        let nanos = i32::try_from(moved % 1_000_000_000).unwrap_or(0);
        message.set_field_by_name("seconds", Value::I64(seconds));
        message.set_field_by_name("nanos", Value::I32(nanos));
    }
}

impl Change for Shift {
    fn message(&mut self, channel: &Channel, schema: Option<&Schema>, body: &mut Vec<u8>) {
        self.in_record(body, LOG_TIME);
        self.in_record(body, PUBLISH_TIME);
        let kind = self.kinds.entry(channel.id).or_insert_with(|| times_of(schema));
        let changed = match std::mem::replace(kind, Times::None) {
            Times::None => return,
            kind => {
                let payload = body.get(PAYLOAD..).unwrap_or_default();
                let changed = match &kind {
                    Times::None => None,
                    Times::Gap => self.in_gap(payload),
                    Times::Timestamps(descriptor) => self.in_timestamps(descriptor, payload),
                };
                self.kinds.insert(channel.id, kind);
                changed
            }
        };
        if let Some(changed) = changed {
            body.truncate(PAYLOAD);
            body.extend_from_slice(&changed);
        }
    }

    fn metadata(&mut self, name: &str, facts: &mut Facts) {
        // What the clocks said stays; where that stands on the timeline is moved with it.
        let keys: &[&str] = match name {
            "bustape.clock" => &["log_time_ns"],
            "bustape.window" => &["fired_ns", "from_ns"],
            "bustape.summary" => &["window_from_ns", "window_to_ns"],
            _ => return,
        };
        for key in keys {
            if let Some(time) = facts.get_mut(*key)
                && let Ok(nanos) = time.parse()
            {
                *time = self.moved(nanos).to_string();
            }
        }
    }

    fn time(&self, nanos: u64) -> u64 {
        self.moved(nanos)
    }

    fn told(&self) -> (&'static str, Facts) {
        ("bustape.retime", self.told.clone())
    }
}

/// What times the messages of a schema have in them.
fn times_of(schema: Option<&Schema>) -> Times {
    let Some(schema) = schema.filter(|schema| schema.encoding == "protobuf") else {
        return Times::None;
    };
    if schema.name == "bustape.Gap" {
        return Times::Gap;
    }
    let pool = descriptor::types(&schema.data);
    let kind = pool.and_then(|pool| pool.get_message_by_name(&schema.name));
    kind.filter(|kind| has_timestamp(kind, &mut BTreeSet::new()))
        .map_or(Times::None, Times::Timestamps)
}

/// True if there can be one anywhere in a message. `seen` keeps types that contain themselves from
/// taking forever.
fn has_timestamp(kind: &MessageDescriptor, seen: &mut BTreeSet<String>) -> bool {
    kind.full_name() == TIMESTAMP
        || seen.insert(kind.full_name().to_owned())
            && kind.fields().any(|field| match field.kind() {
                Kind::Message(inner) => has_timestamp(&inner, seen),
                _ => false,
            })
}
