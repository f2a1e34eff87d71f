//! An explained frame for a person.

use super::super::output;
use super::can::Explained;
use crate::decode::can::{Check, Match, Reading, Value};
use crate::decode::dbc::{Number, Signal};
use crate::decode::j1939::Identifier;
use crate::frame::{CanFlags, CanFrame};
use crate::protocol::json::digits;
use crate::text::{printable, rfc3339};

/// A line for the frame and one for each signal.
pub fn text(explained: &Explained<'_>) -> String {
    let line = explained.line;
    let mut head = Vec::new();
    head.extend(line.time.map(|time| rfc3339(time.stamp())));
    head.extend(line.bus.map(printable));
    let mut frame = Vec::new();
    crate::text::candump::put(&mut frame, &line.frame);
    head.push(String::from_utf8_lossy(&frame).into_owned());
    if let Some(remote) = explained.remote {
        let direction = explained.direction.as_deref().map(|d| format!("  {}", printable(d)));
        let (head, direction) = (head.join(" "), direction.unwrap_or_default());
        return format!("{head}  {}{direction}  remote frame\n", printable(&remote.name));
    }
    let Some(found) = explained.found else {
        return format!("{}  {}\n", head.join(" "), unknown(&line.frame));
    };
    let mut facts = vec![head.join(" "), printable(&found.message.name)];
    facts.extend(explained.direction.as_deref().map(printable));
    facts.extend(found.j1939.map(addresses));
    if found.check != Check::Exact {
        let (declared, received) = (found.message.length, line.frame.data().len());
        facts.push(format!("{}: {received} of {declared} bytes", found.check.name()));
    }
    let extra = digits(found.extra(&line.frame));
    let extra = if extra.is_empty() { extra } else { format!("  extra: {extra}\n") };
    format!("{}\n{}{extra}", facts.join("  "), signals(found, explained.readings))
}

fn unknown(frame: &CanFrame) -> &'static str {
    if frame.flags.has(CanFlags::REMOTE) {
        "remote frame, carries no data"
    } else if frame.flags.has(CanFlags::ERROR) {
        "error frame"
    } else {
        "unknown"
    }
}

fn addresses(id: Identifier) -> String {
    let to = id.destination.map_or("all".to_owned(), |address| format!("{address:02X}"));
    format!("PGN {} ({:05X}) from {:02X} to {to}", id.pgn, id.pgn, id.source)
}

fn signals(found: &Match<'_>, readings: &[Option<Reading>]) -> String {
    let (mut rows, mut absent) = (Vec::new(), Vec::new());
    for (signal, reading) in found.message.signals.iter().zip(readings) {
        match reading {
            Some(reading) => rows.push(row(signal, reading)),
            None => absent.push(signal.name.as_str()),
        }
    }
    let table = if rows.is_empty() { String::new() } else { output::table(&[], &[1], rows) };
    if absent.is_empty() {
        return table;
    }
    format!("{table}  absent: {}\n", printable(&absent.join(", ")))
}

fn row(signal: &Signal, reading: &Reading) -> Vec<String> {
    let label = signal.label(reading.raw).unwrap_or_default().to_owned();
    vec![format!(" {}", signal.name), number(signal, reading.value), signal.unit.clone(), label]
}

/// A value with as many digits as it has: 7 of a 32-bit float, 15 of others.
fn number(signal: &Signal, value: Value) -> String {
    match value {
        Value::Unsigned(number) => number.to_string(),
        Value::Signed(number) => number.to_string(),
        Value::Float(number) if !number.is_finite() => number.to_string(),
        Value::Float(number) => {
            let digits = if signal.number == Number::Float32 { 6 } else { 14 };
            // Rounded by way of its text; what is printed is the shortest that means the same.
            let rounded: f64 = format!("{number:.digits$e}").parse().unwrap_or(number);
            rounded.to_string()
        }
    }
}
