//! `--decode [BUS=]PROTOCOL`: which buses are decoded with what.

use std::sync::Arc;

use anyhow::{Result, bail};

use super::input::Source;
use crate::channels::{Definition, Meaning};
use crate::commands::{UsageError, definitions};
use crate::export::catalogue;

/// A protocol.
#[derive(Debug)]
pub struct Protocol {
    /// What was loaded.
    pub definition: Definition,
    /// Its messages, if it is one of CAN.
    pub can: Option<Arc<catalogue::Definition>>,
    /// Its files: names, and SHA-256 in hexadecimal.
    pub files: Vec<(String, String)>,
}

/// The protocols, and for which bus each is.
#[derive(Debug, Default)]
pub struct Decoders {
    /// The protocols, each once.
    protocols: Vec<Protocol>,
    /// Bus, or `None` for all others, and the index of its protocol.
    routes: Vec<(Option<String>, usize)>,
    /// Parts of a definition could not be loaded.
    pub incomplete: bool,
}

impl Decoders {
    /// Loads what `texts` name.
    pub fn load(texts: &[String]) -> Result<Self> {
        let mut all = Self::default();
        let mut names: Vec<&str> = Vec::new();
        for text in texts {
            let (bus, protocol) = parts(text);
            let index = names.iter().position(|name| *name == protocol).unwrap_or(names.len());
            if index == names.len() {
                all.add(protocol)?;
                names.push(protocol);
            }
            all.route(text, bus, index)?;
        }
        Ok(all)
    }

    fn add(&mut self, text: &str) -> Result<()> {
        let (definition, complete) = definitions::definition(text)?;
        self.incomplete |= !complete;
        let files = definition.attachments.iter();
        let mut files: Vec<_> = files.map(|file| (file.name.clone(), file.sha256())).collect();
        files.sort();
        let can = match &definition.meaning {
            Meaning::Can(can) => Some(Arc::clone(can)),
            Meaning::Serial(_) => None,
        };
        let can = can.map(|can| catalogue::Definition::new(can, files.clone()).into());
        self.protocols.push(Protocol { definition, can, files });
        Ok(())
    }

    fn route(&mut self, text: &str, bus: Option<&str>, index: usize) -> Result<()> {
        let is_can = |index: usize| self.protocols.get(index).is_some_and(|p| p.can.is_some());
        let taken = self.routes.iter().any(|(other, at)| match bus {
            Some(_) => other.as_deref() == bus,
            // One for all CAN buses and one for all serial lines go together.
            None => other.is_none() && is_can(*at) == is_can(index),
        });
        if taken {
            let every = if is_can(index) { "every CAN bus" } else { "every serial line" };
            let bus = bus.unwrap_or(every);
            bail!(UsageError(format!("--decode {text}: {bus} has a protocol already")));
        }
        self.routes.push((bus.map(str::to_owned), index));
        Ok(())
    }

    /// True without any.
    pub fn is_empty(&self) -> bool {
        self.protocols.is_empty()
    }

    /// True if what a frame means may depend on those before it.
    pub fn look_back(&self) -> bool {
        let rules =
            |protocol: &Protocol| protocol.can.as_ref().is_none_or(|can| can.can.has_rules());
        self.protocols.iter().any(rules)
    }

    /// What CAN frames of a bus are decoded with, and what bytes of a serial line of that name are.
    pub fn of(&self, bus: &str) -> [Option<&Protocol>; 2] {
        let protocol = |(_, index): &(_, usize)| self.protocols.get(*index);
        let named = self.routes.iter().find(|(name, _)| name.as_deref() == Some(bus));
        if let Some(named) = named.and_then(protocol) {
            let can = named.can.is_some();
            return [Some(named).filter(|_| can), Some(named).filter(|_| !can)];
        }
        let others = || self.routes.iter().filter(|(name, _)| name.is_none()).filter_map(protocol);
        [others().find(|other| other.can.is_some()), others().find(|other| other.can.is_none())]
    }

    /// An error if a bus was named that the recording does not have, or if nothing tells what the
    /// frames of a log mean. The buses of a log are known at its end only.
    pub fn check(&self, source: &Source) -> Result<()> {
        let Source::Recording(recording) = source else {
            if self.protocols.is_empty() {
                bail!(UsageError(
                    "nothing says what the frames of a log mean; give --decode PROTOCOL, or \
                     --shape frames for the frames as they are"
                        .to_owned()
                ));
            }
            return Ok(());
        };
        for bus in self.routes.iter().filter_map(|(bus, _)| bus.as_ref()) {
            if !recording.buses.contains(bus) {
                let buses = recording.buses.join(", ");
                bail!(UsageError(format!(
                    "--decode {bus}=...: there is no bus {bus}, only {buses}"
                )));
            }
        }
        Ok(())
    }
}

/// The bus, if one is named, and the protocol. A path may have a `=` in it.
fn parts(text: &str) -> (Option<&str>, &str) {
    match text.split_once('=') {
        Some((bus, protocol)) if !bus.is_empty() && !bus.contains(['/', ':']) => {
            (Some(bus), protocol)
        }
        _ => (None, text),
    }
}
