//! One window being written: a file with books of its own.

use std::io;
use std::path::{Path, PathBuf};

use crate::channels::Stream;
use crate::frame::{Frame, Gap, GapReason, Stamped, Timestamp, Unit};
use crate::queue::Totals;
use crate::record::bus::{Account, summary};
use crate::record::decoders::Decoders;
use crate::record::entry::Entry;
use crate::record::segments::{Segment, SegmentError, Segments, write_error};
use crate::record::session::Session;
use crate::recording::definition::Facts;
use crate::trigger::{Fired, Window as Reach};

use super::memory::GivenUp;

/// Most letters of a trigger's name in a file's name.
const LABEL: usize = 40;
/// Most names of triggers in a summary.
const NAMES: usize = 20;

/// What a window is about.
pub struct Span {
    /// It begins here; later parts of it, too.
    pub from: Timestamp,
    /// It ends here, so far.
    pub to: Timestamp,
    /// The first firing.
    pub first: Fired,
    /// How many there were.
    pub firings: u64,
    /// The triggers, by name.
    names: Vec<String>,
}

impl Span {
    /// The window around `fired`, as far as it is behind `floor`.
    pub fn of(fired: Fired, floor: Timestamp) -> Self {
        let (from, to) = reach(&fired, floor);
        let names = vec![fired.name.clone()];
        Self { from, to, first: fired, firings: 1, names }
    }

    /// Takes another firing into it.
    pub fn join(&mut self, fired: &Fired, floor: Timestamp) {
        let (from, to) = reach(fired, floor);
        self.from = self.from.min(from);
        self.to = self.to.max(to);
        self.firings += 1;
        if !self.names.contains(&fired.name) && self.names.len() < NAMES {
            self.names.push(fired.name.clone());
        }
    }

    /// True if `entry` is in it: by its time, and a gap if any of it is.
    pub fn holds(&self, entry: &Entry) -> bool {
        if let Entry::Frame(item) = entry
            && let Frame::Gap(gap) = &item.frame.value
        {
            return gap.from <= self.to && gap.to >= self.from;
        }
        (self.from..=self.to).contains(&entry.time())
    }

    /// `bustape.window` of its file number `part`.
    fn facts(&self, part: u32, only: bool) -> Facts {
        let Reach { before, after } = self.first.window.unwrap_or_default();
        let mut facts = Facts::from([
            ("trigger".to_owned(), self.first.name.clone()),
            ("condition".to_owned(), self.first.condition.clone()),
            ("fired_ns".to_owned(), self.first.time.nanos().to_string()),
            ("before_ns".to_owned(), before.to_string()),
            ("after_ns".to_owned(), after.to_string()),
            ("from_ns".to_owned(), self.from.nanos().to_string()),
            ("part".to_owned(), part.to_string()),
            ("continuous_recording".to_owned(), (!only).to_string()),
            (
                "books".to_owned(),
                "what happened from from_ns to window_to_ns of bustape.summary; what was outside is \
                 neither received nor dropped here"
                    .to_owned(),
            ),
        ]);
        facts.extend(self.first.bus.clone().map(|bus| ("bus".to_owned(), bus)));
        facts.extend(self.first.value.map(|value| ("value".to_owned(), value.to_string())));
        facts
    }

    /// The last part of its files' names: the trigger's, in letters that every file system takes.
    fn label(&self) -> String {
        let mut label = String::new();
        for c in self.first.name.chars() {
            if c.is_ascii_alphanumeric() {
                label.push(c);
            } else if !label.is_empty() && !label.ends_with('-') {
                label.push('-');
            }
            if label.len() >= LABEL {
                break;
            }
        }
        label.trim_end_matches('-').to_owned()
    }
}

/// From when to when a firing's window goes, as far as it is behind `floor`.
pub fn reach(fired: &Fired, floor: Timestamp) -> (Timestamp, Timestamp) {
    let Reach { before, after } = fired.window.unwrap_or_default();
    let from = Timestamp(fired.time.nanos().saturating_sub(before));
    (from.max(floor), fired.time.plus(after))
}

/// A window being written.
pub struct Window {
    /// What it is about.
    pub span: Span,
    segment: Segment,
    decoders: Decoders,
    /// Of this file only.
    books: Vec<Totals>,
    /// Number of this file in the window, from 1.
    part: u32,
    /// There is no continuous recording beside it: it writes in the recorder's own books.
    only: bool,
    /// Some of it was not in the memory any more.
    lacks: bool,
    /// Something was lost in an earlier part of it.
    lost: bool,
}

impl Window {
    /// Makes its file. What is `missing` stands at its beginning as gaps.
    pub fn open(
        span: Span,
        streams: Vec<Option<Stream>>,
        missing: Option<GivenUp>,
        only: bool,
        segments: &mut Segments,
        session: &Session,
    ) -> Result<Self, SegmentError> {
        let segment = create(&span, 1, only, segments, session)?;
        let books = vec![Totals::default(); session.buses.len()];
        let decoders = Decoders(streams);
        let (part, lacks) = (1, false);
        let mut window = Self { span, segment, decoders, books, part, only, lacks, lost: false };
        if let Some(missing) = missing {
            window.say_missing(&missing, session);
        }
        Ok(window)
    }

    /// Puts in what the memory had to give up, as gaps.
    pub fn say_missing(&mut self, missing: &GivenUp, session: &Session) {
        self.lacks = true;
        let (from, to) = missing.span;
        for (index, (bus, count)) in session.buses.iter().zip(&missing.counts).enumerate() {
            if *count == 0 {
                continue;
            }
            let unit = bus.facts.unit.unwrap_or(Unit::Frames);
            let gap = Gap { count: *count, unit, reason: GapReason::WindowMemory, from, to };
            let frame = Stamped { time: to, value: Frame::Gap(gap) };
            self.books[index].enter(&frame.value);
            // Only a full table of channels refuses it, and this is one of the first.
            self.segment.writer.add(index, &frame).ok();
            if self.only {
                bus.tally.wanted_too_late(*count);
            }
        }
    }

    /// Adds what is in the window.
    pub fn add(&mut self, entry: &Entry, session: &mut Session) -> Result<(), Trouble> {
        let writer = &mut self.segment.writer;
        if let Entry::Frame(item) = entry {
            self.books[usize::from(item.bus)].enter(&item.frame.value);
        }
        entry.write(writer)?;
        if let Entry::Frame(item) = entry {
            self.decoders.take(usize::from(item.bus), &item.frame, writer, &session.progress);
        }
        if self.segment.writer.is_full() { self.cut(session) } else { Ok(()) }
    }

    /// Everything that happened before `time` has been added.
    pub fn pass(&mut self, time: Timestamp, session: &Session) {
        self.decoders.pass(time, &mut self.segment.writer, &session.progress);
    }

    /// Writes what has waited for long enough.
    pub fn cut_when_due(&mut self, now: Timestamp, session: &mut Session) -> Result<(), Trouble> {
        let due = session.pace.is_due(self.segment.writer.pending_span(), now);
        if due { self.cut(session) } else { Ok(()) }
    }

    /// Writes the open chunk and enters it in the books.
    fn cut(&mut self, session: &mut Session) -> Result<(), Trouble> {
        if !session.make_room(self.segment.writer.bytes_to_come()) {
            return Err(Trouble::Full);
        }
        self.write_chunk(session)
    }

    fn write_chunk(&mut self, session: &Session) -> Result<(), Trouble> {
        let result = self.segment.writer.cut();
        self.account(result.is_ok(), session);
        Ok(result?)
    }

    /// Enters what was in the last chunk.
    fn account(&mut self, written: bool, session: &Session) {
        let counts: Vec<u64> = self.segment.writer.take_counts().collect();
        for ((bus, books), count) in session.buses.iter().zip(&mut self.books).zip(counts) {
            if written {
                books.written += count;
            } else {
                books.lose(GapReason::Disk, count);
            }
            match (self.only, written) {
                (true, true) => bus.tally.written(count),
                (true, false) => bus.tally.dropped(GapReason::Disk, count),
                (false, _) => {}
            }
        }
    }

    /// Has what is written made safe. Everything before `passed` has been taken.
    pub fn sync(&self, passed: Timestamp, segments: &mut Segments) {
        let pending = self.segment.writer.pending_span();
        segments.sync(&self.segment, pending.map_or(passed, |span| span.0.min(passed)));
    }

    /// The name its file has now.
    pub fn part(&self) -> PathBuf {
        self.segment.part()
    }

    /// Goes on in another file, if this one is full.
    pub fn split_when_full(
        &mut self,
        now: Timestamp,
        segments: &mut Segments,
        session: &mut Session,
    ) -> Result<(), Trouble> {
        if !segments.is_full(&self.segment, now) || segments.is_behind() {
            return Ok(());
        }
        self.cut(session)?;
        let next = create(&self.span, self.part + 1, self.only, segments, session);
        let next = next?;
        let summary = self.summary("split", session);
        let full = std::mem::replace(&mut self.segment, next);
        self.part += 1;
        self.decoders.new_file();
        self.lost |= self.books.iter().any(|books| books.lost() > 0);
        self.books.fill(Totals::default());
        Ok(segments.finish(full, summary)?)
    }

    /// Writes the end of the file, which gets its name once it is safe.
    pub fn finish(
        mut self,
        reason: &str,
        segments: &mut Segments,
        session: &mut Session,
    ) -> Result<Finished, SegmentError> {
        self.decoders.finish(self.span.to, &mut self.segment.writer, &session.progress);
        // When the disk is full, this is what room was kept free for.
        let _ = session.make_room(self.segment.writer.bytes_to_come());
        self.write_chunk(session).map_err(|trouble| self.explain(trouble, session))?;
        let summary = self.summary(reason, session);
        let path = self.segment.path.clone();
        segments.finish(self.segment, summary)?;
        let incomplete = self.lost || self.books.iter().any(|books| books.lost() > 0);
        Ok(Finished { path, span: self.span, incomplete })
    }

    /// Removes the file; another will have all that is in it.
    pub fn discard(self, segments: &mut Segments, session: &Session) -> Span {
        if self.only {
            for (bus, books) in session.buses.iter().zip(&self.books) {
                bus.tally.written_anew(books.written);
            }
        }
        segments.discard(self.segment);
        self.span
    }

    /// True if another file could have all that is in this one.
    pub fn may_begin_anew(&self) -> bool {
        self.part == 1 && !self.lacks
    }

    /// The name its file will have.
    pub fn path(&self) -> &Path {
        &self.segment.path
    }

    /// The sentence for what went wrong. What was not written is lost.
    pub fn explain(&mut self, trouble: Trouble, session: &Session) -> SegmentError {
        self.account(false, session);
        match trouble {
            Trouble::Write(error) => write_error(&self.segment.part(), &error),
            Trouble::Other(error) => error,
            Trouble::Full => SegmentError("the disk is full".to_owned()),
        }
    }

    fn summary(&self, reason: &str, session: &Session) -> Facts {
        let accounts = session.buses.iter().zip(&self.books).enumerate();
        let accounts = accounts.map(|(index, (bus, books))| Account {
            bus,
            totals: *books,
            in_segment: books.written,
            stream: self.decoders.of(index),
        });
        let mut facts = summary(reason, accounts);
        facts.extend([
            ("window_from_ns".to_owned(), self.span.from.nanos().to_string()),
            ("window_to_ns".to_owned(), self.span.to.nanos().to_string()),
            ("window_firings".to_owned(), self.span.firings.to_string()),
            ("window_triggers".to_owned(), self.span.names.join(", ")),
        ]);
        facts
    }
}

fn create(
    span: &Span,
    part: u32,
    only: bool,
    segments: &mut Segments,
    session: &Session,
) -> Result<Segment, SegmentError> {
    let more = vec![("bustape.window".to_owned(), span.facts(part, only))];
    let head = session.head(segments.session(), segments.number() + 1, more);
    let time = if part == 1 { span.from } else { head.time };
    segments.open_ahead(time, &head, &span.label())
}

/// A window that has ended.
pub struct Finished {
    /// The name its last file gets.
    pub path: PathBuf,
    /// What it was about.
    pub span: Span,
    /// Something was lost in it.
    pub incomplete: bool,
}

/// Why a window cannot go on.
pub enum Trouble {
    /// There is no more room.
    Full,
    /// Its file cannot be written.
    Write(io::Error),
    /// Its file cannot be made or finished.
    Other(SegmentError),
}

impl From<SegmentError> for Trouble {
    fn from(error: SegmentError) -> Self {
        Self::Other(error)
    }
}

impl From<io::Error> for Trouble {
    fn from(error: io::Error) -> Self {
        Self::Write(error)
    }
}
