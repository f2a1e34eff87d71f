//! An explained frame as a JSON object.

use serde_json::{Map, Value as Json, json};

use super::can::Explained;
use crate::decode::can::{Check, Value};
use crate::frame::{CanFlags, CanFrame};
use crate::protocol::json::digits;
use crate::text::{printable_json, rfc3339};

/// One line.
pub fn text(explained: &Explained<'_>) -> String {
    let Explained { line, found, remote, direction, readings } = explained;
    let (mut signals, mut labels, mut absent) = (Map::new(), Map::new(), Vec::new());
    let message = found.map(|found| found.message);
    for (signal, reading) in message.iter().flat_map(|m| &m.signals).zip(*readings) {
        let Some(reading) = reading else {
            absent.push(signal.name.as_str());
            continue;
        };
        signals.insert(signal.name.clone(), number(reading.value));
        if let Some(label) = signal.label(reading.raw) {
            labels.insert(signal.name.clone(), json!(label));
        }
    }
    let (frame, has) = (&line.frame, |flag| line.frame.flags.has(flag));
    let mut value = json!({
        "time": line.time.map(|time| rfc3339(time.stamp())),
        "bus": line.bus,
        "id": identifier(frame),
        "ext": has(CanFlags::EXTENDED),
        "rtr": has(CanFlags::REMOTE),
        "message": message.map(|message| &message.name).or(remote.map(|remote| &remote.name)),
        "dir": direction,
        // A remote frame has no data that could be short or long.
        "check": found.map(|found| found.check).or(remote.map(|_| Check::Exact)).map(Check::name),
        "signals": signals,
        "labels": labels,
        "absent": absent,
        "extra": digits(found.map(|found| found.extra(frame)).unwrap_or_default()),
        "data": digits(frame.data()),
    });
    if has(CanFlags::ERROR) {
        value["error"] = json!(true);
    }
    if let Some(id) = found.and_then(|found| found.j1939) {
        value["pgn"] = json!(id.pgn);
        value["source"] = json!(id.source);
        value["destination"] = json!(id.destination);
    }
    format!("{}\n", printable_json(&value.to_string()))
}

fn number(value: Value) -> Json {
    match value {
        Value::Unsigned(number) => json!(number),
        Value::Signed(number) => json!(number),
        Value::Float(number) => float(number),
    }
}

/// JSON has no NaN and no infinity; they are texts, as in protobuf's JSON.
pub fn float(number: f64) -> Json {
    match number {
        number if number.is_nan() => json!("NaN"),
        f64::INFINITY => json!("Infinity"),
        f64::NEG_INFINITY => json!("-Infinity"),
        number => json!(number),
    }
}

/// `0x` and 8 hex digits for 29 bits, 3 for 11.
fn identifier(frame: &CanFrame) -> String {
    let short = !frame.flags.has(CanFlags::EXTENDED) && !frame.flags.has(CanFlags::ERROR);
    if short { format!("0x{:03X}", frame.id) } else { format!("0x{:08X}", frame.id) }
}
