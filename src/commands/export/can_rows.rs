//! From CAN frames to the tables of their messages.

use std::sync::Arc;

use super::selection::Selection;
use crate::decode::bus::{CanBus, CanItem};
use crate::export::catalogue::{Catalogue, Definition};
use crate::frame::{CanFlags, CanFrame, Timestamp};

/// A message without a table yet.
const UNSEEN: u32 = u32::MAX;
/// A message that is not wanted.
const UNWANTED: u32 = u32::MAX - 1;

/// The messages of one bus.
pub struct CanRows {
    decoder: CanBus,
    definition: Arc<Definition>,
    /// By index of the message.
    tables: Vec<u32>,
    room: Vec<u8>,
}

/// Why a CAN frame is in no table of its own.
pub enum Lost {
    /// The protocol does not know it.
    Unknown,
    /// A remote frame that is a message, which is decoded elsewhere.
    Named,
    /// A remote or error frame, or one of a bus without a protocol.
    Other,
}

impl CanRows {
    /// Begins without any frame seen.
    pub fn new(definition: &Arc<Definition>) -> Self {
        Self {
            decoder: CanBus::new(Arc::clone(&definition.can)),
            tables: vec![UNSEEN; definition.can.messages().len()],
            definition: Arc::clone(definition),
            room: Vec::new(),
        }
    }

    /// Forgets what was seen: it tells nothing about what follows. The tables stay.
    pub fn forget(&mut self) {
        self.decoder.finish(&mut |_| {});
    }

    /// The table that a frame belongs to, if that is wanted, and what its row is made of.
    #[inline]
    pub fn row<'a>(
        &'a mut self,
        bus: &Arc<str>,
        time: Timestamp,
        frame: &'a CanFrame,
        catalogue: &mut Catalogue,
        selection: &Selection,
    ) -> Result<Option<(u32, &'a [u8])>, Lost> {
        let mut found = Err(Lost::Unknown);
        self.decoder.feed(time, frame, &mut |item| match item {
            CanItem::Message(message) => found = Ok(message.index),
            CanItem::Remote(_) => found = Err(Lost::Named),
            CanItem::Unknown | CanItem::Assembly(_) => {}
        });
        let special = || frame.flags.has(CanFlags::REMOTE) || frame.flags.has(CanFlags::ERROR);
        let message = match found {
            Err(Lost::Unknown) if special() => return Err(Lost::Other),
            found => found?,
        };
        let Self { definition, tables, room, .. } = self;
        let Some(table) = tables.get_mut(message) else { return Ok(None) };
        if *table == UNSEEN {
            let known = definition.can.messages().get(message);
            let wanted = known.is_some_and(|known| selection.message(&known.name));
            let number = if wanted { catalogue.add(bus, definition, message) } else { None };
            *table = number.unwrap_or(UNWANTED);
        }
        let table = Some(*table).filter(|table| *table != UNWANTED);
        Ok(table.map(|table| (table, definition.payload(message, frame, room))))
    }
}
