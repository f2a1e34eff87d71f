//! The writer's loop: takes from the queue, writes, syncs, splits, keeps the books.
//!
//! One plain thread. It may wait for the disk as long as it takes: capture goes on beside it, and
//! what no longer fits into the queue meanwhile is counted there.

use std::sync::Arc;
use std::time::Duration;

use super::alarm::Alarm;
use super::bus::{RecordedBus, summary};
use super::progress::Progress;
use super::retention::{Open, Retention, Room};
use super::segments::{Segment, SegmentError, Segments, write_error};
use crate::channels::Stream;
use crate::clock::{Step, Timeline};
use crate::frame::{Frame, Gap, GapReason, Level, Notice, Stamped, Timestamp, Unit};
use crate::queue::{Item, Queue, Totals};
use crate::recording::definition::{Attachment, Facts};
use crate::recording::event::Event;
use crate::recording::schema::bustape::ClockSync;
use crate::recording::writer::{Head, SegmentWriter};
use crate::trigger::{Fired, Triggers};

/// Most items taken from the queue at once: bounds the memory beside the queue to some 400 KiB.
const TAKE: usize = 4096;
/// Most notices that wait for the first frame.
const EARLY: usize = 1000;
const SECOND: u64 = 1_000_000_000;

/// A source may take so long from reading bytes to handing them over, nanoseconds.
const SLOWEST: u64 = 100_000_000;

/// When things reach the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Longest time from a frame to the write of its chunk: what a kill can cost.
    pub chunk: Duration,
    /// Time between syncs: what a power cut can cost.
    pub sync: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self { chunk: Duration::from_millis(200), sync: Duration::from_secs(1) }
    }
}

/// How a recording ended.
pub struct Outcome {
    /// The books of each bus, closed.
    pub totals: Vec<Totals>,
    /// The decoded channels of each bus that has some.
    pub streams: Vec<Stream>,
    /// The files, finished.
    pub files: Vec<std::path::PathBuf>,
    /// Why writing ended early, if it did.
    pub error: Option<SegmentError>,
    /// The recording was finished because there was no more room.
    pub full: bool,
}

/// The writer.
pub struct Recorder {
    queue: Arc<Queue>,
    segments: Segments,
    retention: Option<Retention>,
    alarm: Option<Alarm>,
    buses: Vec<RecordedBus>,
    timeline: Timeline,
    pace: Pace,
    recording: Facts,
    attachments: Vec<Attachment>,
    progress: Arc<Progress>,
    /// Sentences that wait for the first frame.
    remarks: Vec<Notice>,
    /// Events that wait for the first frame.
    events: Vec<Event>,
    /// Events in the recording so far, for their names.
    event_count: u64,
    /// There is no more room: the last file is finished.
    full: bool,
    /// `None` once writing has failed for good.
    segment: Option<Segment>,
    error: Option<SegmentError>,
    last_sync: Timestamp,
    last_stats: Timestamp,
    before: Vec<Totals>,
    segment_counts: Vec<u64>,
    /// Notices from before the segment's first frame.
    early: Vec<Item>,
}

impl Recorder {
    /// Creates the first segment. `recording` goes into the metadata `bustape.recording`.
    #[allow(clippy::too_many_arguments, reason = "called once, from the record command")]
    pub fn start(
        queue: Arc<Queue>,
        segments: Segments,
        retention: Option<Retention>,
        buses: Vec<RecordedBus>,
        timeline: Timeline,
        pace: Pace,
        recording: Facts,
        attachments: Vec<Attachment>,
        progress: Arc<Progress>,
    ) -> Result<Self, SegmentError> {
        let now = timeline.now();
        let mut recorder = Self {
            queue,
            segments,
            retention,
            alarm: None,
            remarks: Vec::new(),
            events: Vec::new(),
            event_count: 0,
            full: false,
            before: vec![Totals::default(); buses.len()],
            segment_counts: vec![0; buses.len()],
            buses,
            timeline,
            pace,
            recording,
            attachments,
            progress,
            early: Vec::new(),
            segment: None,
            error: None,
            last_sync: now,
            last_stats: now,
        };
        recorder.open_segment(now)?;
        if let Some(retention) = &mut recorder.retention {
            retention.refresh();
        }
        Ok(recorder)
    }

    /// Watches for `triggers`, too.
    pub fn watch(mut self, mut triggers: Triggers) -> std::io::Result<Self> {
        triggers.begin(self.timeline.now());
        self.alarm = Some(Alarm::new(triggers, self.progress.clone())?);
        Ok(self)
    }

    /// Lets the triggers look at something. Whatever happens there, the recording goes on.
    #[inline]
    fn alarm(&mut self, show: impl FnOnce(&mut Triggers, &mut Vec<Fired>)) {
        if let Some(alarm) = &mut self.alarm
            && !alarm.watch(show)
        {
            self.alarm = None;
            let text = "the triggers have failed and are off; the recording goes on".to_owned();
            self.progress.remark(Level::Error, text);
        }
    }

    /// Writes until the queue is closed and empty, then finishes the file. `reason` says why the
    /// recording ended; it is asked for at the end.
    pub fn run(mut self, reason: impl FnOnce() -> String) -> Outcome {
        // Half the chunk time, so that a frame waits at most that long here and again as long in
        // the open chunk.
        let tick = self.pace.chunk / 2;
        let mut items = Vec::with_capacity(TAKE);
        let mut before = self.timeline.now();
        while self.queue.take(&mut items, TAKE, tick) {
            let all = items.len() < TAKE;
            for item in items.drain(..) {
                self.take(item);
            }
            if all {
                self.pass(before);
            }
            before = self.timeline.now();
            self.on_tick();
        }
        self.finish(&reason());
        let totals = self.buses.iter().map(|bus| bus.tally.totals()).collect();
        let files = self.segments.finished().to_vec();
        let streams = self.buses.into_iter().filter_map(|bus| bus.stream).collect();
        Outcome { totals, streams, files, error: self.error, full: self.full }
    }

    /// Everything that was read before `time` has been taken.
    fn pass(&mut self, time: Timestamp) {
        let time = Timestamp(time.nanos().saturating_sub(SLOWEST));
        self.alarm(|triggers, fired| triggers.pass(time, fired));
        if !self.has_frames() {
            return;
        }
        for bus in 0..self.buses.len() {
            self.decode(bus, time, |stream, writer| stream.pass(time, writer));
        }
    }

    /// Lets a bus's decoder do something. One that fails ends alone.
    fn decode(
        &mut self,
        bus: usize,
        time: Timestamp,
        work: impl FnOnce(&mut Stream, &mut SegmentWriter) -> Result<(), String>,
    ) {
        let (Some(segment), bus) = (&mut self.segment, &mut self.buses[bus]) else { return };
        let Some(stream) = &mut bus.stream else { return };
        if let Err(why) = work(stream, &mut segment.writer) {
            self.progress.notice(Level::Error, why.clone());
            let notice = Notice { level: Level::Error, text: why };
            let name = format!("{}/decode", bus.name);
            // Where not even the log finds room, the summary tells.
            segment.writer.add_notice(time, &name, &notice).ok();
        }
    }

    fn take(&mut self, item: Item) {
        let bus = usize::from(item.bus);
        if let Frame::Notice(notice) = &item.frame.value {
            let text = format!("{}: {}", self.buses[bus].name, notice.text);
            self.progress.notice(notice.level, text);
            // The first time in a file is a frame's, so what sources say before that waits.
            if !self.has_frames() && self.early.len() < EARLY {
                self.early.push(item);
                return;
            }
        }
        self.add(&item);
        if !self.early.is_empty() && self.has_frames() {
            self.add_early(item.frame.time);
        }
    }

    /// Adds what has waited for the first frame, which came at `first`.
    fn add_early(&mut self, first: Timestamp) {
        for mut item in std::mem::take(&mut self.early) {
            item.frame.time = item.frame.time.max(first);
            self.add(&item);
        }
    }

    fn add(&mut self, item: &Item) {
        let bus = usize::from(item.bus);
        let Some(segment) = &mut self.segment else {
            let lost = item.frame.value.weight();
            self.buses[bus].tally.dropped(GapReason::Disk, lost);
            return;
        };
        let full = match segment.writer.add(bus, &item.frame) {
            Ok(()) => segment.writer.is_full(),
            // Only a full channel table gets here, and a recorder has few channels.
            Err(error) => return self.fail(&error),
        };
        let frame = &item.frame;
        self.decode(bus, frame.time, |stream, writer| stream.take(frame, writer));
        self.alarm(|triggers, fired| triggers.take(bus, frame, fired));
        if full {
            self.cut();
            self.split_when_full(self.timeline.now(), false);
        }
    }

    fn on_tick(&mut self) {
        let now = self.timeline.now();
        if self.has_frames() {
            for step in self.timeline.take_steps() {
                self.add_step(&step, now);
            }
        }
        self.add_remarks(now);
        self.add_events();
        if now.since(self.last_stats) >= SECOND && self.has_frames() {
            self.add_stats(now);
        }
        let half = u64::try_from(self.pace.chunk.as_nanos() / 2).unwrap_or(u64::MAX);
        let pending = self.segment.as_ref().and_then(|s| s.writer.pending_span());
        if pending.is_some_and(|(oldest, _)| now.since(oldest) >= half) {
            self.cut();
        }
        if u128::from(now.since(self.last_sync)) >= self.pace.sync.as_nanos() {
            self.sync(now);
        }
        let asked = self.progress.take_split();
        self.split_when_full(now, asked);
        self.progress.gone_round();
    }

    fn split_when_full(&mut self, now: Timestamp, asked: bool) {
        let full = self.segment.as_ref().is_some_and(|s| self.segments.is_full(s, now));
        if (full || asked) && self.has_frames() {
            self.next_segment(now);
        }
    }

    fn has_frames(&self) -> bool {
        self.segment.as_ref().is_some_and(|s| s.writer.has_frames())
    }

    /// Sentences about the recorder itself, for the file and the person.
    fn add_remarks(&mut self, now: Timestamp) {
        for remark in self.progress.take_remarks() {
            self.remark(remark);
        }
        if !self.has_frames() {
            return;
        }
        let Some(segment) = &mut self.segment else { return };
        for remark in self.remarks.drain(..) {
            segment.writer.add_notice(now, "bustape", &remark).ok();
        }
    }

    /// Marks and triggers, as soon as there is a frame.
    fn add_events(&mut self) {
        for mut event in self.progress.take_events() {
            self.event_count += 1;
            let fact = |name: &str| self.recording.get(name).cloned().unwrap_or_default();
            event.id = format!("{}/{}", fact("session_id"), self.event_count);
            event.device = fact("host");
            self.events.push(event);
        }
        if !self.has_frames() {
            self.events.truncate(EARLY);
            return;
        }
        let Some(segment) = &mut self.segment else { return };
        let mut failed = None;
        for event in self.events.drain(..) {
            failed = segment.writer.add_event(&event).err().or(failed);
        }
        if let Some(error) = failed {
            self.fail(&error);
        }
    }

    fn remark(&mut self, remark: Notice) {
        self.progress.notice(remark.level, remark.text.clone());
        if self.remarks.len() < EARLY {
            self.remarks.push(remark);
        }
    }

    /// Makes room for what is about to be written. False when there is none.
    fn make_room(&mut self) -> bool {
        let now = self.timeline.now();
        let Some(retention) = &mut self.retention else { return true };
        let nothing = std::path::Path::new("");
        let (need, open) = match &self.segment {
            Some(Segment { writer, path, .. }) => {
                let (bytes, holds_event) = (writer.position(), writer.holds_event());
                (writer.bytes_to_come(), Open { path, bytes, holds_event })
            }
            None => (0, Open { path: nothing, bytes: 0, holds_event: false }),
        };
        let Room { said, full } = retention.make_room(need, open, now);
        for text in said {
            self.remark(Notice { level: Level::Info, text });
        }
        let Some(text) = full else { return true };
        self.remark(Notice { level: Level::Warning, text });
        false
    }

    /// Finishes the file in the room that was kept free for it.
    fn end_full(&mut self) {
        self.full = true;
        self.add_remarks(self.timeline.now());
        self.write_chunk();
        if let Some(segment) = self.segment.take() {
            let summary = summary("disk full", &self.buses, &self.segment_counts);
            if let Err(error) = self.segments.finish(segment, summary) {
                self.error = Some(error);
            }
        }
        self.progress.full();
    }

    /// Writes the open chunk and enters it in the books.
    fn cut(&mut self) {
        if self.segment.is_none() {
            return;
        }
        if self.make_room() {
            self.write_chunk();
        } else {
            self.end_full();
        }
    }

    fn write_chunk(&mut self) {
        let Some(segment) = &mut self.segment else { return };
        let result = segment.writer.cut();
        let counts: Vec<u64> = segment.writer.take_counts().collect();
        self.progress.written(segment.writer.position());
        match result {
            Ok(()) => {
                for (bus, count) in counts.into_iter().enumerate() {
                    self.buses[bus].tally.written(count);
                    self.segment_counts[bus] += count;
                }
            }
            Err(error) => {
                for (bus, count) in self.buses.iter().zip(counts) {
                    bus.tally.dropped(GapReason::Disk, count);
                }
                self.fail(&error);
            }
        }
    }

    fn sync(&mut self, now: Timestamp) {
        self.last_sync = now;
        let Some(segment) = &mut self.segment else { return };
        match segment.writer.sync() {
            Ok(()) => self.progress.synced(now),
            Err(error) => self.fail(&error),
        }
    }

    /// A file that could not be written stays as it is; one new one is tried, then no more.
    fn fail(&mut self, error: &std::io::Error) {
        let Some(mut failed) = self.segment.take() else { return };
        let mut lost = vec![0; self.buses.len()];
        for (bus, count) in failed.writer.take_counts().enumerate() {
            self.buses[bus].tally.dropped(GapReason::Disk, count);
            lost[bus] = count;
        }
        let error = write_error(&failed.part(), error);
        let second = self.error.is_some();
        self.progress.notice(Level::Error, error.to_string());
        self.error = Some(error);
        let now = self.timeline.now();
        // Where the oldest may go, the new file has more room than the failed one.
        let room = second || self.make_room();
        if !second && room && self.open_segment(now).is_ok() {
            self.explain_loss(now);
            return;
        }
        self.segment = None;
        self.progress.failed();
    }

    /// The first thing in the segment after a failed one: what the disk has cost.
    fn explain_loss(&mut self, now: Timestamp) {
        let text = self.error.as_ref().map(ToString::to_string).unwrap_or_default();
        let Some(segment) = &mut self.segment else { return };
        let notice = Notice { level: Level::Error, text };
        segment.writer.add_notice(now, "bustape", &notice).ok();
        for (index, bus) in self.buses.iter().enumerate() {
            let count = bus.tally.totals().lost_to(GapReason::Disk);
            if count > 0 {
                let unit = bus.facts.unit.unwrap_or(Unit::Frames);
                let gap = Gap { count, unit, reason: GapReason::Disk, from: now, to: now };
                let frame = Stamped { time: now, value: Frame::Gap(gap) };
                segment.writer.add(index, &frame).ok();
            }
        }
    }

    fn add_step(&mut self, step: &Step, now: Timestamp) {
        let Some(segment) = &mut self.segment else { return };
        let milliseconds = step.nanos / 1_000_000;
        let text = format!(
            "the wall clock was set by {milliseconds:+} ms; times in this recording go on as before"
        );
        let sync = ClockSync {
            steady_ns: step.reading.steady,
            wall_ns: step.reading.wall,
            step_ns: step.nanos,
        };
        segment.writer.add_clock(now, &sync).ok();
        let notice = Notice { level: Level::Warning, text };
        segment.writer.add_notice(now, "bustape", &notice).ok();
    }

    /// Once a second: the clocks and the books.
    fn add_stats(&mut self, now: Timestamp) {
        let (time, reading) = self.timeline.read();
        let Some(segment) = &mut self.segment else { return };
        let sync = ClockSync { steady_ns: reading.steady, wall_ns: reading.wall, step_ns: 0 };
        segment.writer.add_clock(time, &sync).ok();
        #[allow(clippy::cast_precision_loss, reason = "a rate for people")]
        let seconds = now.since(self.last_stats) as f64 / SECOND as f64;
        for (index, bus) in self.buses.iter().enumerate() {
            let totals = bus.tally.totals();
            let stats = bus.stats(&totals, &self.before[index], seconds);
            segment.writer.add_stats(index, now, &stats).ok();
            self.before[index] = totals;
        }
        self.last_stats = now;
        self.progress.queued(self.queue.fill().0);
    }

    fn open_segment(&mut self, now: Timestamp) -> Result<(), SegmentError> {
        let number = self.segments.number() + 1;
        let mut recording = self.recording.clone();
        recording.insert("segment".to_owned(), number.to_string());
        recording.insert("session".to_owned(), self.segments.session().to_string());
        let head = Head {
            recording,
            clock: self.clock_facts(),
            buses: self.buses.iter().map(RecordedBus::head).collect(),
            more: Vec::new(),
            attachments: self.attachments.clone(),
            time: now,
        };
        let segment = self.segments.open(now, &head)?;
        self.progress.file(&segment.path, segment.writer.position());
        self.segment = Some(segment);
        self.buses.iter_mut().filter_map(|bus| bus.stream.as_mut()).for_each(Stream::new_segment);
        self.segment_counts.fill(0);
        Ok(())
    }

    fn clock_facts(&self) -> Facts {
        let (time, reading) = self.timeline.read();
        Facts::from([
            ("log_time_ns".to_owned(), time.nanos().to_string()),
            ("steady_clock".to_owned(), "CLOCK_BOOTTIME".to_owned()),
            ("steady_ns".to_owned(), reading.steady.to_string()),
            ("wall_ns".to_owned(), reading.wall.to_string()),
        ])
    }

    fn next_segment(&mut self, now: Timestamp) {
        self.cut();
        let Some(full) = self.segment.take() else { return };
        let summary = summary("split", &self.buses, &self.segment_counts);
        let finished = self.segments.finish(full, summary);
        if finished.is_ok() {
            if let Some(retention) = &mut self.retention {
                retention.refresh();
                retention.note_events();
            }
            if !self.make_room() {
                return self.end_full();
            }
        }
        if let Err(error) = finished.and_then(|()| self.open_segment(now)) {
            self.progress.notice(Level::Error, error.to_string());
            self.error = Some(error);
            self.progress.failed();
        }
    }

    fn finish(&mut self, reason: &str) {
        if self.has_frames() {
            self.add_stats(self.timeline.now());
        }
        self.add_early(Timestamp(0));
        self.add_events();
        let now = self.timeline.now();
        for bus in 0..self.buses.len() {
            self.decode(bus, now, Stream::finish);
        }
        self.cut();
        let Some(segment) = self.segment.take() else { return };
        let summary = summary(reason, &self.buses, &self.segment_counts);
        if let Err(error) = self.segments.finish(segment, summary) {
            self.error = Some(error);
        }
    }
}
