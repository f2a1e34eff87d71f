//! A decoded CAN frame, for a person or as JSON.

use std::io::{BufWriter, StdoutLock, Write as _};

use anyhow::Result;
use serde_json::{Map, Value as Json, json};

use super::super::{cat, output};
use super::candump::{self, Line};
use crate::decode::can::{CanDecoder, Match, Reading, Value};
use crate::decode::dbc::{Message, Number, Signal};
use crate::frame::{CanFlags, CanFrame};
use crate::text::{printable, rfc3339};

/// Prints what frames mean.
pub struct Explainer {
    decoder: CanDecoder,
    json: bool,
    /// By index of the signal; used again for each frame.
    found: Vec<Option<Reading>>,
    skipped: usize,
    /// Where the results go.
    pub out: BufWriter<StdoutLock<'static>>,
}

impl Explainer {
    /// Decodes with `decoder`.
    pub fn new(decoder: CanDecoder, json: bool) -> Self {
        Self { decoder, json, found: Vec::new(), skipped: 0, out: output::stdout() }
    }

    /// Explains one line of candump's; the inner error says why it is none.
    pub fn line(&mut self, text: &str) -> Result<Result<(), String>> {
        let line = match candump::line(text) {
            Ok(line) => line,
            Err(why) => return Ok(Err(why)),
        };
        let found = self.decoder.find(&line.frame);
        self.found.clear();
        if let Some(found) = &found {
            self.found.resize(found.message.signals.len(), None);
            found.decode(&line.frame, |reading| self.found[reading.signal] = Some(reading));
        }
        let text = if self.json {
            json_text(&self.decoder, &line, found.as_ref(), &self.found)
        } else {
            plain_text(&self.decoder, &line, found.as_ref(), &self.found)
        };
        self.out.write_all(text.as_bytes())?;
        Ok(Ok(()))
    }

    /// Counts a line that is no frame; says so for the first ones.
    pub fn skip(&mut self, why: &str) {
        self.skipped += 1;
        if self.skipped <= super::SAID {
            output::warning(why);
        }
    }

    /// Writes what is left. True if lines were skipped.
    pub fn finish(mut self) -> Result<bool> {
        self.out.flush()?;
        if self.skipped > super::SAID {
            output::warning(&format!("{} lines were no frames", self.skipped));
        }
        Ok(self.skipped > 0)
    }
}

fn direction(decoder: &CanDecoder, line: &Line<'_>, message: Option<&Message>) -> Option<String> {
    let said = || if line.frame.flags.has(CanFlags::TX) { "tx" } else { "rx" };
    message
        .and_then(|message| message.direction(&decoder.database().nodes))
        .or_else(|| line.has_direction.then(|| said().to_owned()))
}

fn json_text(
    decoder: &CanDecoder,
    line: &Line<'_>,
    found: Option<&Match<'_>>,
    readings: &[Option<Reading>],
) -> String {
    let (mut signals, mut labels, mut absent) = (Map::new(), Map::new(), Vec::new());
    let message = found.map(|found| found.message);
    for (signal, reading) in message.iter().flat_map(|m| &m.signals).zip(readings) {
        match reading {
            Some(reading) => {
                signals.insert(signal.name.clone(), json_number(reading.value));
                if let Some(label) = signal.label(reading.raw) {
                    labels.insert(signal.name.clone(), json!(label));
                }
            }
            None => absent.push(signal.name.as_str()),
        }
    }
    let (frame, has) = (&line.frame, |flag| line.frame.flags.has(flag));
    let mut value = json!({
        "time": line.time.map(rfc3339),
        "bus": line.bus,
        "id": identifier(frame),
        "ext": has(CanFlags::EXTENDED),
        "rtr": has(CanFlags::REMOTE),
        "message": message.map(|message| &message.name),
        "dir": direction(decoder, line, message),
        "check": found.map(|found| found.check.name()),
        "signals": signals,
        "labels": labels,
        "absent": absent,
        "extra": hex(found.map(|found| found.extra(frame)).unwrap_or_default()),
        "data": hex(frame.data()),
    });
    if has(CanFlags::ERROR) {
        value["error"] = json!(true);
    }
    if let Some(id) = found.and_then(|found| found.j1939) {
        value["pgn"] = json!(id.pgn);
        value["source"] = json!(id.source);
        value["destination"] = json!(id.destination);
    }
    format!("{value}\n")
}

fn plain_text(
    decoder: &CanDecoder,
    line: &Line<'_>,
    found: Option<&Match<'_>>,
    readings: &[Option<Reading>],
) -> String {
    let mut text = line.time.map(|time| format!("{} ", rfc3339(time))).unwrap_or_default();
    text.extend(line.bus.map(|bus| format!("{} ", printable(bus))));
    let mut frame = Vec::new();
    cat::candump::put(&mut frame, &line.frame);
    text.push_str(&String::from_utf8_lossy(&frame));
    let Some(found) = found else {
        text.push_str(match &line.frame {
            frame if frame.flags.has(CanFlags::REMOTE) => "  remote frame, carries no data\n",
            frame if frame.flags.has(CanFlags::ERROR) => "  error frame\n",
            _ => "  unknown\n",
        });
        return text;
    };
    text.push_str(&format!("  {}", printable(&found.message.name)));
    if let Some(way) = direction(decoder, line, Some(found.message)) {
        text.push_str(&format!("  {}", printable(&way)));
    }
    if let Some(id) = found.j1939 {
        let to = id.destination.map_or("all".to_owned(), |address| format!("{address:02X}"));
        text.push_str(&format!("  PGN {} ({:05X}) from {:02X} to {to}", id.pgn, id.pgn, id.source));
    }
    let (declared, received) = (found.message.length, line.frame.data().len());
    match found.check.name() {
        "exact" => {}
        check => text.push_str(&format!("  {check}: {received} of {declared} bytes")),
    }
    text.push('\n');
    let signals = found.message.signals.iter().zip(readings);
    let present = |reading: &Option<Reading>| reading.is_some();
    let rows = signals.clone().filter_map(|(signal, reading)| Some(row(signal, reading.as_ref()?)));
    let rows: Vec<Vec<String>> = rows.collect();
    if !rows.is_empty() {
        text.push_str(&output::table(&[], &[1], rows));
    }
    let absent: Vec<&str> =
        signals.filter(|(_, r)| !present(r)).map(|(signal, _)| signal.name.as_str()).collect();
    if !absent.is_empty() {
        text.push_str(&format!("  absent: {}\n", printable(&absent.join(", "))));
    }
    if !found.extra(&line.frame).is_empty() {
        text.push_str(&format!("  extra: {}\n", hex(found.extra(&line.frame))));
    }
    text
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

/// JSON has no NaN and no infinity; they are texts, as in protobuf's JSON.
fn json_number(value: Value) -> Json {
    match value {
        Value::Unsigned(number) => json!(number),
        Value::Signed(number) => json!(number),
        Value::Float(number) if number.is_nan() => json!("NaN"),
        Value::Float(number) if number == f64::INFINITY => json!("Infinity"),
        Value::Float(number) if number == f64::NEG_INFINITY => json!("-Infinity"),
        Value::Float(number) => json!(number),
    }
}

/// `0x` and 8 hex digits for 29 bits, 3 for 11.
fn identifier(frame: &CanFrame) -> String {
    let short = !frame.flags.has(CanFlags::EXTENDED) && !frame.flags.has(CanFlags::ERROR);
    if short { format!("0x{:03X}", frame.id) } else { format!("0x{:08X}", frame.id) }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
