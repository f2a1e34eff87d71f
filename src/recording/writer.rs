//! One segment file of a recording: frames become messages on channels.
//!
//! Messages collect in a chunk in memory. [`SegmentWriter::cut`] writes the chunk; only then do
//! its frames count as written. The caller decides when: by size, by age, at the end.

use std::io;

use super::can_batch::BatchBuilder;
use super::chunk::Chunk;
use super::container::Container;
use super::definition::{ChannelDefinition, Facts, SchemaDefinition};
use super::disk::OutputFile;
use super::event::Event;
use super::limits::MAX_CHUNK_FRAMES;
use super::schema::{self, Schema, bustape};
use super::{can_frame, message, wire};
use crate::frame::error::CanError;
use crate::frame::{CanFrame, Frame, Gap, Notice, SerialBytes, Stamped, Timestamp};

pub use super::options::{Head, Layout, WriterOptions};

/// Where events stand: marks and triggers.
pub const EVENT_TOPIC: &str = "/bustape/event";

/// The segment file being written.
pub struct SegmentWriter {
    container: Container,
    chunk: Chunk,
    options: WriterOptions,
    buses: Vec<Bus>,
    log: Option<u16>,
    clock: Option<u16>,
    event: Option<u16>,
    /// When the oldest message of the open chunk was added, by the caller's reckoning.
    span: Option<(Timestamp, Timestamp)>,
    frames: bool,
    events: bool,
}

/// One bus's channels, and what of it is in the open chunk.
struct Bus {
    name: String,
    raw: Option<u16>,
    gaps: Option<u16>,
    stats: Option<u16>,
    errors: Option<u16>,
    batch: BatchBuilder,
    /// Frames in batches of the open chunk.
    batched: usize,
    pending: u64,
}

impl SegmentWriter {
    /// Writes the head of a segment. The caller syncs.
    pub fn create(
        out: Box<dyn OutputFile>,
        options: WriterOptions,
        head: &Head,
    ) -> io::Result<Self> {
        let mut container = Container::create(out, options.compression)?;
        let mut recording = head.recording.clone();
        recording.insert("layout".to_owned(), options.layout.name().to_owned());
        if options.layout == Layout::Batch {
            recording.insert("batch_max_ns".to_owned(), options.batch_nanos.to_string());
        }
        container.metadata("bustape.recording", recording)?;
        for (name, facts) in &head.buses {
            container.metadata(&format!("bustape.bus.{name}"), facts.clone())?;
        }
        container.metadata("bustape.clock", head.clock.clone())?;
        for (name, facts) in &head.more {
            container.metadata(name, facts.clone())?;
        }
        for attachment in &head.attachments {
            container.attachment(head.time.nanos(), attachment)?;
        }
        let buses = head.buses.iter().map(|(name, _)| Bus::new(name, options.batch_frames));
        container.hold_room(2 * options.chunk_bytes as u64);
        Ok(Self {
            container,
            chunk: Chunk::default(),
            options,
            buses: buses.collect(),
            log: None,
            clock: None,
            event: None,
            span: None,
            frames: false,
            events: false,
        })
    }

    /// Adds a bus that was not known when the segment was created: its number is the next one.
    pub fn add_bus(&mut self, name: &str, facts: Facts) -> io::Result<()> {
        self.container.metadata(&format!("bustape.bus.{name}"), facts)?;
        self.buses.push(Bus::new(name, self.options.batch_frames));
        Ok(())
    }

    /// Adds something that happened on bus number `bus`.
    pub fn add(&mut self, bus: usize, frame: &Stamped<Frame>) -> io::Result<()> {
        match &frame.value {
            Frame::Can(can) => self.add_can(bus, frame.time, can),
            Frame::Serial(bytes) => self.add_serial(bus, frame.time, bytes),
            Frame::Gap(gap) => self.add_gap(bus, frame.time, gap),
            Frame::Notice(notice) => {
                let name = self.buses[bus].name.clone();
                self.add_notice(frame.time, &name, notice)
            }
        }?;
        self.buses[bus].pending += frame.value.weight();
        self.frames |= frame.value.weight() > 0;
        Ok(())
    }

    fn add_can(&mut self, bus: usize, time: Timestamp, frame: &CanFrame) -> io::Result<()> {
        if self.options.layout == Layout::Batch {
            let batch = &mut self.buses[bus].batch;
            let too_long = batch.first().is_some_and(|t| time.since(t) > self.options.batch_nanos);
            // A batch keeps times in order, which those of an imported log need not be.
            let back = batch.last().is_some_and(|last| time < last);
            if batch.is_full() || too_long || back {
                self.finish_batch(bus)?;
            }
            self.buses[bus].batch.push(time, frame);
            self.note(time);
            return Ok(());
        }
        let channel = self.raw_channel(bus, schema::CAN_FRAME)?;
        let (open, out) = self.chunk.begin(channel, time);
        can_frame::encode(frame, out);
        self.chunk.end(open);
        self.note(time);
        Ok(())
    }

    fn add_serial(&mut self, bus: usize, time: Timestamp, bytes: &SerialBytes) -> io::Result<()> {
        let channel = self.raw_channel(bus, schema::SERIAL_BYTES)?;
        let (open, out) = self.chunk.begin(channel, time);
        message::encode_serial(bytes, out);
        self.chunk.end(open);
        self.note(time);
        Ok(())
    }

    fn add_gap(&mut self, bus: usize, time: Timestamp, gap: &Gap) -> io::Result<()> {
        let known = self.buses[bus].gaps;
        let channel = self.bus_channel(bus, known, "gaps", schema::GAP)?;
        self.buses[bus].gaps = Some(channel);
        self.add_message(channel, time, &message::gap(gap));
        Ok(())
    }

    /// Adds what an error frame says, beside the frame itself.
    pub fn add_error(&mut self, bus: usize, time: Timestamp, error: &CanError) -> io::Result<()> {
        let known = self.buses[bus].errors;
        let channel = self.bus_channel(bus, known, "errors", schema::CAN_ERROR)?;
        self.buses[bus].errors = Some(channel);
        self.add_message(channel, time, &message::can_error(error));
        Ok(())
    }

    /// Adds a bus's statistics.
    pub fn add_stats(
        &mut self,
        bus: usize,
        time: Timestamp,
        stats: &bustape::BusStats,
    ) -> io::Result<()> {
        let known = self.buses[bus].stats;
        let channel = self.bus_channel(bus, known, "stats", schema::BUS_STATS)?;
        self.buses[bus].stats = Some(channel);
        self.add_message(channel, time, stats);
        Ok(())
    }

    /// Adds a reading of both clocks.
    pub fn add_clock(&mut self, time: Timestamp, sync: &bustape::ClockSync) -> io::Result<()> {
        let channel = match self.clock {
            Some(channel) => channel,
            None => self.new_channel("/bustape/clock", schema::CLOCK_SYNC, Facts::new())?,
        };
        self.clock = Some(channel);
        self.add_message(channel, time, sync);
        Ok(())
    }

    /// Adds a sentence about `name`: a bus, or `bustape` itself.
    pub fn add_notice(&mut self, time: Timestamp, name: &str, notice: &Notice) -> io::Result<()> {
        let channel = match self.log {
            Some(channel) => channel,
            None => self.new_channel("/bustape/log", schema::LOG, Facts::new())?,
        };
        self.log = Some(channel);
        self.add_message(channel, time, &message::log(time, name, notice));
        Ok(())
    }

    /// Adds a mark or a trigger. The segment then holds an event, and is kept.
    pub fn add_event(&mut self, event: &Event) -> io::Result<()> {
        let channel = match self.event {
            Some(channel) => channel,
            None => self.new_channel(EVENT_TOPIC, schema::EVENT, Facts::new())?,
        };
        self.event = Some(channel);
        self.add_message(channel, event.time, &event.message());
        Ok(())
    }

    fn add_message(&mut self, channel: u16, time: Timestamp, message: &impl prost::Message) {
        let (open, out) = self.chunk.begin(channel, time);
        wire::append(out, message);
        self.chunk.end(open);
        self.note(time);
    }

    fn raw_channel(&mut self, bus: usize, schema: Schema) -> io::Result<u16> {
        if let Some(channel) = self.buses[bus].raw {
            return Ok(channel);
        }
        let channel = self.bus_channel(bus, None, "raw", schema)?;
        self.buses[bus].raw = Some(channel);
        Ok(channel)
    }

    fn bus_channel(
        &mut self,
        bus: usize,
        known: Option<u16>,
        topic: &str,
        schema: Schema,
    ) -> io::Result<u16> {
        if let Some(channel) = known {
            return Ok(channel);
        }
        let name = self.buses[bus].name.clone();
        let topic = format!("/{name}/{topic}");
        self.new_channel(&topic, schema, Facts::from([("bus".to_owned(), name)]))
    }

    fn new_channel(&mut self, topic: &str, schema: Schema, metadata: Facts) -> io::Result<u16> {
        let Schema { name, descriptor: data } = schema;
        self.define(ChannelDefinition {
            topic: topic.to_owned(),
            encoding: "protobuf".to_owned(),
            schema: Some(SchemaDefinition { name, encoding: "protobuf", data }),
            metadata,
        })
    }

    /// Defines any other channel, for [`SegmentWriter::add_raw`].
    pub fn define(&mut self, definition: ChannelDefinition<'_>) -> io::Result<u16> {
        self.events |= definition.topic == EVENT_TOPIC;
        self.container.channel(&mut self.chunk, definition)
    }

    /// Adds a message of a channel defined before, as it is.
    pub fn add_raw(&mut self, channel: u16, time: Timestamp, data: &[u8]) {
        let (open, out) = self.chunk.begin(channel, time);
        out.extend_from_slice(data);
        self.chunk.end(open);
        self.note(time);
    }

    /// Adds a message of a channel defined before; `write` appends its payload. It was known at
    /// `now`, which may be later than its own time.
    #[inline]
    pub fn add_with(
        &mut self,
        channel: u16,
        time: Timestamp,
        now: Timestamp,
        write: impl FnOnce(&mut Vec<u8>),
    ) {
        let (open, out) = self.chunk.begin(channel, time);
        write(out);
        self.chunk.end(open);
        self.note(now);
    }

    /// Takes back a message whose `write` has panicked.
    pub fn abandon(&mut self) {
        self.chunk.abandon();
    }

    /// How many channels the file has so far.
    pub fn channels(&self) -> usize {
        self.container.channels()
    }

    fn note(&mut self, time: Timestamp) {
        let span = self.span.get_or_insert((time, time));
        span.0 = span.0.min(time);
        span.1 = span.1.max(time);
    }

    fn finish_batch(&mut self, bus: usize) -> io::Result<()> {
        let Some(first) = self.buses[bus].batch.first() else { return Ok(()) };
        let channel = self.raw_channel(bus, schema::CAN_BATCH)?;
        let (open, out) = self.chunk.begin(channel, first);
        self.buses[bus].batched += self.buses[bus].batch.len();
        self.buses[bus].batch.finish(out);
        self.chunk.end(open);
        Ok(())
    }

    /// True when the open chunk has grown to its size, or holds as many frames as a reader takes.
    pub fn is_full(&self) -> bool {
        let frames = || self.buses.iter().map(|bus| bus.batched).sum::<usize>();
        self.chunk.len() >= self.options.chunk_bytes || frames() >= MAX_CHUNK_FRAMES / 2
    }

    /// Times of the earliest and latest thing that is not in the file yet.
    pub fn pending_span(&self) -> Option<(Timestamp, Timestamp)> {
        self.span
    }

    /// Writes the open chunk, with the open batches. Afterwards [`SegmentWriter::take_counts`]
    /// tells what has reached the file, also after an error: then nothing of it has.
    pub fn cut(&mut self) -> io::Result<()> {
        for bus in 0..self.buses.len() {
            self.finish_batch(bus)?;
        }
        self.buses.iter_mut().for_each(|bus| bus.batched = 0);
        self.span = None;
        self.container.write_chunk(&mut self.chunk)?;
        self.container.hold_room(2 * self.options.chunk_bytes as u64);
        Ok(())
    }

    /// What was in the chunk that was cut last, for each bus in its unit.
    pub fn take_counts(&mut self) -> impl Iterator<Item = u64> {
        self.buses.iter_mut().map(|bus| std::mem::take(&mut bus.pending))
    }

    /// True once a frame of a bus is in this segment. The first time in a file is a frame's, so
    /// whatever describes the recorder itself waits for that.
    pub fn has_frames(&self) -> bool {
        self.frames
    }

    /// Cuts the open chunk, writes the totals and the file's summary. The caller syncs.
    pub fn finish(&mut self, summary: Facts) -> io::Result<()> {
        self.cut()?;
        self.container.metadata("bustape.summary", summary)?;
        self.container.finish()
    }

    /// Returns when everything written so far would survive a power cut.
    pub fn sync(&mut self) -> io::Result<()> {
        self.container.sync()
    }

    /// Bytes in the file so far.
    pub fn position(&self) -> u64 {
        self.container.position()
    }

    /// True once there is an event in this segment.
    pub fn holds_event(&self) -> bool {
        self.events
    }

    /// About as many bytes as writing the open chunk and the end of the file would take at most.
    pub fn bytes_to_come(&self) -> u64 {
        let batched: usize = self.buses.iter().map(|bus| bus.batch.len()).sum();
        let frames = batched * size_of::<CanFrame>();
        (self.chunk.len() + frames) as u64 + self.container.tail()
    }

    /// Bytes in the file, and about as many as the open chunk will add.
    pub fn expected_size(&self) -> u64 {
        self.container.position() + self.chunk.len() as u64 / 2
    }
}

impl Bus {
    fn new(name: &str, batch_frames: usize) -> Self {
        Self {
            name: name.to_owned(),
            raw: None,
            gaps: None,
            stats: None,
            errors: None,
            batch: BatchBuilder::new(batch_frames),
            batched: 0,
            pending: 0,
        }
    }
}
