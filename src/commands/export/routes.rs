//! From what is read to the table it belongs to.

use std::collections::HashMap;
use std::sync::Arc;

use anyhow::Result;

use super::decoders::Decoders;
use super::report::Counts;
use super::selection::Selection;
use crate::decode::bus::{CanBus, CanItem};
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
    decoder: Option<(usize, CanBus)>,
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

    /// Begins anew with what is read; the tables stay.
    pub fn restart(&mut self) {
        self.counts = Counts::default();
        for (_, decoder) in self.buses.iter_mut().filter_map(|bus| bus.decoder.as_mut()) {
            decoder.finish(&mut |_| {});
        }
    }

    /// The index of a bus by its name.
    pub fn bus(&mut self, name: &str) -> usize {
        if let Some(index) = self.buses.iter().position(|bus| &*bus.name == name) {
            return index;
        }
        let definition = self.decoders.of(name).filter(|_| self.selection.bus(name));
        let decoder = definition.and_then(|index| {
            let definition = self.decoders.definitions.get(index)?;
            Some((index, CanBus::new(Arc::clone(&definition.can))))
        });
        let messages = decoder.as_ref().map_or(0, |(_, bus)| bus.definition().messages().len());
        self.buses.push(Bus { name: name.into(), decoder, tables: vec![UNSEEN; messages] });
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
        let Some(bus) = self.buses.get_mut(bus) else { return Ok(()) };
        let can = match frame {
            Frame::Can(can) => can,
            Frame::Serial(_) => {
                self.counts.read += 1;
                self.counts.other += 1;
                return Ok(());
            }
            Frame::Gap(_) => {
                // What came before tells nothing about what follows.
                if let Some((_, decoder)) = &mut bus.decoder {
                    decoder.finish(&mut |_| {});
                }
                return Ok(());
            }
            Frame::Notice(_) => return Ok(()),
        };
        self.counts.read += 1;
        let Bus { name, decoder, tables } = bus;
        let Some((definition, decoder)) = decoder else {
            self.counts.other += 1;
            return Ok(());
        };
        let mut message = None;
        decoder.feed(time, can, &mut |item| {
            // Messages of several frames are texts, not signals over time.
            if let CanItem::Message(found) = item {
                message = Some(found.index);
            }
        });
        let Some(message) = message else {
            let special = can.flags.has(CanFlags::REMOTE) || can.flags.has(CanFlags::ERROR);
            let count = if special { &mut self.counts.other } else { &mut self.counts.unknown };
            *count += 1;
            return Ok(());
        };
        let Some(table) = tables.get_mut(message) else { return Ok(()) };
        if *table == UNSEEN {
            let known = decoder.definition().messages().get(message);
            let wanted = known.is_some_and(|known| self.selection.message(&known.name));
            let number = if wanted { self.catalogue.add(name, *definition, message) } else { None };
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
        let table = if let Some(table) = self.channels.get(&place) {
            *table
        } else {
            let table = self.channel(recording, place);
            self.channels.insert(place, table);
            table
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
        let files = facts.into_iter().flatten().filter_map(|(key, sha256)| {
            Some((key.strip_prefix("definition.")?.to_owned(), sha256.clone()))
        });
        let files: Vec<_> = files.collect();
        let table = self.catalogue.add_message(&described, &files);
        self.topics.insert(key, table);
        table
    }
}
