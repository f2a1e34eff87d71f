//! Windows: what was recorded around triggers, each as a recording of its own.
//!
//! Everything goes through a [`memory::Memory`] of what happened lately. When a trigger fires, a
//! file is made, and what the memory holds from `before` on goes into it, then what follows, up to
//! `after`. A window stays open for as long as another one could reach back into it, so that
//! windows that overlap are one file, and nothing is in two.

mod memory;
mod packed;
#[cfg(test)]
mod tests;
mod window;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::channels::{Definition, Stream};
use crate::frame::{Level, Timestamp};
use crate::trigger::Fired;

use super::disk_thread::Done;
use super::entry::Entry;
use super::recorder::Outcome;
use super::segments::Segments;
use super::session::Session;
use memory::{Memory, Place};
use window::{Finished, Span, Trouble, Window, reach};

/// Most entries written in a row, so that the continuous recording beside does not have to wait.
const AT_ONCE: usize = 16 << 10;
/// Things may come out of order by so much, nanoseconds.
const SLACK: u64 = 1_000_000_000;

/// How windows are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Keeping {
    /// The longest time that a window reaches back, nanoseconds.
    pub reach: u64,
    /// Most bytes of memory for that.
    pub memory: usize,
    /// There is no continuous recording beside them.
    pub only: bool,
}

/// The windows of a recording.
pub struct Windows {
    keeping: Keeping,
    segments: Segments,
    /// For each bus what it is decoded with.
    definitions: Vec<Option<Definition>>,
    memory: Memory,
    /// The window being written; at most one, since those that overlap are one.
    open: Option<Window>,
    /// Windows that are complete once their last file has its name, and their firings.
    ending: BTreeMap<PathBuf, u64>,
    /// What comes next for it.
    next: Place,
    /// The first thing that was too late for it.
    skipped: Option<Place>,
    /// It has everything that the memory has.
    up_to_date: bool,
    /// When the latest thing happened.
    latest: Timestamp,
    /// Everything before this has been taken.
    passed: Timestamp,
    /// What was before this is in an earlier window.
    floor: Timestamp,
    /// Windows that could not be written, in a row.
    failures: u32,
    incomplete: bool,
    error: Option<super::SegmentError>,
    full: bool,
}

impl Windows {
    /// Keeps windows in files of `segments`.
    pub fn new(
        keeping: Keeping,
        segments: Segments,
        definitions: Vec<Option<Definition>>,
        buses: usize,
    ) -> Self {
        Self {
            keeping,
            segments,
            definitions,
            memory: Memory::new(keeping.memory, buses),
            open: None,
            ending: BTreeMap::new(),
            next: Place::default(),
            skipped: None,
            up_to_date: true,
            latest: Timestamp(0),
            passed: Timestamp(0),
            floor: Timestamp(0),
            failures: 0,
            incomplete: false,
            error: None,
            full: false,
        }
    }

    /// True when there is more to be written than was taken now.
    pub fn has_more(&self) -> bool {
        self.open.is_some() && !self.up_to_date
    }

    /// Takes what has happened.
    pub fn take(&mut self, entry: &Entry, session: &mut Session) {
        self.memory.push(entry);
        self.latest = self.latest.max(entry.time());
        self.up_to_date = false;
        if self.memory.is_over() {
            self.shrink(session);
        }
    }

    /// Everything that was read before `time` has been taken.
    pub fn pass(&mut self, time: Timestamp) {
        self.passed = self.passed.max(time);
    }

    /// A trigger has fired.
    pub fn want(&mut self, fired: Fired, session: &mut Session) {
        let (from, to) = reach(&fired, self.floor);
        if self.open.as_ref().is_some_and(|open| from > open.span.to) {
            self.close("window", session);
        }
        let Some(open) = &mut self.open else {
            return self.begin(Span::of(fired, self.floor), session);
        };
        let earlier = from < open.span.from;
        if to > open.span.to {
            // Between the two the memory may have been short.
            if let Some(missing) = self.memory.take_given_up(open.span.to.plus(1)) {
                self.incomplete = true;
                open.say_missing(&missing, session);
            }
            if let Some(skipped) = self.skipped.take() {
                self.next = skipped;
                self.up_to_date = false;
            }
        }
        if earlier && open.may_begin_anew() && !self.memory.lacks(open.span.from) {
            return self.begin_earlier(&fired, session);
        }
        let begun = open.span.from;
        open.span.join(&fired, self.floor);
        if earlier {
            // What is in the file already is not in the memory any more.
            open.span.from = begun;
            self.incomplete = true;
            let text = format!(
                "the window of trigger {} begins later than it should: one of another trigger had \
                 begun, and what came before that is not in the memory any more",
                fired.name
            );
            session.remark(Level::Warning, text);
        }
    }

    fn begin(&mut self, span: Span, session: &mut Session) {
        let missing = self.memory.take_given_up(span.from);
        self.incomplete |= missing.is_some();
        self.next = self.memory.place_of(span.from);
        (self.skipped, self.up_to_date) = (None, false);
        let streams = session.buses.iter().zip(&self.definitions);
        let streams = streams
            .map(|(bus, known)| known.clone().map(|definition| Stream::new(&bus.name, definition)));
        let streams = streams.collect();
        let (only, segments) = (self.keeping.only, &mut self.segments);
        match Window::open(span, streams, missing, only, segments, session) {
            Ok(window) => {
                session.progress.window(window.path());
                self.open = Some(window);
            }
            Err(error) => self.fail(error, session),
        }
    }

    /// Another trigger reaches further back than the open window: begins it anew.
    fn begin_earlier(&mut self, fired: &Fired, session: &mut Session) {
        let Some(old) = self.open.take() else { return };
        let from = old.span.from;
        let mut span = old.discard(&mut self.segments, session);
        self.memory.unmark(from);
        span.join(fired, self.floor);
        self.begin(span, session);
    }

    /// Writes what is due, and ends the window that nothing can reach any more.
    pub fn on_tick(&mut self, now: Timestamp, syncs: bool, session: &mut Session) {
        self.write(AT_ONCE, session);
        if let Some(open) = &mut self.open {
            if self.up_to_date {
                let time = self.passed.min(open.span.to);
                open.pass(time, session);
            }
            let done = open.cut_when_due(now, session);
            if syncs && done.is_ok() {
                open.sync(self.passed, &mut self.segments);
            }
            let done = done.and_then(|()| open.split_when_full(now, &mut self.segments, session));
            self.check(done, session);
        }
        let over = |open: &Window| open.span.to.plus(self.keeping.reach) < self.passed;
        if self.up_to_date && self.open.as_ref().is_some_and(over) {
            self.close("window", session);
        }
        self.forget(session);
    }

    /// Writes at most `most` entries of those that wait for the open window.
    fn write(&mut self, most: usize, session: &mut Session) {
        for _ in 0..most {
            let Some(open) = &mut self.open else { return };
            let before = self.next;
            let Some(found) = self.memory.next(&mut self.next) else {
                self.up_to_date = true;
                return;
            };
            if found.marked {
                continue;
            }
            if !open.span.holds(&found.entry) {
                if found.entry.time() > open.span.to {
                    self.skipped.get_or_insert(before);
                }
                continue;
            }
            self.memory.mark(&found, true);
            let done = open.add(&found.entry, session);
            self.check(done, session);
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
        let open = self.open.as_ref().map(Window::part);
        match done {
            Done::Synced { part, time } if Some(&part) == open.as_ref() => {
                if self.keeping.only {
                    session.progress.synced(time);
                }
            }
            Done::Unsafe { part, error } if Some(&part) == open.as_ref() => {
                self.check(Err(Trouble::Other(error)), session);
            }
            // A window that has failed already, or one that is being finished, which fails next.
            Done::Synced { .. } | Done::Unsafe { .. } => {}
            Done::Finished(path) => self.complete(&path, session),
            Done::Unfinished(error) => self.fail(error, session),
        }
    }

    /// A file has its name; with the last one a window is complete.
    fn complete(&mut self, path: &Path, session: &mut Session) {
        let Some(firings) = self.ending.remove(path) else { return };
        self.failures = 0;
        let name = path.file_name().unwrap_or_default().display();
        let times = if firings == 1 { "" } else { "s" };
        session.remark(Level::Info, format!("{name} is complete: {firings} firing{times}"));
    }

    fn check(&mut self, done: Result<(), Trouble>, session: &mut Session) {
        match done {
            Ok(()) => {}
            Err(Trouble::Full) => {
                self.full = true;
                self.end("disk full", session);
                session.progress.full();
            }
            Err(trouble) => {
                let Some(mut open) = self.open.take() else { return };
                let error = open.explain(trouble, session);
                self.fail(error, session);
            }
        }
    }

    /// A window's file cannot be written. The next one is tried; where there is nothing else to be
    /// recorded, once.
    fn fail(&mut self, error: super::SegmentError, session: &mut Session) {
        session.remark(Level::Error, error.to_string());
        self.error = Some(error);
        self.failures += 1;
        if self.keeping.only && self.failures > 1 {
            session.progress.failed();
        }
    }

    /// Writes all that the open window wants, and ends it.
    fn close(&mut self, reason: &str, session: &mut Session) {
        self.write(usize::MAX, session);
        self.end(reason, session);
    }

    fn end(&mut self, reason: &str, session: &mut Session) {
        let Some(mut open) = self.open.take() else { return };
        open.span.to = open.span.to.min(self.latest);
        self.floor = open.span.to.plus(1);
        match open.finish(reason, &mut self.segments, session) {
            Ok(Finished { path, span, incomplete }) => {
                self.incomplete |= incomplete;
                self.ending.insert(path, span.firings);
            }
            Err(error) => self.fail(error, session),
        }
    }

    /// Forgets what no window can reach any more.
    fn forget(&mut self, session: &Session) {
        let (reach, only) = (self.keeping.reach, self.keeping.only);
        // Only as far as the triggers have looked: behind a disk that stood still, what is taken now
        // may be older than the recorder's own entries.
        let seen = self.latest.min(self.passed).nanos();
        let horizon = seen.saturating_sub(reach.saturating_add(SLACK));
        let needed = self.needed();
        self.memory.expire(Timestamp(horizon), needed, |bus, count| {
            if only {
                session.buses[bus].tally.outside(count);
            }
        });
    }

    /// Up to here the memory has nothing that the open window still wants.
    fn needed(&self) -> Place {
        if self.open.is_some() { self.next } else { Place::LAST }
    }

    /// Keeps the memory within its bound: first by what is not needed, then by what a window wants
    /// now anyway, at last by what one could want later.
    fn shrink(&mut self, session: &mut Session) {
        self.forget(session);
        if self.memory.is_over() && self.open.is_some() {
            self.write(usize::MAX, session);
        }
        let only = self.keeping.only;
        while self.memory.is_over() {
            self.memory.give_up(|bus, count| {
                if only {
                    session.buses[bus].tally.outside(count);
                }
            });
        }
    }

    /// The recording ends: so does the open window.
    pub fn finish(mut self, reason: &str, session: &mut Session, outcome: &mut Outcome) {
        self.close(reason, session);
        for done in self.segments.wait() {
            self.note(done, session);
        }
        self.memory.expire(Timestamp(u64::MAX), Place::LAST, |bus, count| {
            if self.keeping.only {
                session.buses[bus].tally.outside(count);
            }
        });
        outcome.windows = self.segments.finished().to_vec();
        outcome.windows_incomplete = self.incomplete;
        outcome.error = self.error;
        outcome.full = self.full;
    }
}
