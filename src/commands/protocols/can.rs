//! Messages and signals of a DBC file, for `bustape protocols show`.

use std::io::Write;

use anyhow::Result;
use serde_json::{Map, Value, json};

use super::rules;
use super::show::number;
use crate::commands::output;
use crate::decode::assembly::Assembly;
use crate::decode::dbc::{ByteOrder, Database, Message, Number, Signal};
use crate::decode::definition::{CanDefinition, RemoteMessage};
use crate::text::printable;

/// Something that has a name of its own.
#[derive(Clone, Copy)]
pub enum Named<'a> {
    /// A message of the database.
    Message(&'a Message),
    /// A remote frame that is a message.
    Remote(&'a RemoteMessage),
    /// A message of several frames.
    Assembly(&'a Assembly),
}

/// What has this name or identifier.
pub fn find<'a>(definition: &'a CanDefinition, name: &str) -> Option<Named<'a>> {
    let messages = &definition.database().messages;
    let named = messages.iter().find(|message| message.name == name).map(Named::Message);
    let remotes = definition.remotes().iter();
    let named = named.or_else(|| remotes.clone().find(|r| r.name == name).map(Named::Remote));
    let mut assemblies = definition.assemblies().iter();
    let named = named.or_else(|| assemblies.find(|a| *a.name == *name).map(Named::Assembly));
    named.or_else(|| {
        let id = number(name)?;
        let message = messages.iter().find(|message| u64::from(message.id) == id);
        let message = message.map(Named::Message);
        message.or_else(|| remotes.clone().find(|r| u64::from(r.id) == id).map(Named::Remote))
    })
}

/// One of them, for a person.
pub fn show(out: &mut impl Write, database: &Database, named: Named<'_>) -> Result<()> {
    match named {
        Named::Message(found) => message(out, database, found),
        Named::Remote(found) => rules::remote(out, found),
        Named::Assembly(found) => rules::assembly(out, found),
    }
}

/// The same as [`show`].
pub fn show_json(database: &Database, named: Named<'_>) -> Value {
    match named {
        Named::Message(found) => message_json(database, found),
        Named::Remote(found) => rules::remote_json(found),
        Named::Assembly(found) => rules::assembly_json(found),
    }
}

/// All messages, a line each, and those that are no data frame.
pub fn overview(out: &mut impl Write, definition: &CanDefinition) -> Result<()> {
    let database = definition.database();
    let rows = database.messages.iter().map(|message| {
        vec![
            id(message),
            message.name.clone(),
            message.length.to_string(),
            direction(database, message).unwrap_or_else(|| "-".to_owned()),
            period(message),
            message.signals.len().to_string(),
            short(&message.comment),
        ]
    });
    let head = ["id", "message", "bytes", "direction", "ms", "signals", "comment"];
    write!(out, "{}", output::table(&head, &[2, 4, 5], rows.collect()))?;
    if !definition.remotes().is_empty() {
        writeln!(out)?;
        let rows = definition.remotes().iter().map(|remote| {
            let direction = remote.direction.as_deref().unwrap_or("-").to_owned();
            let title = remote.title.as_deref().unwrap_or_default().to_owned();
            vec![identifier(remote.id, remote.extended), remote.name.clone(), direction, title]
        });
        let head = ["id", "remote frame", "direction", "title"];
        write!(out, "{}", output::table(&head, &[], rows.collect()))?;
    }
    if !definition.assemblies().is_empty() {
        writeln!(out)?;
        let rows = definition.assemblies().iter().map(|assembly| {
            let fields: Vec<&str> = assembly.fields.iter().map(|f| &*f.plan.name).collect();
            let direction = assembly.direction.as_deref().unwrap_or("-").to_owned();
            vec![assembly.name.to_string(), assembly.kind.to_string(), direction, fields.join(" ")]
        });
        let head = ["of several frames", "kind", "direction", "fields"];
        write!(out, "{}", output::table(&head, &[], rows.collect()))?;
    }
    Ok(())
}

/// One message and its signals.
fn message(out: &mut impl Write, database: &Database, message: &Message) -> Result<()> {
    let direction = direction(database, message).map_or(String::new(), |d| format!(", {d}"));
    let head = format!("{} {}, {} bytes{direction}", id(message), message.name, message.length);
    output::heading(out, &printable(&head))?;
    if !message.comment.is_empty() {
        writeln!(out, "  {}", printable(&message.comment))?;
    }
    let rows = message.signals.iter().map(|signal| {
        vec![
            signal.name.clone(),
            signal.start.to_string(),
            signal.length.to_string(),
            kind(signal).to_owned(),
            scale(signal),
            dash(&signal.unit),
            range(signal).map_or("-".to_owned(), |(least, most)| format!("{least}..{most}")),
            gate(message, signal).unwrap_or_else(|| "-".to_owned()),
            short(&signal.comment),
        ]
    });
    let head = ["signal", "start", "bits", "type", "scale", "unit", "range", "when", "comment"];
    write!(out, "{}", output::table(&head, &[1, 2], rows.collect()))?;
    for signal in message.signals.iter().filter(|signal| signal.labels.is_some()) {
        writeln!(out)?;
        output::heading(out, &printable(&signal.name))?;
        let labels = signal.labels.iter().flat_map(|labels| labels.iter());
        let rows = labels.map(|(value, text)| vec![value.to_string(), text.to_string()]);
        write!(out, "{}", output::table(&[], &[0], rows.collect()))?;
    }
    Ok(())
}

/// The same as [`overview`].
pub fn overview_json(name: &str, definition: &CanDefinition) -> Value {
    let database = definition.database();
    let messages: Vec<Value> = database
        .messages
        .iter()
        .map(|message| {
            let mut object = head_json(database, message);
            object.insert("signals".to_owned(), message.signals.len().into());
            object.into()
        })
        .collect();
    let remotes = definition.remotes().iter().map(rules::remote_json);
    let assemblies = definition.assemblies().iter().map(|assembly| {
        let fields: Vec<&str> = assembly.fields.iter().map(|field| &*field.plan.name).collect();
        json!({
            "message": &*assembly.name,
            "assembly": &*assembly.kind,
            "dir": assembly.direction,
            "fields": fields,
        })
    });
    json!({
        "protocol": name,
        "kind": "can",
        "nodes": database.nodes,
        "messages": messages,
        "remotes": remotes.collect::<Vec<_>>(),
        "assemblies": assemblies.collect::<Vec<_>>(),
    })
}

/// The same as [`message`].
fn message_json(database: &Database, message: &Message) -> Value {
    let mut object = head_json(database, message);
    let signals: Vec<Value> = message.signals.iter().map(|s| signal_json(message, s)).collect();
    object.insert("signals".to_owned(), signals.into());
    object.into()
}

fn head_json(database: &Database, message: &Message) -> Map<String, Value> {
    let cycle = (message.cycle_time > 0).then_some(message.cycle_time);
    let pairs = [
        ("id", json!(id(message))),
        ("ext", json!(message.extended)),
        ("message", json!(message.name)),
        ("bytes", json!(message.length)),
        ("dir", json!(direction(database, message))),
        ("senders", json!(message.senders)),
        ("cycle_ms", json!(cycle)),
        ("comment", json!(message.comment)),
    ];
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

fn signal_json(message: &Message, signal: &Signal) -> Value {
    let labels: Map<String, Value> = signal
        .labels
        .iter()
        .flat_map(|labels| labels.iter())
        .map(|(value, text)| (value.to_string(), Value::from(text.to_string())))
        .collect();
    json!({
        "signal": signal.name,
        "start": signal.start,
        "bits": signal.length,
        "type": kind(signal),
        "factor": signal.factor,
        "offset": signal.offset,
        "unit": signal.unit,
        "min": range(signal).map(|(least, _)| least),
        "max": range(signal).map(|(_, most)| most),
        "switch": signal.switch,
        "when": gate(message, signal),
        "labels": labels,
        "comment": signal.comment,
    })
}

fn id(message: &Message) -> String {
    identifier(message.id, message.extended)
}

/// As many digits as candump writes.
pub fn identifier(id: u32, extended: bool) -> String {
    let digits = if extended { 8 } else { 3 };
    format!("0x{id:0digits$x}")
}

fn direction(database: &Database, message: &Message) -> Option<String> {
    message.direction(&database.nodes)
}

fn period(message: &Message) -> String {
    if message.cycle_time == 0 { "-".to_owned() } else { message.cycle_time.to_string() }
}

fn kind(signal: &Signal) -> &'static str {
    match (signal.number, signal.order) {
        (Number::Unsigned, ByteOrder::Intel) => "unsigned",
        (Number::Unsigned, ByteOrder::Motorola) => "unsigned motorola",
        (Number::Signed, ByteOrder::Intel) => "signed",
        (Number::Signed, ByteOrder::Motorola) => "signed motorola",
        (Number::Float32 | Number::Float64, ByteOrder::Intel) => "float",
        (Number::Float32 | Number::Float64, ByteOrder::Motorola) => "float motorola",
    }
}

fn scale(signal: &Signal) -> String {
    super::show::scale(signal.factor, signal.offset)
}

/// Least and largest value, where the file says them.
fn range(signal: &Signal) -> Option<(f64, f64)> {
    (signal.min != 0.0 || signal.max != 0.0).then_some((signal.min, signal.max))
}

/// `switch=1..3,7`: when a multiplexed signal is there; `M` for the switch itself.
fn gate(message: &Message, signal: &Signal) -> Option<String> {
    let own = signal.switch.then(|| "M".to_owned());
    let Some(gate) = &signal.gate else { return own };
    let switch = message.signals.get(gate.switch).map_or("?", |switch| &switch.name);
    let range = |(from, to): &(u64, u64)| {
        if from == to { from.to_string() } else { format!("{from}..{to}") }
    };
    let ranges: Vec<String> = gate.ranges.iter().map(range).collect();
    let when = format!("{switch}={}", ranges.join(","));
    Some(own.map_or(when.clone(), |own| format!("{own} {when}")))
}

fn dash(text: &str) -> String {
    if text.is_empty() { "-".to_owned() } else { text.to_owned() }
}

/// The beginning of a comment; all of it is in the JSON.
fn short(comment: &str) -> String {
    const SHOWN: usize = 60;
    let line = comment.lines().next().unwrap_or_default();
    if line.chars().count() <= SHOWN && line.len() == comment.len() {
        return line.to_owned();
    }
    let cut: String = line.chars().take(SHOWN).collect();
    format!("{}...", cut.trim_end())
}
