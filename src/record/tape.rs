//! The continuous recording: one segment after the other, until there is no more room.

use super::bus::{Account, summary};
use super::decoders::Decoders;
use super::disk_thread::Done;
use super::entry::Entry;
use super::segments::{Segment, SegmentError, Segments, write_error};
use super::session::Session;
use crate::channels::Stream;
use crate::frame::{Frame, Gap, GapReason, Level, Notice, Stamped, Timestamp, Unit};
use crate::recording::definition::Facts;
use crate::recording::writer::Head;

/// Most things that wait for the first frame of a file.
const EARLY: usize = 1000;

/// The continuous recording.
pub struct Tape {
    segments: Segments,
    /// `None` once writing has failed for good, or has ended.
    segment: Option<Segment>,
    decoders: Decoders,
    /// What of each bus is in the open segment.
    counts: Vec<u64>,
    /// Notices and events from before the segment's first frame.
    early: Vec<Entry>,
    error: Option<SegmentError>,
    /// From when to when what a failed file has cost was received.
    lost: Option<(Timestamp, Timestamp)>,
    full: bool,
}

/// What is left of a continuous recording.
pub struct Ended {
    /// Its decoded channels.
    pub streams: Vec<Stream>,
    /// The files, finished.
    pub files: Vec<std::path::PathBuf>,
    /// Why writing ended early, if it did.
    pub error: Option<SegmentError>,
    /// It was finished because there was no more room.
    pub full: bool,
}

impl Tape {
    /// Creates the first segment.
    pub fn start(
        segments: Segments,
        streams: Vec<Option<Stream>>,
        session: &mut Session,
    ) -> Result<Self, SegmentError> {
        let mut tape = Self {
            segments,
            segment: None,
            decoders: Decoders(streams),
            counts: vec![0; session.buses.len()],
            early: Vec::new(),
            error: None,
            lost: None,
            full: false,
        };
        let now = session.timeline.now();
        let head = tape.head(session);
        let segment = tape.segments.open(now, &head, "")?;
        tape.begin(segment, session);
        if let Some(retention) = &mut session.retention {
            retention.refresh();
        }
        Ok(tape)
    }

    /// True once there is a frame in the open segment.
    pub fn has_frames(&self) -> bool {
        self.segment.as_ref().is_some_and(|s| s.writer.has_frames())
    }

    /// Adds something from a bus. Notices may have to wait: the first time in a file is a frame's.
    pub fn take(&mut self, entry: &Entry, session: &mut Session) {
        let waits = match entry {
            Entry::Frame(item) => matches!(item.frame.value, Frame::Notice(_)),
            Entry::Stats { .. } if !self.has_frames() => return,
            Entry::Clock { sync, .. } if sync.step_ns == 0 && !self.has_frames() => return,
            _ => true,
        };
        if waits && !self.has_frames() && self.early.len() < EARLY {
            self.early.push(entry.clone());
            return;
        }
        self.add(entry, session);
        if !self.early.is_empty() && self.has_frames() {
            self.add_early(entry.time(), session);
        }
    }

    /// Adds what has waited for the first frame, which came at `first`.
    fn add_early(&mut self, first: Timestamp, session: &mut Session) {
        for entry in std::mem::take(&mut self.early) {
            self.add(&entry.not_before(first), session);
        }
    }

    fn add(&mut self, entry: &Entry, session: &mut Session) {
        let Some(Segment { writer, .. }) = &mut self.segment else {
            if let Entry::Frame(item) = entry {
                let lost = item.frame.value.weight();
                session.buses[usize::from(item.bus)].tally.dropped(GapReason::Disk, lost);
            }
            return;
        };
        if let Err(error) = entry.write(writer) {
            // Only a full channel table gets here, and a recorder has few channels.
            return self.cannot_write(&error, session);
        }
        if let Entry::Frame(item) = entry {
            self.decoders.take(usize::from(item.bus), &item.frame, writer, &session.progress);
        }
        let full = writer.is_full();
        if let Entry::Event(_) = entry {
            session.note_open(self.segment.as_ref());
        }
        if full {
            self.cut(session);
            self.split_when_full(session.timeline.now(), false, session);
        }
    }

    /// Everything that was read before `time` has been taken.
    pub fn pass(&mut self, time: Timestamp, session: &Session) {
        if let Some(segment) = self.segment.as_mut().filter(|s| s.writer.has_frames()) {
            self.decoders.pass(time, &mut segment.writer, &session.progress);
        }
    }

    /// Writes what has waited for long enough.
    pub fn cut_when_due(&mut self, now: Timestamp, session: &mut Session) {
        let pending = self.segment.as_ref().and_then(|s| s.writer.pending_span());
        if session.pace.is_due(pending, now) {
            self.cut(session);
        }
    }

    /// Begins the next segment, if the open one is full or it is `asked` for.
    pub fn split_when_full(&mut self, now: Timestamp, asked: bool, session: &mut Session) {
        let full = self.segment.as_ref().is_some_and(|s| self.segments.is_full(s, now));
        if !(full || asked) || !self.has_frames() {
            return;
        }
        if !self.segments.is_behind() {
            self.next_segment(now, session);
        } else if asked {
            session.progress.split();
        }
    }

    /// Writes the open chunk and enters it in the books.
    fn cut(&mut self, session: &mut Session) {
        let Some(segment) = &self.segment else { return };
        session.note_open(Some(segment));
        if self.make_room(segment.writer.bytes_to_come(), session) {
            self.write_chunk(session);
        } else {
            self.end_full(session);
        }
    }

    /// Files that wait for their name cannot be deleted yet, so where there is no room they are waited for.
    fn make_room(&mut self, need: u64, session: &mut Session) -> bool {
        if self.segments.is_waiting() && session.try_room(need).is_err() {
            for done in self.segments.wait() {
                self.note(done, session);
            }
        }
        session.make_room(need)
    }

    fn write_chunk(&mut self, session: &mut Session) {
        let Some(segment) = &mut self.segment else { return };
        let span = segment.writer.pending_span();
        let result = segment.writer.cut();
        let counts: Vec<u64> = segment.writer.take_counts().collect();
        session.progress.written(segment.writer.position());
        match result {
            Ok(()) => {
                for (bus, count) in counts.into_iter().enumerate() {
                    session.buses[bus].tally.written(count);
                    self.counts[bus] += count;
                }
            }
            Err(error) => {
                for (bus, count) in session.buses.iter().zip(counts) {
                    bus.tally.dropped(GapReason::Disk, count);
                }
                self.lose(span);
                self.cannot_write(&error, session);
            }
        }
    }

    /// Has what is written made safe; [`Tape::on_done`] takes note of it. Everything before `passed`
    /// has been taken.
    pub fn sync(&mut self, passed: Timestamp) {
        if let Some(segment) = &self.segment {
            let pending = segment.writer.pending_span();
            self.segments.sync(segment, pending.map_or(passed, |span| span.0.min(passed)));
        }
    }

    /// True while the disk is waited for.
    pub fn is_waiting(&self) -> bool {
        self.segments.is_waiting()
    }

    /// Takes note of what the disk has done. True if there was something.
    pub fn on_done(&mut self, session: &mut Session) -> bool {
        let done = self.segments.take_done();
        let moved = !done.is_empty();
        for done in done {
            self.note(done, session);
        }
        moved
    }

    fn note(&mut self, done: Done, session: &mut Session) {
        let open = self.segment.as_ref().map(Segment::part);
        match done {
            Done::Synced { part, time } if Some(&part) == open.as_ref() => {
                session.progress.synced(time);
            }
            Done::Unsafe { part, error } if Some(&part) == open.as_ref() => {
                self.fail(error, session);
            }
            // A file that has failed already, or one that is being finished, which fails next.
            Done::Synced { .. } | Done::Unsafe { .. } => {}
            Done::Finished(_) => {
                if let Some(retention) = &mut session.retention {
                    retention.refresh();
                    retention.note_events();
                }
            }
            Done::Unfinished(error) => self.fail_finished(error, session),
        }
    }

    /// An earlier file could not be finished: the open one says so, once.
    fn fail_finished(&mut self, error: SegmentError, session: &mut Session) {
        session.progress.notice(Level::Error, error.to_string());
        if self.error.replace(error).is_some() {
            session.progress.failed();
        } else {
            self.explain_loss(session.timeline.now(), session);
        }
    }

    /// Finishes the file in the room that was kept free for it.
    fn end_full(&mut self, session: &mut Session) {
        self.full = true;
        let now = session.timeline.now();
        let remarks = session.take_remarks();
        if let Some(segment) = self.segment.as_mut().filter(|s| s.writer.has_frames()) {
            for remark in &remarks {
                segment.writer.add_notice(now, "bustape", remark).ok();
            }
        }
        self.write_chunk(session);
        self.close("disk full", session);
        session.progress.full();
    }

    fn cannot_write(&mut self, error: &std::io::Error, session: &mut Session) {
        let Some(segment) = &self.segment else { return };
        self.fail(write_error(&segment.part(), error), session);
    }

    fn lose(&mut self, span: Option<(Timestamp, Timestamp)>) {
        let Some((from, to)) = span else { return };
        let lost = self.lost.get_or_insert((from, to));
        *lost = (lost.0.min(from), lost.1.max(to));
    }

    /// A file that could not be written stays as it is; one new one is tried, then no more.
    fn fail(&mut self, error: SegmentError, session: &mut Session) {
        let Some(mut failed) = self.segment.take() else { return };
        self.lose(failed.writer.pending_span());
        for (bus, count) in failed.writer.take_counts().enumerate() {
            session.buses[bus].tally.dropped(GapReason::Disk, count);
        }
        self.replace(error, session);
    }

    /// Goes on in a new file, the first time.
    fn replace(&mut self, error: SegmentError, session: &mut Session) {
        let second = self.error.is_some();
        session.progress.notice(Level::Error, error.to_string());
        self.error = Some(error);
        session.note_open(None);
        let now = session.timeline.now();
        // Where the oldest may go, the new file has more room than the failed one.
        if !second && session.make_room(0) {
            let head = self.head(session);
            if let Ok(segment) = self.segments.open_ahead(now, &head, "") {
                self.begin(segment, session);
                return self.explain_loss(now, session);
            }
        }
        session.progress.failed();
    }

    /// The first thing in the segment after a failed one: what the disk has cost.
    fn explain_loss(&mut self, now: Timestamp, session: &Session) {
        let text = self.error.as_ref().map(ToString::to_string).unwrap_or_default();
        let Some(segment) = &mut self.segment else { return };
        let notice = Notice { level: Level::Error, text };
        segment.writer.add_notice(now, "bustape", &notice).ok();
        let (from, to) = self.lost.unwrap_or((now, now));
        for (index, bus) in session.buses.iter().enumerate() {
            let count = bus.tally.totals().lost_to(GapReason::Disk);
            if count > 0 {
                let unit = bus.facts.unit.unwrap_or(Unit::Frames);
                let gap = Gap { count, unit, reason: GapReason::Disk, from, to };
                let frame = Stamped { time: now, value: Frame::Gap(gap) };
                segment.writer.add(index, &frame).ok();
            }
        }
    }

    /// The head of the next file.
    fn head(&self, session: &Session) -> Head {
        session.head(self.segments.session(), self.segments.number() + 1, Vec::new())
    }

    fn begin(&mut self, segment: Segment, session: &mut Session) {
        session.progress.file(&segment.path, segment.writer.position());
        session.note_open(Some(&segment));
        self.segment = Some(segment);
        self.decoders.new_file();
        self.counts.fill(0);
    }

    fn next_segment(&mut self, now: Timestamp, session: &mut Session) {
        let number = self.segments.number();
        self.cut(session);
        if self.segments.number() != number {
            // It could not be written; another has begun already.
            return;
        }
        // While the open file can still say so.
        if !self.make_room(0, session) {
            return self.end_full(session);
        }
        let Some(full) = self.segment.take() else { return };
        if let Err(error) = self.segments.finish(full, self.summary("split", session)) {
            return self.replace(error, session);
        }
        session.note_open(None);
        if let Some(retention) = &mut session.retention {
            retention.refresh();
        }
        let head = self.head(session);
        match self.segments.open_ahead(now, &head, "") {
            Ok(segment) => self.begin(segment, session),
            Err(error) => self.replace(error, session),
        }
    }

    fn summary(&self, reason: &str, session: &Session) -> Facts {
        let accounts = session.buses.iter().zip(&self.counts).enumerate();
        let accounts = accounts.map(|(index, (bus, in_segment))| Account {
            bus,
            totals: bus.tally.totals(),
            in_segment: *in_segment,
            stream: self.decoders.of(index),
        });
        summary(reason, accounts)
    }

    /// Writes what waits, and finishes the file.
    pub fn finish(mut self, reason: &str, session: &mut Session) -> Ended {
        self.add_early(Timestamp(0), session);
        let now = session.timeline.now();
        if let Some(segment) = &mut self.segment {
            self.decoders.finish(now, &mut segment.writer, &session.progress);
        }
        self.cut(session);
        self.close(reason, session);
        let streams = self.decoders.0.into_iter().flatten().collect();
        let files = self.segments.finished().to_vec();
        Ended { streams, files, error: self.error, full: self.full }
    }

    /// Finishes the file, and waits for the disk.
    fn close(&mut self, reason: &str, session: &mut Session) {
        if let Some(segment) = self.segment.take() {
            let summary = self.summary(reason, session);
            if let Err(error) = self.segments.finish(segment, summary) {
                self.error = Some(error);
            }
        }
        for done in self.segments.wait() {
            if let Done::Unfinished(error) = done {
                self.error = Some(error);
            }
        }
    }
}
