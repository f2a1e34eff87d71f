//! What a bus is decoded with, and how a recording tells of it.

use sha2::{Digest as _, Sha256};

use std::sync::Arc;

use super::can::CanChannels;
use super::serial::SerialChannels;
use super::stream::Decode;
use crate::decode::definition::CanDefinition;
use crate::protocol::Protocol;
use crate::recording::definition::{Attachment, Facts, hex};

/// What a bus is decoded with.
#[derive(Clone, Debug)]
pub struct Definition {
    /// As a person calls it, without folders: `hmi-can`, `car.dbc:j1939`.
    pub protocol: String,
    /// The files, byte for byte.
    pub attachments: Vec<Attachment>,
    /// What they say.
    pub meaning: Meaning,
}

/// What the files of a definition say.
#[derive(Clone, Debug)]
pub enum Meaning {
    /// The messages of a CAN bus.
    Can(Arc<CanDefinition>),
    /// The commands of a serial line.
    Serial(Arc<Protocol>),
}

impl Definition {
    /// For the metadata of the bus: `protocol`, and for each attachment `definition.<name>` with its
    /// SHA-256.
    pub fn facts(&self) -> Facts {
        let mut facts = Facts::from([("protocol".to_owned(), self.protocol.clone())]);
        for attachment in &self.attachments {
            let key = format!("definition.{}", attachment.name);
            facts.insert(key, attachment.sha256());
        }
        facts
    }

    /// The package of its types. Viewers know types by name over all files that are open, so the
    /// name holds a hash of everything that the types depend on.
    pub fn package(&self) -> String {
        let mut hash = Sha256::new();
        for attachment in &self.attachments {
            hash.update((attachment.data.len() as u64).to_le_bytes());
            hash.update(&attachment.data);
        }
        // Settings change what the types look like.
        hash.update(self.protocol.split_once(':').map_or("", |(_, settings)| settings));
        let digits = hex(&hash.finalize()[..4]);
        match &self.meaning {
            Meaning::Can(_) => format!("bustape.can.h{digits}"),
            Meaning::Serial(_) => format!("bustape.serial.h{digits}"),
        }
    }

    /// Compiles it; without messages of one CAN frame unless `single`.
    pub(super) fn decoder(self, single: bool) -> Box<dyn Decode> {
        let package = self.package();
        match self.meaning {
            Meaning::Can(definition) => Box::new(CanChannels::new(definition, package, single)),
            Meaning::Serial(protocol) => Box::new(SerialChannels::new(protocol, package)),
        }
    }
}
