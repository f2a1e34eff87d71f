//! What the frames of a bus mean: by `--decode`, else by what the recording carries.

use anyhow::{Context as _, Result};

use super::usage;
use crate::commands::{explain, protocols};
use crate::decode::dbc;
use crate::decode::definition::CanDefinition;
use crate::decode::rules::Rules;
use crate::protocol::{Protocol, Settings};
use crate::recording::reader::Recording;

/// The options `--decode BUS=PROTOCOL`.
pub struct Definitions<'a> {
    given: Vec<(&'a str, &'a str)>,
    recording: &'a Recording,
}

impl<'a> Definitions<'a> {
    /// Reads the options.
    pub fn of(options: &'a [String], recording: &'a Recording) -> Result<Self> {
        let mut given = Vec::new();
        for text in options {
            let Some((bus, protocol)) = text.split_once('=') else {
                return usage(format!("--decode {text}: write it as BUS=PROTOCOL"));
            };
            if !recording.buses.iter().any(|name| name == bus) {
                let buses = recording.buses.join(", ");
                return usage(format!("--decode {text}: there is no bus {bus}, only {buses}"));
            }
            given.push((bus, protocol));
        }
        Ok(Self { given, recording })
    }

    /// The definition of a CAN bus, if there is one.
    pub fn can(&self, bus: &str) -> Result<Option<CanDefinition>> {
        if let Some(text) = self.given(bus) {
            return Ok(Some(protocols::load(&protocols::named(text)?)?.definition));
        }
        let Some((name, bytes)) = self.attached(bus, ".dbc")? else { return Ok(None) };
        let parsed = dbc::parse(&bytes)
            .with_context(|| format!("cannot use the attached {name} of {bus}"))?;
        if let Some((name, bytes)) = self.attached(bus, ".toml")? {
            let text = String::from_utf8(bytes)
                .with_context(|| format!("the attached {name} of {bus} is not UTF-8 text"))?;
            return Ok(Some(Rules::read(&name, &text)?.join(parsed.database)?));
        }
        let j1939 = self.fact(bus, "protocol").is_some_and(|text| text.ends_with(":j1939"));
        Ok(Some(CanDefinition::of_database(&name, parsed.database, j1939)))
    }

    /// The definition of a serial line, if there is one.
    pub fn serial(&self, bus: &str) -> Result<Option<Protocol>> {
        if let Some(text) = self.given(bus) {
            return match explain::serial::load(text)? {
                Some(protocol) => Ok(Some(protocol)),
                None => usage(format!("--decode {bus}={text}: that is no serial protocol")),
            };
        }
        let Some((name, bytes)) = self.attached(bus, ".toml")? else { return Ok(None) };
        let text = String::from_utf8(bytes)
            .with_context(|| format!("the attached {name} of {bus} is not UTF-8 text"))?;
        let settings = self.fact(bus, "protocol").and_then(|text| text.split_once(':'));
        let settings = Settings::parse(settings.map_or("", |(_, settings)| settings));
        Ok(Some(Protocol::parse(&name, &text, settings.unwrap_or_default())?))
    }

    fn given(&self, bus: &str) -> Option<&str> {
        self.given.iter().find(|(name, _)| *name == bus).map(|(_, protocol)| *protocol)
    }

    fn fact(&self, bus: &str, key: &str) -> Option<&str> {
        let name = format!("bustape.bus.{bus}");
        self.recording.segments.iter().find_map(|segment| segment.fact(&name, key))
    }

    /// The file that the recording was decoded with, whose name the bus's metadata tell.
    fn attached(&self, bus: &str, ending: &str) -> Result<Option<(String, Vec<u8>)>> {
        let record = format!("bustape.bus.{bus}");
        for segment in &self.recording.segments {
            let Some(facts) = segment.metadata.get(&record) else { continue };
            let names = facts.keys().filter_map(|key| key.strip_prefix("definition."));
            for name in names.filter(|name| name.ends_with(ending)) {
                if let Some(index) = segment.attachments.iter().find(|a| a.name == name) {
                    return Ok(Some((name.to_owned(), segment.read_attachment(index)?)));
                }
            }
        }
        Ok(None)
    }
}
