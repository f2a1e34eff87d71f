//! `--decode BUS=PROTOCOL`: which bus is decoded with what.

use anyhow::{Result, bail};
use serde_json::json;

use super::{UsageError, explain, protocols};
use crate::channels::{Definition, Meaning, Stream};
use crate::decode::protocol::CanProtocol;
use crate::recording::definition::{Attachment, Facts};
use crate::text::grouped;

/// The decoded channels that were asked for.
pub struct Definitions {
    /// For each bus, in its order.
    pub streams: Vec<Option<Stream>>,
    /// The definitions, each once.
    pub attachments: Vec<Attachment>,
    /// Parts of a definition could not be loaded.
    pub incomplete: bool,
}

/// Loads what `texts` name for `buses`. `attached` are files that the recording has already and
/// that other buses need.
pub fn load(texts: &[String], buses: &[String], attached: Vec<Attachment>) -> Result<Definitions> {
    let streams = buses.iter().map(|_| None).collect();
    let mut all = Definitions { streams, attachments: attached, incomplete: false };
    for text in texts {
        let Some((bus, protocol)) = text.split_once('=') else {
            bail!(UsageError(format!("--decode {text}: give BUS=PROTOCOL, as in can0=car.dbc")));
        };
        let Some(index) = buses.iter().position(|name| name == bus) else {
            bail!(UsageError(format!(
                "--decode {text}: there is no bus {bus}, only {}",
                buses.join(", ")
            )));
        };
        if all.streams[index].is_some() {
            bail!(UsageError(format!("--decode {text}: {bus} has a protocol already")));
        }
        let (mut definition, complete) = definition(protocol)?;
        all.incomplete |= !complete;
        for attachment in &mut definition.attachments {
            attach(attachment, bus, &mut all.attachments);
        }
        all.streams[index] = Some(Stream::new(bus, definition));
    }
    Ok(all)
}

/// The definition that a person means; false if not all of it could be loaded.
fn definition(text: &str) -> Result<(Definition, bool)> {
    let can = protocols::named(text)?;
    let (parsed, data) = protocols::load_with_bytes(&can)?;
    explain::say_oddities(&can, &parsed);
    let (name, protocol, j1939) = match &can {
        CanProtocol::BuiltIn { name, .. } => (format!("{name}.dbc"), (*name).to_owned(), false),
        CanProtocol::File { path, j1939 } => {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let protocol = if *j1939 { format!("{name}:j1939") } else { name.clone() };
            (name, protocol, *j1939)
        }
    };
    let attachments = vec![Attachment { name, media_type: "text/x-dbc".to_owned(), data }];
    let complete = parsed.oddities.lost() == 0;
    let meaning = Meaning::Can { database: parsed.database, j1939 };
    Ok((Definition { protocol, attachments, meaning }, complete))
}

/// Adds an attachment, under another name where its own is taken by another file.
fn attach(attachment: &mut Attachment, bus: &str, all: &mut Vec<Attachment>) {
    match all.iter().find(|other| other.name == attachment.name) {
        Some(other) if other.data == attachment.data => return,
        Some(_) => attachment.name = format!("{bus}-{}", attachment.name),
        None => {}
    }
    all.retain(|other| other.name != attachment.name);
    all.push(attachment.clone());
}

/// Puts what a stream says of itself into the metadata of its bus, in the place of what stood there.
pub fn enter(stream: &Stream, facts: &mut Facts) {
    facts.retain(|key, _| key != "protocol" && !key.starts_with("definition."));
    facts.extend(stream.facts().clone());
}

/// Adds what a stream has decoded to `bustape.summary`.
pub fn sum_up(stream: &Stream, summary: &mut Facts) {
    let counts = stream.counts();
    let bus = stream.bus();
    let mut put = |key: &str, value: String| summary.insert(format!("{bus}.{key}"), value);
    put("decoded", counts.messages.to_string());
    put("unknown", counts.unknown.to_string());
    put("invalid", counts.invalid.to_string());
    if let Some(why) = stream.stopped() {
        put("decode_error", why.to_owned());
    }
}

/// What a stream has decoded, for a person.
pub fn sentence(stream: &Stream) -> String {
    let counts = stream.counts();
    let mut text = format!(
        "{}: decoded {} messages with {}; {} frames unknown",
        stream.bus(),
        grouped(counts.messages),
        stream.protocol(),
        grouped(counts.unknown),
    );
    if counts.invalid > 0 {
        text.push_str(&format!(", {} invalid", grouped(counts.invalid)));
    }
    text
}

/// What a stream has decoded, for a program.
pub fn as_json(stream: &Stream) -> serde_json::Value {
    let counts = stream.counts();
    json!({
        "bus": stream.bus(),
        "protocol": stream.protocol(),
        "messages": counts.messages,
        "unknown": counts.unknown,
        "invalid": counts.invalid,
        "error": stream.stopped(),
    })
}
