//! What is decoded on the way and is no signal of one CAN frame: the messages of serial lines,
//! remote messages and messages of several frames. They become what `bustape decode` would write,
//! and from there rows.

use std::collections::HashMap;
use std::io;
use std::ops::{Range, RangeInclusive};

use anyhow::Result;

use super::decoders::Protocol;
use super::selection::Selection;
use crate::channels::{Counts, Sink, Stream};
use crate::commands::output;
use crate::export::TableWriter;
use crate::export::catalogue::Catalogue;
use crate::export::message_table::Described;
use crate::frame::{Frame, Notice, Stamped, Timestamp};
use crate::recording::definition::ChannelDefinition;

/// Tables of decoded channels: topic and name of the type, and the numbers of its tables.
pub type Known = HashMap<(String, String), Range<u32>>;

/// The decoded channels of one bus.
pub struct Beside {
    stream: Stream,
    files: Vec<(String, String)>,
    /// By number of the channel.
    channels: Vec<Range<u32>>,
    payload: Vec<u8>,
    /// Rows made so far.
    pub rows: u64,
}

/// Where rows go.
pub struct Place<'a> {
    /// What tables there are.
    pub catalogue: &'a mut Catalogue,
    /// Those of decoded channels.
    pub known: &'a mut Known,
    /// What is wanted.
    pub selection: &'a Selection,
    /// Between these times.
    pub range: &'a RangeInclusive<Timestamp>,
    /// Writes them.
    pub writer: &'a mut dyn TableWriter,
}

impl Beside {
    /// Begins without any frame seen.
    pub fn new(bus: &str, protocol: &Protocol) -> Self {
        Self {
            stream: Stream::beside(bus, protocol.definition.clone()),
            files: protocol.files.clone(),
            channels: Vec::new(),
            payload: Vec::new(),
            rows: 0,
        }
    }

    /// What was decoded so far.
    pub fn counts(&self) -> Counts {
        self.stream.counts()
    }

    /// True if it has ended early, with what it was fed.
    pub fn has_stopped(&self) -> bool {
        self.stream.stopped().is_some()
    }

    /// Takes a frame.
    pub fn take(&mut self, frame: &Stamped<Frame>, place: Place<'_>) -> Result<()> {
        self.run(place, |stream, tables| stream.take(frame, tables))
    }

    /// Writes what was still open.
    pub fn finish(&mut self, place: Place<'_>) -> Result<()> {
        self.run(place, |stream, tables| stream.finish(tables))
    }

    fn run(
        &mut self,
        place: Place<'_>,
        work: impl FnOnce(&mut Stream, &mut Tables<'_, '_>) -> Result<(), String>,
    ) -> Result<()> {
        let Self { stream, files, channels, payload, rows } = self;
        let mut tables = Tables { place, files, channels, payload, rows, failed: None };
        let worked = work(stream, &mut tables);
        // What cannot be written is an error of the export, not one of the decoder.
        if let Some(error) = tables.failed {
            return Err(error.into());
        }
        if let Err(why) = worked {
            output::warning(&why);
        }
        Ok(())
    }
}

/// Makes rows of messages.
struct Tables<'a, 'p> {
    place: Place<'p>,
    files: &'a [(String, String)],
    channels: &'a mut Vec<Range<u32>>,
    payload: &'a mut Vec<u8>,
    rows: &'a mut u64,
    failed: Option<io::Error>,
}

impl Tables<'_, '_> {
    /// The tables of a channel; none if it is not wanted.
    fn of(&mut self, channel: &ChannelDefinition<'_>) -> Range<u32> {
        let name = channel.topic.strip_prefix('/').and_then(|topic| topic.rsplit_once('/'));
        let (Some((bus, message)), Some(schema)) = (name, channel.schema) else { return 0..0 };
        let key = (channel.topic.clone(), schema.name.to_owned());
        if let Some(tables) = self.place.known.get(&key) {
            return tables.clone();
        }
        let described = Described {
            bus,
            message,
            schema: schema.name,
            descriptor: schema.data,
            metadata: &channel.metadata,
        };
        // Every frame of a serial line with its bytes is no message.
        let wanted = message != "frames" && self.place.selection.message(message);
        let tables =
            if wanted { self.place.catalogue.add_message(&described, self.files) } else { 0..0 };
        self.place.known.insert(key, tables.clone());
        tables
    }
}

impl Sink for Tables<'_, '_> {
    fn channels(&self) -> usize {
        self.channels.len()
    }

    fn latest(&self) -> Option<Timestamp> {
        None
    }

    fn define(&mut self, definition: ChannelDefinition<'_>) -> io::Result<u16> {
        let tables = self.of(&definition);
        self.channels.push(tables);
        u16::try_from(self.channels.len() - 1).map_err(io::Error::other)
    }

    fn add(
        &mut self,
        channel: u16,
        time: Timestamp,
        _: Timestamp,
        write: &mut dyn FnMut(&mut Vec<u8>),
    ) -> io::Result<()> {
        let tables = self.channels.get(usize::from(channel)).cloned().unwrap_or_default();
        if tables.is_empty() || !self.place.range.contains(&time) || self.failed.is_some() {
            return Ok(());
        }
        self.payload.clear();
        write(self.payload);
        for table in tables {
            let written = self.place.writer.write(self.place.catalogue, table, time, self.payload);
            if let Err(error) = written {
                self.failed = Some(error);
                return Ok(());
            }
        }
        *self.rows += 1;
        Ok(())
    }

    fn notice(&mut self, _: Timestamp, _: &str, _: &Notice) -> io::Result<()> {
        Ok(())
    }

    fn abandon(&mut self) {}
}
