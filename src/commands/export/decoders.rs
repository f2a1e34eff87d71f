//! `--decode [BUS=]PROTOCOL`: which buses are decoded with what.

use std::fmt::Write as _;
use std::sync::Arc;

use anyhow::{Result, bail};
use sha2::{Digest as _, Sha256};

use crate::commands::{UsageError, explain, protocols};
use crate::decode::can::CanDecoder;
use crate::decode::protocol::CanProtocol;
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
            let index = match names.iter().position(|name| *name == protocol) {
                Some(index) => index,
                None => {
                    all.add(protocol)?;
                    names.push(protocol);
                    names.len() - 1
                }
            };
            all.routes.push((bus.map(str::to_owned), index));
        }
        Ok(all)
    }

    fn add(&mut self, text: &str) -> Result<()> {
        if !text.to_ascii_lowercase().contains(".dbc") && explain::serial::load(text)?.is_some() {
            bail!(UsageError(format!(
                "{text} is a protocol of serial lines; add its decoded channels with \"bustape \
                 decode\" first, then export them without --decode"
            )));
        }
        let protocol = protocols::named(text)?;
        let (parsed, bytes) = protocols::load_with_bytes(&protocol)?;
        explain::say_oddities(&protocol, &parsed);
        self.incomplete |= parsed.oddities.lost() > 0;
        let (name, j1939) = match &protocol {
            CanProtocol::BuiltIn { name, .. } => ((*name).to_owned(), false),
            CanProtocol::File { path, j1939 } => {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                (name, *j1939)
            }
        };
        let decoder = Arc::new(CanDecoder::new(parsed.database, j1939));
        self.definitions.push(Definition { decoder, name, sha256: sha256(&bytes) });
        Ok(())
    }

    /// The index of the database for a bus.
    pub fn of(&self, bus: &str) -> Option<usize> {
        let named = self.routes.iter().find(|(name, _)| name.as_deref() == Some(bus));
        let other = || self.routes.iter().find(|(name, _)| name.is_none());
        named.or_else(other).map(|(_, index)| *index)
    }

    /// Buses that were named.
    pub fn buses(&self) -> impl Iterator<Item = &str> {
        self.routes.iter().filter_map(|(bus, _)| bus.as_deref())
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
