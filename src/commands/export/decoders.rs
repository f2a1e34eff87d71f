//! `--decode [BUS=]PROTOCOL`: which buses are decoded with what.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, bail};
use sha2::{Digest as _, Sha256};

use super::input::Source;
use crate::commands::{UsageError, explain, protocols};
use crate::export::catalogue::Definition;

/// The databases, and for which bus each is.
#[derive(Debug, Default)]
pub struct Decoders {
    /// The databases, each once.
    pub definitions: Vec<Definition>,
    /// Bus, or `None` for all others, and the index of its database.
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
            if all.routes.iter().any(|(other, _)| other.as_deref() == bus) {
                let bus = bus.unwrap_or("every CAN bus");
                bail!(UsageError(format!("--decode {text}: {bus} has a protocol already")));
            }
            let index = names.iter().position(|name| *name == protocol).unwrap_or(names.len());
            if index == names.len() {
                all.add(protocol)?;
                names.push(protocol);
            }
            all.routes.push((bus.map(str::to_owned), index));
        }
        Ok(all)
    }

    fn add(&mut self, text: &str) -> Result<()> {
        if !text.to_ascii_lowercase().contains(".dbc")
            && explain::serial::load_files(text)?.is_some()
        {
            bail!(UsageError(format!(
                "{text} is a protocol of serial lines; add its decoded channels with \"bustape \
                 decode\" first, then export them without --decode"
            )));
        }
        let protocol = protocols::named(text)?;
        let loaded = protocols::load(&protocol)?;
        explain::say_oddities(&protocol, &loaded);
        self.incomplete |= loaded.oddities.lost() > 0;
        let files = loaded.files.iter().map(|(path, bytes)| {
            let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy();
            (name.into_owned(), sha256(bytes))
        });
        let files = files.collect();
        self.definitions.push(Definition { can: Arc::new(loaded.definition), files });
        Ok(())
    }

    /// The index of the database for a bus.
    pub fn of(&self, bus: &str) -> Option<usize> {
        let named = self.routes.iter().find(|(name, _)| name.as_deref() == Some(bus));
        let other = || self.routes.iter().find(|(name, _)| name.is_none());
        named.or_else(other).map(|(_, index)| *index)
    }

    /// An error if a bus was named that the recording does not have, or if nothing tells what the
    /// frames of a log mean. The buses of a log are known at its end only.
    pub fn check(&self, source: &Source) -> Result<()> {
        let Source::Recording(recording) = source else {
            if self.definitions.is_empty() {
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

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::with_capacity(64), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
