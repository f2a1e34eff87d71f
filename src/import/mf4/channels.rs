//! The channels of a group, by the names of their fields.

use std::collections::{BTreeMap, HashSet};

use super::blocks::Block;
use super::event::Kind;
use super::field::{Encoding, Field, Time};
use crate::import::little_endian::{u16_at, u32_at, u64_at};

/// `cn_type`: variable length, its value is a place in the signal data.
pub(super) const VARIABLE: u8 = 1;
const MASTER: u8 = 2;
pub(super) const VIRTUAL_MASTER: u8 = 3;

/// A channel, as far as it matters.
pub(super) struct Channel {
    /// `cn_type`.
    pub role: u8,
    pub field: Field,
    /// Where signal data are.
    pub data: u64,
}

impl Channel {
    /// Reads it; `None` if the block is too short.
    pub fn of(block: &Block) -> Option<Self> {
        let data = &block.data;
        let field = Field {
            byte: u32_at(data, 4)? as usize,
            bit: u32::from(*data.get(3)? & 7),
            bits: u32_at(data, 8)?.min(1 << 23),
            encoding: Encoding::of(*data.get(2)?),
        };
        Some(Self { role: *data.first()?, field, data: block.link(5) })
    }

    pub fn is_master(&self) -> bool {
        matches!(self.role, MASTER | VIRTUAL_MASTER)
    }
}

/// The channels of a group by the names of their fields.
#[derive(Default)]
pub(super) struct Channels {
    events: HashSet<&'static str>,
    pub fields: BTreeMap<String, Channel>,
    pub time: Option<Time>,
    /// Another bus event that the group holds.
    pub other: Option<String>,
}

const EVENTS: [(&str, Kind); 3] = [
    ("CAN_DataFrame", Kind::Data),
    ("CAN_ErrorFrame", Kind::Error),
    ("CAN_RemoteFrame", Kind::Remote),
];

impl Channels {
    pub fn add(&mut self, name: String, channel: Channel) {
        let (event, field) = name.split_once('.').unwrap_or((&name, ""));
        if let Some((event, _)) = EVENTS.iter().find(|(known, _)| *known == event) {
            self.events.insert(event);
            // Where fields are given twice, the outermost is the one that counts.
            if !field.is_empty() {
                self.fields.insert(field.to_owned(), channel);
            }
        } else if event.ends_with("Frame") {
            self.other.get_or_insert_with(|| event.to_owned());
        }
    }

    /// The event that the group holds, if it is one of CAN.
    pub fn event(&self) -> Option<Kind> {
        EVENTS.iter().find(|(name, _)| self.events.contains(name)).map(|(_, kind)| *kind)
    }
}

/// How many items an array (CA) has: the product of its dimensions.
pub(super) fn items(block: &Block) -> u32 {
    let dimensions = u16_at(&block.data, 2).unwrap_or(0).min(8);
    let size = |index: u16| u64_at(&block.data, 16 + 8 * usize::from(index)).unwrap_or(1);
    let items = (0..dimensions).map(size).fold(1_u64, u64::saturating_mul);
    u32::try_from(items).unwrap_or(u32::MAX)
}
