//! The decoded channels of one bus, beside its raw one.
//!
//! Whatever happens here, a raw recording goes on: a decoder that fails or panics is not asked
//! again, and what it had begun to write is taken back.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::definition::Definition;
use super::schema::Schema;
use crate::frame::{Frame, Notice, Stamped, Timestamp};
use crate::recording::definition::{ChannelDefinition, Facts, SchemaDefinition};
use crate::recording::writer::SegmentWriter;

/// So many of the 65,535 channels of a file may be decoded ones; the raw ones need the rest.
const MOST_CHANNELS: usize = 60_000;

/// What was decoded so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages written.
    pub messages: u64,
    /// Frames that the definition does not know.
    pub unknown: u64,
    /// What was on the line and is no frame, or a frame with a wrong check.
    pub invalid: u64,
}

/// Makes messages of frames.
pub trait Decode: Send {
    /// Takes the next frame of the bus, in the order of the recording.
    fn take(&mut self, frame: &Stamped<Frame>, out: &mut Out<'_>) -> io::Result<()>;

    /// Says that it is `time`, and nothing from before it will come any more.
    fn pass(&mut self, time: Timestamp, out: &mut Out<'_>) -> io::Result<()>;

    /// Says that nothing more comes.
    fn finish(&mut self, out: &mut Out<'_>) -> io::Result<()>;
}

/// What decoded messages go into: the open segment of a recording, or tables.
pub trait Sink {
    /// How many channels there are.
    fn channels(&self) -> usize;
    /// Time of the latest message that waits to be written, if one does.
    fn latest(&self) -> Option<Timestamp>;
    /// Defines a channel; its number.
    fn define(&mut self, definition: ChannelDefinition<'_>) -> io::Result<u16>;
    /// Adds a message of a channel defined before; `write` appends its payload, and is called once.
    /// The message was known at `now`, which may be later than its own time.
    fn add(
        &mut self,
        channel: u16,
        time: Timestamp,
        now: Timestamp,
        write: &mut dyn FnMut(&mut Vec<u8>),
    ) -> io::Result<()>;
    /// Adds a sentence about `name`.
    fn notice(&mut self, time: Timestamp, name: &str, notice: &Notice) -> io::Result<()>;
    /// Takes back a message whose `write` has panicked.
    fn abandon(&mut self);
}

impl Sink for SegmentWriter {
    fn channels(&self) -> usize {
        Self::channels(self)
    }

    fn latest(&self) -> Option<Timestamp> {
        self.pending_span().map(|(_, last)| last)
    }

    fn define(&mut self, definition: ChannelDefinition<'_>) -> io::Result<u16> {
        Self::define(self, definition)
    }

    #[inline]
    fn add(
        &mut self,
        channel: u16,
        time: Timestamp,
        now: Timestamp,
        write: &mut dyn FnMut(&mut Vec<u8>),
    ) -> io::Result<()> {
        self.add_with(channel, time, now, write);
        Ok(())
    }

    fn notice(&mut self, time: Timestamp, name: &str, notice: &Notice) -> io::Result<()> {
        self.add_notice(time, name, notice)
    }

    fn abandon(&mut self) {
        Self::abandon(self);
    }
}

/// Where a decoder's messages go.
pub struct Out<'a> {
    sink: &'a mut dyn Sink,
    names: &'a Names,
    ids: &'a mut Vec<u16>,
    now: Timestamp,
    /// What is counted.
    pub counts: &'a mut Counts,
}

/// What the channels of a bus have in common.
struct Names {
    bus: String,
    protocol: String,
}

/// No channel yet in this segment. Ids stay below it, see [`MOST_CHANNELS`].
const NONE: u16 = u16::MAX;

impl Out<'_> {
    /// Adds a message on the decoder's channel number `channel`; `define` gives the last part of
    /// its topic and its schema when a segment first needs it.
    #[inline]
    pub fn add(
        &mut self,
        channel: usize,
        time: Timestamp,
        define: impl FnOnce() -> Option<(String, Schema)>,
        mut write: impl FnMut(&mut Vec<u8>),
    ) -> io::Result<()> {
        let id = match self.ids.get(channel) {
            Some(&id) if id != NONE => id,
            _ => match define() {
                Some((topic, schema)) => self.define(channel, &topic, schema)?,
                None => return Ok(()),
            },
        };
        self.sink.add(id, time, self.now, &mut write)?;
        self.counts.messages += 1;
        Ok(())
    }

    #[cold]
    fn define(&mut self, channel: usize, topic: &str, schema: Schema) -> io::Result<u16> {
        if self.sink.channels() >= MOST_CHANNELS {
            return Err(io::Error::other(format!(
                "a file has room for {MOST_CHANNELS} decoded channels; use a definition with fewer \
                 messages"
            )));
        }
        let Schema { name, descriptor, facts: mut metadata } = schema;
        metadata.insert("bus".to_owned(), self.names.bus.clone());
        metadata.insert("protocol".to_owned(), self.names.protocol.clone());
        // A name with a slash would look like a part of the bus to whoever reads the topic.
        let topic = topic.replace('/', "_");
        let id = self.sink.define(ChannelDefinition {
            topic: format!("/{}/{topic}", self.names.bus),
            encoding: "protobuf".to_owned(),
            schema: Some(SchemaDefinition { name: &name, encoding: "protobuf", data: &descriptor }),
            metadata,
        })?;
        if self.ids.len() <= channel {
            self.ids.resize(channel + 1, NONE);
        }
        self.ids[channel] = id;
        Ok(id)
    }

    /// Adds a sentence to `/bustape/log`, about `what` of this bus.
    pub fn log(&mut self, time: Timestamp, what: &str, notice: &Notice) -> io::Result<()> {
        let name = format!("{}/{what}", self.names.bus);
        self.sink.notice(time, &name, notice)
    }
}

/// The decoded channels of one bus.
pub struct Stream {
    names: Names,
    facts: Facts,
    decoder: Box<dyn Decode>,
    /// The channels of the open segment, by the decoder's numbers.
    ids: Vec<u16>,
    counts: Counts,
    /// Why it does not decode any more.
    stopped: Option<String>,
}

impl Stream {
    /// Decodes `bus` by `definition`.
    pub fn new(bus: &str, definition: Definition) -> Self {
        Self::compiled(bus, definition, true)
    }

    /// The same without messages of one CAN frame, for who decodes those another way: remote
    /// messages, messages of several frames, and all of a serial line.
    pub fn beside(bus: &str, definition: Definition) -> Self {
        Self::compiled(bus, definition, false)
    }

    fn compiled(bus: &str, definition: Definition, single: bool) -> Self {
        let names = Names { bus: bus.to_owned(), protocol: definition.protocol.clone() };
        let facts = definition.facts();
        Self::with(names, facts, definition.decoder(single))
    }

    #[cfg(test)]
    pub(super) fn of(bus: &str, protocol: &str, decoder: Box<dyn Decode>) -> Self {
        let names = Names { bus: bus.to_owned(), protocol: protocol.to_owned() };
        Self::with(names, Facts::new(), decoder)
    }

    fn with(names: Names, facts: Facts, decoder: Box<dyn Decode>) -> Self {
        let counts = Counts::default();
        Self { names, facts, decoder, ids: Vec::new(), counts, stopped: None }
    }

    /// The bus that it decodes.
    pub fn bus(&self) -> &str {
        &self.names.bus
    }

    /// What it decodes with.
    pub fn protocol(&self) -> &str {
        &self.names.protocol
    }

    /// For the metadata of the bus; see [`Definition::facts`].
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// What was decoded so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Why it does not decode any more, if it has stopped.
    pub fn stopped(&self) -> Option<&str> {
        self.stopped.as_deref()
    }

    /// Adds what was decoded to `bustape.summary`.
    pub fn sum_up(&self, summary: &mut Facts) {
        let Counts { messages, unknown, invalid } = self.counts;
        let mut put = |key: &str, value: String| {
            summary.insert(format!("{}.{key}", self.names.bus), value);
        };
        put("decoded", messages.to_string());
        put("unknown", unknown.to_string());
        put("invalid", invalid.to_string());
        if let Some(why) = &self.stopped {
            put("decode_error", why.clone());
        }
    }

    /// A new segment begins, with no channels in it.
    pub fn new_segment(&mut self) {
        self.ids.clear();
    }

    /// Decodes a frame, in the order of the recording. The error, once, is why it has stopped.
    pub fn take(&mut self, frame: &Stamped<Frame>, sink: &mut dyn Sink) -> Result<(), String> {
        self.run(frame.time, sink, |decoder, out| decoder.take(frame, out))
    }

    /// Says that it is `time`, and nothing from before it will come any more.
    pub fn pass(&mut self, time: Timestamp, sink: &mut dyn Sink) -> Result<(), String> {
        self.run(time, sink, |decoder, out| decoder.pass(time, out))
    }

    /// Says that nothing more comes.
    pub fn finish(&mut self, sink: &mut dyn Sink) -> Result<(), String> {
        let now = sink.latest().unwrap_or(Timestamp(0));
        self.run(now, sink, |decoder, out| decoder.finish(out))
    }

    #[inline]
    fn run(
        &mut self,
        now: Timestamp,
        sink: &mut dyn Sink,
        work: impl FnOnce(&mut dyn Decode, &mut Out<'_>) -> io::Result<()>,
    ) -> Result<(), String> {
        if self.stopped.is_some() {
            return Ok(());
        }
        let Self { names, decoder, ids, counts, .. } = self;
        let mut out = Out { sink, names, ids, now, counts };
        // What a panic leaves half done is not used again: the decoder is stopped, and the writer
        // takes back the message that was open.
        let done = catch_unwind(AssertUnwindSafe(|| work(&mut **decoder, &mut out)));
        let why = match done {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => error.to_string(),
            Err(panic) => {
                out.sink.abandon();
                said(&*panic)
            }
        };
        let Names { bus, protocol } = &self.names;
        let text = format!(
            "{bus} is not decoded with {protocol} any more: {why}. The recording of {bus} itself \
             goes on"
        );
        self.stopped = Some(text.clone());
        Err(text)
    }
}

/// What a panic says.
fn said(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    format!("a fault in the decoder ({})", text.as_deref().unwrap_or("without a reason"))
}
