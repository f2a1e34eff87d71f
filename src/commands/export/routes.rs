//! From what is read to the tables it belongs to.

use std::collections::HashMap;
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use anyhow::Result;

use super::beside::{Beside, Known, Place};
use super::can_rows::{CanRows, Lost};
use super::decoders::Decoders;
use super::report::Counts;
use super::selection::Selection;
use crate::export::TableWriter;
use crate::export::catalogue::{Catalogue, Definition};
use crate::export::message_table::Described;
use crate::frame::{Frame, Stamped, Timestamp};
use crate::recording::reader::Recording;

/// Knows where frames and decoded messages go.
pub struct Routes<'a> {
    decoders: &'a Decoders,
    selection: &'a Selection,
    buses: Vec<Bus>,
    /// Segment and channel of a recording, and the tables.
    channels: HashMap<(usize, u16), Range<u32>>,
    /// Tables of decoded channels, over all segments.
    known: Known,
    /// The tables.
    pub catalogue: Catalogue,
    /// Rows are wanted of these times.
    pub range: RangeInclusive<Timestamp>,
    /// What happened.
    pub counts: Counts,
}

/// A bus, and the tables of its messages.
struct Bus {
    name: Arc<str>,
    wanted: bool,
    /// Decodes CAN frames one by one.
    can: Option<CanRows>,
    /// Finds what is more than one CAN frame.
    several: Option<Beside>,
    /// Decodes the bytes of a serial line.
    serial: Option<Beside>,
}

impl<'a> Routes<'a> {
    /// Nothing was seen yet.
    pub fn new(decoders: &'a Decoders, selection: &'a Selection) -> Self {
        let wanted = selection.clone();
        Self {
            decoders,
            selection,
            buses: Vec::new(),
            channels: HashMap::new(),
            known: Known::new(),
            catalogue: Catalogue::new(Box::new(move |signal: &str| wanted.signal(signal))),
            range: Recording::ALL,
            counts: Counts::default(),
        }
    }

    /// True when raw frames are decoded, else the decoded channels of the recording are taken.
    pub fn decodes(&self) -> bool {
        !self.decoders.is_empty()
    }

    /// Begins anew with what is read; the tables stay.
    pub fn restart(&mut self) {
        self.counts = Counts::default();
        for bus in &mut self.buses {
            let fresh = Bus::new(&bus.name, self.decoders);
            (bus.several, bus.serial) = (fresh.several, fresh.serial);
            if let Some(can) = &mut bus.can {
                can.forget();
            }
        }
    }

    /// The index of a bus by its name.
    pub fn bus(&mut self, name: &str) -> usize {
        if let Some(index) = self.buses.iter().position(|bus| &*bus.name == name) {
            return index;
        }
        self.buses.push(Bus { wanted: self.selection.bus(name), ..Bus::new(name, self.decoders) });
        self.buses.len() - 1
    }

    /// Takes what happened on a bus.
    pub fn frame(
        &mut self,
        bus: usize,
        frame: &Stamped<Frame>,
        writer: &mut dyn TableWriter,
    ) -> Result<()> {
        let Self { buses, catalogue, counts, selection, range, known, .. } = self;
        let bus = buses.get_mut(bus).filter(|bus| bus.wanted);
        let Some(Bus { name, can, several, serial, .. }) = bus else { return Ok(()) };
        let inside = range.contains(&frame.time);
        let beside = match &frame.value {
            Frame::Can(data) => {
                counts.frames += u64::from(inside);
                let row = match can {
                    Some(can) => can.row(name, frame.time, data, catalogue, selection),
                    None => Err(Lost::Other),
                };
                match row {
                    Ok(Some((table, payload))) if inside => {
                        writer.write(catalogue, table, frame.time, payload)?;
                        counts.rows += 1;
                    }
                    Err(Lost::Unknown) => counts.unknown += u64::from(inside),
                    Err(Lost::Other) => counts.other += u64::from(inside),
                    Ok(_) | Err(Lost::Named) => {}
                }
                several
            }
            Frame::Serial(_) => {
                counts.reads += u64::from(inside);
                counts.other += u64::from(inside && serial.is_none());
                serial
            }
            Frame::Gap(_) => {
                if let Some(can) = can {
                    can.forget();
                }
                if several.is_some() { several } else { serial }
            }
            Frame::Notice(_) => return Ok(()),
        };
        let Some(beside) = beside else { return Ok(()) };
        beside.take(frame, Place { catalogue, known, selection, range, writer })
    }

    /// Writes what was still open, and adds up.
    pub fn finish(&mut self, writer: &mut dyn TableWriter) -> Result<()> {
        let Self { buses, catalogue, counts, selection, range, known, .. } = self;
        for bus in buses {
            for beside in bus.several.iter_mut().chain(&mut bus.serial) {
                beside.finish(Place { catalogue, known, selection, range, writer })?;
                counts.rows += beside.rows;
                counts.stopped |= beside.has_stopped();
            }
            if let Some(serial) = &bus.serial {
                counts.unknown += serial.counts().unknown;
                counts.invalid += serial.counts().invalid;
            }
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
        self.counts.messages += 1;
        let tables = if let Some(tables) = self.channels.get(&place) {
            tables.clone()
        } else {
            let tables = self.channel(recording, place).unwrap_or_default();
            self.channels.insert(place, tables.clone());
            tables
        };
        self.counts.rows += u64::from(!tables.is_empty());
        for table in tables {
            writer.write(&self.catalogue, table, time, data)?;
        }
        Ok(())
    }

    /// The tables of a channel.
    fn channel(
        &mut self,
        recording: &Recording,
        (segment, id): (usize, u16),
    ) -> Option<Range<u32>> {
        let segment = recording.segments.get(segment)?;
        let channel = segment.channels.get(&id)?;
        let schema = segment.schemas.get(&channel.schema)?;
        if channel.encoding != "protobuf" || schema.encoding != "protobuf" {
            return None;
        }
        let key = (channel.topic.clone(), schema.name.clone());
        if let Some(known) = self.known.get(&key) {
            return Some(known.clone());
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
        let tables = self.catalogue.add_message(&described, &files);
        self.known.insert(key, tables.clone());
        Some(tables)
    }
}

impl Bus {
    fn new(name: &str, decoders: &Decoders) -> Self {
        let [can, serial] = decoders.of(name);
        let has_several =
            |of: &Definition| !(of.can.remotes().is_empty() && of.can.assemblies().is_empty());
        let several = can.filter(|of| of.can.as_deref().is_some_and(has_several));
        let can = can.and_then(|protocol| protocol.can.as_ref()).map(CanRows::new);
        Self {
            name: name.into(),
            wanted: true,
            can,
            several: several.map(|protocol| Beside::new(name, protocol)),
            serial: serial.map(|protocol| Beside::new(name, protocol)),
        }
    }
}
