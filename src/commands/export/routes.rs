//! From what is read to the table it belongs to.

use std::collections::HashMap;
use std::sync::Arc;

use anyhow::Result;

use super::decoders::Decoders;
use super::report::Counts;
use super::selection::Selection;
use crate::export::TableWriter;
use crate::export::catalogue::Catalogue;
use crate::export::message_table::Described;
use crate::frame::{CanFlags, Frame, Timestamp};
use crate::recording::reader::Recording;

/// A message without a table yet.
const UNSEEN: u32 = u32::MAX;
/// A message that is not wanted.
const UNWANTED: u32 = u32::MAX - 1;

/// Knows where frames and decoded messages go.
pub struct Routes<'a> {
    decoders: &'a Decoders,
    selection: &'a Selection,
    buses: Vec<Bus>,
    /// Segment and channel, and the table, if it is wanted.
    channels: HashMap<(usize, u16), Option<u32>>,
    /// Tables of decoded channels, over all segments: topic, name of the type.
    topics: HashMap<(String, String), Option<u32>>,
    /// The tables.
    pub catalogue: Catalogue,
    /// What happened.
    pub counts: Counts,
}

/// A bus, and the tables of its messages.
struct Bus {
    name: Arc<str>,
    definition: Option<usize>,
    /// By index of the message.
    tables: Vec<u32>,
}

impl<'a> Routes<'a> {
    /// Nothing was seen yet.
    pub fn new(decoders: &'a Decoders, selection: &'a Selection) -> Self {
        let wanted = selection.clone();
        let wanted = Box::new(move |signal: &str| wanted.signal(signal));
        Self {
            decoders,
            selection,
            buses: Vec::new(),
            channels: HashMap::new(),
            topics: HashMap::new(),
            catalogue: Catalogue::new(decoders.definitions.clone(), wanted),
            counts: Counts::default(),
        }
    }

    /// True when raw frames are decoded, else the decoded channels of the recording are taken.
    pub fn decodes(&self) -> bool {
        !self.decoders.definitions.is_empty()
    }

    /// The index of a bus by its name.
    pub fn bus(&mut self, name: &str) -> usize {
        if let Some(index) = self.buses.iter().position(|bus| &*bus.name == name) {
            return index;
        }
        let definition = self.decoders.of(name).filter(|_| self.selection.bus(name));
        let definitions = self.catalogue.definitions();
        let messages = definition.and_then(|index| definitions.get(index));
        let messages = messages.map_or(0, |d| d.decoder.database().messages.len());
        self.buses.push(Bus { name: name.into(), definition, tables: vec![UNSEEN; messages] });
        self.buses.len() - 1
    }

    /// Takes a frame.
    pub fn frame(
        &mut self,
        bus: usize,
        time: Timestamp,
        frame: &Frame,
        writer: &mut dyn TableWriter,
    ) -> Result<()> {
        let can = match frame {
            Frame::Can(can) => can,
            Frame::Serial(_) => {
                self.counts.read += 1;
                self.counts.other += 1;
                return Ok(());
            }
            Frame::Gap(_) | Frame::Notice(_) => return Ok(()),
        };
        let Some(bus) = self.buses.get_mut(bus) else { return Ok(()) };
        self.counts.read += 1;
        let definition = bus.definition.and_then(|index| self.catalogue.definitions().get(index));
        let special = can.flags.has(CanFlags::REMOTE) || can.flags.has(CanFlags::ERROR);
        let Some(definition) = definition.filter(|_| !special) else {
            self.counts.other += 1;
            return Ok(());
        };
        let Some(found) = definition.decoder.find(can) else {
            self.counts.unknown += 1;
            return Ok(());
        };
        let message = found.index;
        let Some(table) = bus.tables.get_mut(message) else { return Ok(()) };
        if *table == UNSEEN {
            let wanted = self.selection.message(&found.message.name);
            let definition = bus.definition.filter(|_| wanted);
            let number = definition.and_then(|d| self.catalogue.add(&bus.name, d, message));
            *table = number.unwrap_or(UNWANTED);
        }
        if *table != UNWANTED {
            writer.write(&self.catalogue, *table, time, can.data())?;
            self.counts.rows += 1;
        }
        Ok(())
    }

    /// Takes a message of a decoded channel.
    pub fn message(
        &mut self,
        recording: &Recording,
        place: (usize, u16),
        time: Timestamp,
        data: &[u8],
        writer: &mut dyn TableWriter,
    ) -> Result<()> {
        self.counts.read += 1;
        let table = match self.channels.get(&place) {
            Some(table) => *table,
            None => {
                let table = self.channel(recording, place);
                self.channels.insert(place, table);
                table
            }
        };
        if let Some(table) = table {
            writer.write(&self.catalogue, table, time, data)?;
            self.counts.rows += 1;
        }
        Ok(())
    }

    /// The table of a channel.
    fn channel(&mut self, recording: &Recording, (segment, id): (usize, u16)) -> Option<u32> {
        let segment = recording.segments.get(segment)?;
        let channel = segment.channels.get(&id)?;
        let schema = segment.schemas.get(&channel.schema)?;
        if channel.encoding != "protobuf" || schema.encoding != "protobuf" {
            return None;
        }
        let key = (channel.topic.clone(), schema.name.clone());
        if let Some(known) = self.topics.get(&key) {
            return *known;
        }
        let (bus, message) = channel.topic.strip_prefix('/')?.rsplit_once('/')?;
        let described = Described {
            bus,
            message,
            schema: &schema.name,
            descriptor: &schema.data,
            metadata: &channel.metadata,
        };
        let facts = segment.metadata.get(&format!("bustape.bus.{bus}"));
        let definitions = facts.into_iter().flatten().filter_map(|(key, sha256)| {
            Some((key.strip_prefix("definition.")?.to_owned(), sha256.clone()))
        });
        let facts: Vec<_> = definitions
            .flat_map(|(name, sha256)| {
                [("definition".to_owned(), name), ("definition_sha256".to_owned(), sha256)]
            })
            .collect();
        let table = self.catalogue.add_message(&described, &facts);
        self.topics.insert(key, table);
        table
    }
}
