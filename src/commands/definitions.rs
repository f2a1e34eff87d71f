//! `--decode BUS=PROTOCOL`: which bus is decoded with what.

use std::path::Path;

use anyhow::{Result, bail};
use serde_json::json;

use super::{UsageError, explain, protocols};
use crate::channels::{Definition, Meaning, Stream};
use crate::frame::Unit;
use crate::recording::definition::{Attachment, Facts};
use crate::text::grouped;
use crate::trigger::{Known, Triggers};

/// The decoded channels that were asked for.
pub struct Definitions {
    /// For each bus, in its order.
    pub streams: Vec<Option<Stream>>,
    /// For each bus: what it is decoded with.
    pub known: Vec<Option<Definition>>,
    /// What is waited for.
    pub triggers: Option<Triggers>,
    /// The definitions, each once.
    pub attachments: Vec<Attachment>,
    /// Parts of a definition could not be loaded.
    pub incomplete: bool,
}

impl Definitions {
    /// Refuses protocols of serial lines for CAN buses, and the other way round. `units` are those of
    /// the buses, as far as they are known.
    pub fn check(&self, units: impl Iterator<Item = (String, Option<Unit>)>) -> Result<()> {
        for ((bus, unit), known) in units.zip(&self.known) {
            let (Some(unit), Some(Definition { protocol, meaning, .. })) = (unit, known) else {
                continue;
            };
            let why = match (unit, meaning) {
                (Unit::Frames, Meaning::Serial(_)) => "a CAN bus, and that is a serial protocol",
                (Unit::Bytes, Meaning::Can(_)) => "a serial line, and that is a protocol of CAN",
                _ => continue,
            };
            bail!(UsageError(format!("--decode {bus}={protocol}: {bus} is {why}")));
        }
        Ok(())
    }

    /// For each bus: what conditions can name.
    pub fn nameable(&self, buses: &[String]) -> Vec<(String, Option<Known>)> {
        let known = self.known.iter().map(|known| {
            known.as_ref().map(|definition| match &definition.meaning {
                Meaning::Can(can) => Known::Can(can.clone()),
                Meaning::Serial(protocol) => Known::Serial(protocol.clone()),
            })
        });
        buses.iter().cloned().zip(known).collect()
    }
}

/// Loads what `texts` name for `buses`. `attached` are files that the recording has already and
/// that other buses need.
pub fn load(texts: &[String], buses: &[String], attached: Vec<Attachment>) -> Result<Definitions> {
    let streams = buses.iter().map(|_| None).collect();
    let known = vec![None; buses.len()];
    let (triggers, attachments, incomplete) = (None, attached, false);
    let mut all = Definitions { streams, known, triggers, attachments, incomplete };
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
        all.streams[index] = Some(Stream::new(bus, definition.clone()));
        all.known[index] = Some(definition);
    }
    Ok(all)
}

/// The definition that a person means; false if not all of it could be loaded.
pub fn definition(text: &str) -> Result<(Definition, bool)> {
    if let Some(serial) = explain::serial::load_files(text)? {
        let name = format!("{}.toml", serial.protocol.name);
        let attachment = attachment(serial.file.as_deref().unwrap_or(&name), serial.text.into());
        let protocol = with_settings(&serial.file.unwrap_or(serial.protocol.name.clone()), text);
        let meaning = Meaning::Serial(serial.protocol.into());
        return Ok((Definition { protocol, attachments: vec![attachment], meaning }, true));
    }
    let can = protocols::named(text)?;
    let loaded = protocols::load(&can)?;
    explain::say_oddities(&can, &loaded);
    let complete = loaded.oddities.lost() == 0;
    let attachments = loaded.files.into_iter().map(|(name, data)| attachment(&name, data));
    let attachments = attachments.collect();
    let protocol = with_settings(&can.name(), text);
    let meaning = Meaning::Can(loaded.definition.into());
    Ok((Definition { protocol, attachments, meaning }, complete))
}

/// What a protocol is called in a recording: without folders, with its settings.
fn with_settings(name: &str, text: &str) -> String {
    let settings = text.rsplit_once(':').map_or("", |(_, settings)| settings);
    let plain = file_name(name);
    if settings.is_empty() || settings.contains('/') || text.ends_with(&plain) {
        return plain;
    }
    format!("{plain}:{settings}")
}

fn file_name(path: &str) -> String {
    Path::new(path).file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn attachment(path: &str, data: Vec<u8>) -> Attachment {
    let name = file_name(path);
    let is_dbc = name.to_ascii_lowercase().ends_with(".dbc");
    let media_type = if is_dbc { "text/x-dbc" } else { "application/toml" };
    Attachment { name, media_type: media_type.to_owned(), data }
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
        text += &[", ", &grouped(counts.invalid), " invalid"].concat();
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
