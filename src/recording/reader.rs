//! A recording, opened for reading: one or many segment files as one row of frames in time order.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::disk::is_same;
use super::limits::{MAX_CHUNK_FRAMES, MAX_READY};
use super::ready::Ready;
use super::records::{ChunkRef, Message, Record, channel_bit, records};
use super::segment::{Ending, ReadError, Segment};
use super::{can_batch, can_frame, message};
use crate::frame::{Frame, Stamped, Timestamp};

/// A recording.
pub struct Recording {
    /// Its segments, by time.
    pub segments: Vec<Segment>,
    /// Its buses, in the order of first mention.
    pub buses: Vec<String>,
}

/// Something read from a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// Something that happened on a bus: its index in [`Recording::buses`], and the frame.
    Frame(usize, Frame),
    /// A message of any other channel.
    Message {
        /// Index of the segment.
        segment: usize,
        /// Id of the channel in that segment.
        channel: u16,
        /// The payload.
        data: Vec<u8>,
    },
}

impl Entry {
    /// The order of things at the same time: a batch cannot tell how its frames stood among the
    /// messages around it, so that neither layout is read by where they stand.
    pub(super) fn rank(&self) -> (usize, bool) {
        match self {
            Self::Frame(bus, frame) => (*bus, !matches!(frame, Frame::Gap(_))),
            Self::Message { .. } => (usize::MAX, true),
        }
    }
}

impl Recording {
    /// Opens files; a folder stands for all recordings in it.
    pub fn open(paths: &[PathBuf]) -> Result<Self, ReadError> {
        let mut segments = Vec::new();
        for path in paths {
            for file in files_of(path)? {
                segments.push(Segment::open(&file)?);
            }
        }
        segments.sort_by_key(started);
        let mut buses: Vec<String> = Vec::new();
        for name in segments.iter().flat_map(bus_names) {
            if !buses.contains(&name) {
                buses.push(name);
            }
        }
        Ok(Self { segments, buses })
    }

    /// All of time.
    pub const ALL: RangeInclusive<Timestamp> = Timestamp(0)..=Timestamp(u64::MAX);

    /// Times of the first and last message, or frame.
    pub fn span(&self) -> Option<(Timestamp, Timestamp)> {
        let spans = || self.segments.iter().map(|s| s.statistics.span).filter(|s| s.1 != 0);
        let (start, end) = (spans().map(|s| s.0).min()?, spans().map(|s| s.1).max()?);
        let batches = (0..self.segments.len()).filter_map(|index| self.last_batched(index, end));
        Some((Timestamp(start), Timestamp(batches.fold(end, u64::max))))
    }

    /// The time of the last frame in a segment's batches, if it can be later than `end`: a batch has
    /// the log time of its first frame. Only chunks that can hold it are read.
    fn last_batched(&self, index: usize, end: u64) -> Option<u64> {
        let segment = &self.segments[index];
        let widest = batch_nanos(segment);
        if widest == 0 || segment.statistics.span.1.saturating_add(widest) <= end {
            return None;
        }
        let kinds = self.kinds(segment, |topic| topic.ends_with("/raw"));
        let is_batch =
            |channel: u16| matches!(kinds.get(usize::from(channel)), Some(Kind::CanBatch(_)));
        let mut last = None;
        let mut chunk_records = Vec::new();
        for chunk in segment.chunks.iter().filter(|c| c.end.saturating_add(widest) > end) {
            if segment.read_chunk(*chunk, &mut chunk_records).is_err() {
                continue;
            }
            let messages = records(&chunk_records).filter(|record| record.opcode == op::MESSAGE);
            let batches = messages.filter_map(|record| Message::of(record.body));
            for Message { log_time, data, .. } in batches.filter(|m| is_batch(m.channel)) {
                let frames = can_batch::decode(Timestamp(log_time), data).unwrap_or_default();
                last = last.max(frames.last().map(|frame| frame.time.nanos()));
            }
        }
        last
    }

    /// Everything on the wanted topics within a range of time, in time order. Chunks that hold
    /// nothing wanted are not read.
    pub fn entries(
        &self,
        range: RangeInclusive<Timestamp>,
        wanted: impl Fn(&str) -> bool,
    ) -> Entries<'_> {
        self.read(range, |segment| self.kinds(segment, &wanted))
    }

    /// Every message as it stands in the file, in time order: frames as [`Entry::Message`], too.
    /// [`Carriers::frames`] tells what is in one.
    pub fn messages(&self) -> Entries<'_> {
        let other = |kind| if let Kind::Unwanted = kind { kind } else { Kind::Other };
        self.read(Self::ALL, |segment| {
            self.kinds(segment, |_| true).into_iter().map(other).collect()
        })
    }

    fn read(
        &self,
        range: RangeInclusive<Timestamp>,
        kinds_of: impl Fn(&Segment) -> Vec<Kind>,
    ) -> Entries<'_> {
        let (from, to) = (range.start().nanos(), range.end().nanos());
        let mut chunks = Vec::new();
        let mut kinds = Vec::new();
        for (index, segment) in self.segments.iter().enumerate() {
            let of_segment = kinds_of(segment);
            let ids =
                (0..=u16::MAX).zip(&of_segment).filter(|(_, kind)| !matches!(kind, Kind::Unwanted));
            let mask = ids.fold(0, |mask, (id, _)| mask | channel_bit(id));
            let widen = batch_nanos(segment);
            let matches = |chunk: &&ChunkRef| {
                // A file that was cut off before the index of its last chunk does not tell.
                let holds = chunk.channels == 0 || chunk.channels & mask != 0;
                holds && chunk.start <= to && chunk.end.saturating_add(widen) >= from
            };
            chunks.extend(segment.chunks.iter().filter(matches).map(|chunk| (index, *chunk)));
            kinds.push(of_segment);
        }
        chunks.sort_by_key(|(_, chunk)| chunk.start);
        chunks.reverse();
        let (ready, run, records) = (Ready::default(), Vec::new(), Vec::new());
        let (damage, disorder) = (Vec::new(), false);
        Entries { recording: self, range, chunks, kinds, ready, run, records, damage, disorder }
    }

    /// For each segment what its channels carry, for [`Carriers::frames`].
    pub fn carriers(&self) -> Carriers {
        Carriers(self.segments.iter().map(|segment| self.kinds(segment, |_| true)).collect())
    }

    /// What each channel of a segment carries, by channel id.
    fn kinds(&self, segment: &Segment, wanted: impl Fn(&str) -> bool) -> Vec<Kind> {
        let mut kinds = Vec::new();
        for channel in segment.channels.values().filter(|channel| wanted(&channel.topic)) {
            let schema = segment.schemas.get(&channel.schema).map(|s| s.name.as_str());
            let bus = channel.metadata.get("bus");
            let bus = bus.and_then(|name| self.buses.iter().position(|b| b == name));
            let kind = match (bus, schema) {
                (Some(bus), Some("bustape.CanFrame")) => Kind::CanFrame(bus),
                (Some(bus), Some("bustape.CanBatch")) => Kind::CanBatch(bus),
                (Some(bus), Some("bustape.SerialBytes")) => Kind::Serial(bus),
                (Some(bus), Some("bustape.Gap")) => Kind::Gap(bus),
                _ => Kind::Other,
            };
            let id = usize::from(channel.id);
            if kinds.len() <= id {
                kinds.resize(id + 1, Kind::Unwanted);
            }
            kinds[id] = kind;
        }
        kinds
    }

    /// The segments that were not finished.
    pub fn unfinished(&self) -> impl Iterator<Item = &Segment> {
        self.segments.iter().filter(|segment| segment.ending != Ending::Finished)
    }
}

/// What every channel of a recording carries; see [`Recording::carriers`].
pub struct Carriers(Vec<Vec<Kind>>);

impl Carriers {
    /// The bus whose frames are on a channel: its index in [`Recording::buses`].
    pub fn bus(&self, segment: usize, channel: u16) -> Option<usize> {
        match self.kind(segment, channel) {
            Kind::CanFrame(bus) | Kind::CanBatch(bus) | Kind::Serial(bus) | Kind::Gap(bus) => {
                Some(bus)
            }
            Kind::Other | Kind::Unwanted => None,
        }
    }

    /// Puts the frames in a message of that channel into `frames`; false when it is not understood.
    pub fn frames(
        &self,
        (segment, channel): (usize, u16),
        time: Timestamp,
        data: &[u8],
        frames: &mut Vec<Stamped<Frame>>,
    ) -> bool {
        let frame = match self.kind(segment, channel) {
            Kind::CanBatch(_) => {
                let batch = can_batch::decode(time, data);
                let known = batch.is_some();
                let batch = batch.into_iter().flatten();
                frames.extend(
                    batch.map(|can| Stamped { time: can.time, value: Frame::Can(can.value) }),
                );
                return known;
            }
            Kind::CanFrame(_) => can_frame::decode(data).map(Frame::Can),
            Kind::Serial(_) => message::decode_serial(data).map(Frame::Serial),
            Kind::Gap(_) => message::decode_gap(data).map(Frame::Gap),
            Kind::Other | Kind::Unwanted => None,
        };
        let known = frame.is_some();
        frames.extend(frame.map(|value| Stamped { time, value }));
        known
    }

    fn kind(&self, segment: usize, channel: u16) -> Kind {
        let kinds = self.0.get(segment);
        kinds.and_then(|kinds| kinds.get(usize::from(channel))).copied().unwrap_or(Kind::Unwanted)
    }
}

/// What a channel carries, and for which bus.
#[derive(Clone, Copy)]
enum Kind {
    CanFrame(usize),
    CanBatch(usize),
    Serial(usize),
    Gap(usize),
    Other,
    Unwanted,
}

/// Entries in time order; see [`Recording::entries`].
pub struct Entries<'a> {
    recording: &'a Recording,
    range: RangeInclusive<Timestamp>,
    /// Chunks not read yet, the earliest last.
    chunks: Vec<(usize, ChunkRef)>,
    kinds: Vec<Vec<Kind>>,
    /// What was read.
    ready: Ready,
    /// The chunk that is being read.
    run: Vec<Stamped<Entry>>,
    records: Vec<u8>,
    damage: Vec<String>,
    /// It was said that the order may be wrong.
    disorder: bool,
}

impl Entries<'_> {
    /// What could not be read so far, a sentence each.
    pub fn damage(&self) -> &[String] {
        &self.damage
    }

    /// Bytes of chunks still to be read, for a progress display.
    pub fn bytes_left(&self) -> u64 {
        self.chunks.iter().map(|(_, chunk)| chunk.length).sum()
    }

    /// Chunks overlap a little where several buses are recorded, so the next entry is only known
    /// once every chunk that begins before it has been read.
    fn load(&mut self) {
        while let Some(&(segment, chunk)) = self.chunks.last() {
            if self.ready.next_time().is_some_and(|next| next.nanos() < chunk.start) {
                return;
            }
            if self.ready.is_full() {
                return self.say_disorder(segment);
            }
            self.chunks.pop();
            let mut records_of_chunk = std::mem::take(&mut self.records);
            match self.recording.segments[segment].read_chunk(chunk, &mut records_of_chunk) {
                Ok(()) => self.take_chunk(segment, &records_of_chunk),
                Err(error) => self.damage.push(error.to_string()),
            }
            self.records = records_of_chunk;
        }
    }

    /// So much is of one time that it cannot all be held.
    fn say_disorder(&mut self, segment: usize) {
        if !std::mem::replace(&mut self.disorder, true) {
            let text = format!(
                "more than {} MiB of messages overlap in time: they may be out of order",
                MAX_READY >> 20
            );
            self.say(segment, &text);
        }
    }

    fn say(&mut self, segment: usize, what: &str) {
        self.damage.push(format!("{}: {what}", self.recording.segments[segment].path.display()));
    }

    fn take_chunk(&mut self, segment: usize, bytes: &[u8]) {
        let (mut consumed, mut strange) = (0, 0_u64);
        for Record { opcode, body } in records(bytes) {
            consumed += super::records::HEAD + body.len();
            if self.run.len() > MAX_CHUNK_FRAMES {
                let text = format!(
                    "a chunk with more than {MAX_CHUNK_FRAMES} frames: the rest is passed over"
                );
                self.say(segment, &text);
                consumed = bytes.len();
                break;
            }
            strange += u64::from(opcode == op::MESSAGE && !self.take_message(segment, body));
        }
        match strange {
            0 => {}
            1 => self.say(segment, "a message could not be understood"),
            more => self.say(segment, &format!("{more} messages could not be understood")),
        }
        if consumed != bytes.len() {
            self.say(segment, "a chunk ends in the middle of a record");
        }
        self.ready.add(std::mem::take(&mut self.run));
    }

    fn take_message(&mut self, segment: usize, body: &[u8]) -> bool {
        let Some(Message { channel, log_time, data }) = Message::of(body) else { return false };
        let time = Timestamp(log_time);
        let kind = self.kinds[segment].get(usize::from(channel)).copied();
        let entry = match kind.unwrap_or(Kind::Unwanted) {
            Kind::Unwanted => return true,
            Kind::CanBatch(bus) => return self.take_batch(bus, time, data),
            Kind::CanFrame(bus) => can_frame::decode(data).map(|f| (bus, Frame::Can(f))),
            Kind::Serial(bus) => message::decode_serial(data).map(|b| (bus, Frame::Serial(b))),
            Kind::Gap(bus) => message::decode_gap(data).map(|g| (bus, Frame::Gap(g))),
            Kind::Other => {
                let value = Entry::Message { segment, channel, data: data.to_vec() };
                self.take_entry(time, value);
                return true;
            }
        };
        let Some((bus, frame)) = entry else { return false };
        self.take_entry(time, Entry::Frame(bus, frame));
        true
    }

    fn take_batch(&mut self, bus: usize, time: Timestamp, data: &[u8]) -> bool {
        let Some(frames) = can_batch::decode(time, data) else { return false };
        for Stamped { time, value } in frames {
            self.take_entry(time, Entry::Frame(bus, Frame::Can(value)));
        }
        true
    }

    fn take_entry(&mut self, time: Timestamp, value: Entry) {
        if self.range.contains(&time) {
            self.run.push(Stamped { time, value });
        }
    }
}

impl Iterator for Entries<'_> {
    type Item = Stamped<Entry>;

    fn next(&mut self) -> Option<Self::Item> {
        self.load();
        self.ready.pop()
    }
}

/// The longest time that a batch of a segment spans; 0 where it has none.
fn batch_nanos(segment: &Segment) -> u64 {
    let widest = segment.fact("bustape.recording", "batch_max_ns");
    widest.and_then(|text| text.parse().ok()).unwrap_or(0)
}

/// When a segment begins: its first message, or, if it has none, when it was made.
fn started(segment: &Segment) -> u64 {
    let (first, _) = segment.statistics.span;
    let made = || segment.fact("bustape.clock", "log_time_ns")?.parse().ok();
    if first > 0 { first } else { made().unwrap_or(0) }
}

/// The bus names a segment mentions: in its metadata, in order, then in its channels.
fn bus_names(segment: &Segment) -> Vec<String> {
    let ours = segment.metadata.keys().filter_map(|name| name.strip_prefix("bustape.bus."));
    let mut names: Vec<String> = ours.map(str::to_owned).collect();
    let channels = segment.channels.values().filter_map(|c| c.metadata.get("bus"));
    for name in channels {
        if !names.contains(name) {
            names.push(name.clone());
        }
    }
    names
}

/// The recordings that a path stands for: itself, or those in a folder, by name.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let failed = |error| ReadError(format!("cannot read folder {}: {error}", path.display()));
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let name = name.strip_suffix(".part").unwrap_or(&name);
        if Path::new(name).extension().is_some_and(|ending| ending == "mcap") {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(ReadError(format!(
            "there is no recording in {}: it has no file that ends in .mcap",
            path.display()
        )));
    }
    // A recorder that was killed while it gave a file its name leaves the file under both.
    files.retain(|file| !ends_with_part(file) || !is_same(file, &file.with_extension("")));
    files.sort();
    Ok(files)
}

fn ends_with_part(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "part")
}
