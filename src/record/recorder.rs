//! The writer's loop: takes from the queue, writes, splits, keeps the books; what it would have to wait
//! for, a thread of its own does (`disk_thread.rs`).
//!
//! One plain thread. It may wait for a write as long as that takes: capture goes on beside it, and
//! what no longer fits into the queue meanwhile is counted there.

use std::sync::Arc;
use std::time::Duration;

use super::alarm::Alarm;
use super::entry::Entry;
use super::segments::SegmentError;
use super::session::Session;
use super::tape::{Ended, Tape};
use super::windows::Windows;
use crate::channels::Stream;
use crate::clock::Step;
use crate::frame::{Frame, Level, Notice, Timestamp};
use crate::queue::{Item, Queue, Totals};
use crate::recording::schema::bustape::ClockSync;
use crate::trigger::{Fired, Triggers};

/// Most items taken from the queue at once: bounds the memory beside the queue to some 400 KiB.
const TAKE: usize = 4096;
const SECOND: u64 = 1_000_000_000;

/// The writer goes round at least this often, however seldom it writes: others see by that that it
/// lives.
const LONGEST_NAP: Duration = Duration::from_secs(1);

/// A source may take so long from reading bytes to handing them over, nanoseconds.
const SLOWEST: u64 = 100_000_000;

/// How a recording ended.
#[derive(Default)]
pub struct Outcome {
    /// The books of each bus, closed.
    pub totals: Vec<Totals>,
    /// The decoded channels of each bus that has some.
    pub streams: Vec<Stream>,
    /// The files, finished.
    pub files: Vec<std::path::PathBuf>,
    /// The windows around triggers, finished.
    pub windows: Vec<std::path::PathBuf>,
    /// Something is not in a window that belongs there.
    pub windows_incomplete: bool,
    /// Why writing ended early, if it did.
    pub error: Option<SegmentError>,
    /// The recording was finished because there was no more room.
    pub full: bool,
}

/// The writer.
pub struct Recorder {
    queue: Arc<Queue>,
    session: Session,
    /// The continuous recording, unless only windows are kept.
    tape: Option<Tape>,
    alarm: Option<Alarm>,
    windows: Option<Windows>,
    /// Everything that was read before this has been taken.
    passed: Timestamp,
    last_sync: Timestamp,
    last_stats: Timestamp,
    before: Vec<Totals>,
}

impl Recorder {
    /// Records from `queue` to `tape`, whose first segment is there.
    pub fn new(queue: Arc<Queue>, session: Session, tape: Option<Tape>) -> Self {
        let now = session.timeline.now();
        let before = vec![Totals::default(); session.buses.len()];
        let (last_sync, last_stats) = (now, now);
        let (alarm, windows) = (None, None);
        Self { queue, session, tape, alarm, windows, passed: now, last_sync, last_stats, before }
    }

    /// Watches for `triggers`, too, and keeps `windows` around those that ask for it.
    pub fn watch(
        mut self,
        mut triggers: Triggers,
        windows: Option<Windows>,
    ) -> std::io::Result<Self> {
        triggers.begin(self.session.timeline.now());
        self.alarm = Some(Alarm::new(triggers, self.session.progress.clone())?);
        self.windows = windows;
        Ok(self)
    }

    /// Writes until the queue is closed and empty, then finishes the files. `reason` says why the
    /// recording ended; it is asked for at the end.
    pub fn run(mut self, reason: impl FnOnce() -> String) -> Outcome {
        let tick = self.session.pace.half().min(LONGEST_NAP);
        let mut items = Vec::with_capacity(TAKE);
        let mut before = self.session.timeline.now();
        loop {
            let waiting = self.windows.as_ref().is_some_and(Windows::has_more);
            let tick = if waiting { Duration::ZERO } else { tick };
            if !self.queue.take(&mut items, TAKE, tick) {
                break;
            }
            let all = items.len() < TAKE;
            for item in items.drain(..) {
                self.take(item);
            }
            if all {
                self.pass(Timestamp(before.nanos().saturating_sub(SLOWEST)));
            }
            before = self.session.timeline.now();
            self.on_tick(before);
        }
        self.finish(&reason())
    }

    /// Everything that was read before `time` has been taken.
    fn pass(&mut self, time: Timestamp) {
        self.passed = time;
        self.alarm(|triggers, fired| triggers.pass(time, fired));
        if let Some(tape) = &mut self.tape {
            tape.pass(time, &self.session);
        }
        if let Some(windows) = &mut self.windows {
            windows.pass(time);
        }
    }

    /// Lets the triggers look at something. Whatever happens there, the recording goes on.
    #[inline]
    fn alarm(&mut self, show: impl FnOnce(&mut Triggers, &mut Vec<Fired>)) {
        let Some(alarm) = &mut self.alarm else { return };
        if !alarm.watch(show) {
            self.alarm = None;
            let text = "the triggers have failed and are off; the recording goes on".to_owned();
            self.session.remark(Level::Error, text);
            return;
        }
        if let Some(windows) = &mut self.windows {
            for wanted in alarm.take_wanted() {
                windows.want(wanted, &mut self.session);
            }
        }
    }

    fn take(&mut self, item: Item) {
        let bus = usize::from(item.bus);
        if let Frame::Notice(notice) = &item.frame.value {
            let text = format!("{}: {}", self.session.buses[bus].name, notice.text);
            self.session.progress.notice(notice.level, text);
        }
        let entry = Entry::Frame(item);
        if let Some(tape) = &mut self.tape {
            tape.take(&entry, &mut self.session);
        }
        if let Some(windows) = &mut self.windows {
            windows.take(&entry, &mut self.session);
        }
        if let Entry::Frame(Item { frame, .. }) = &entry {
            self.alarm(|triggers, fired| triggers.take(bus, frame, fired));
        }
    }

    /// Something about the recorder itself, for all files.
    fn put(&mut self, entry: &Entry) {
        if let Some(tape) = &mut self.tape {
            tape.take(entry, &mut self.session);
        }
        if let Some(windows) = &mut self.windows {
            windows.take(entry, &mut self.session);
        }
    }

    fn on_tick(&mut self, now: Timestamp) {
        for step in self.session.timeline.take_steps() {
            self.put_step(&step, now);
        }
        self.put_remarks(now);
        self.put_events();
        if now.since(self.last_stats) >= SECOND {
            self.put_stats(now);
        }
        let syncs = u128::from(now.since(self.last_sync)) >= self.session.pace.sync.as_nanos();
        if syncs {
            self.last_sync = now;
        }
        let asked = self.session.progress.take_split();
        if let Some(tape) = &mut self.tape {
            tape.cut_when_due(now, &mut self.session);
            if syncs {
                tape.sync(self.passed);
            }
            tape.split_when_full(now, asked, &mut self.session);
        }
        if let Some(windows) = &mut self.windows {
            windows.on_tick(now, syncs, &mut self.session);
        }
        self.on_done();
    }

    /// What the disk has done. A round has been gone when nothing had to be waited for, or when
    /// something that was waited for has come.
    fn on_done(&mut self) {
        let (mut moved, mut waiting) = (false, false);
        if let Some(tape) = &mut self.tape {
            moved |= tape.on_done(&mut self.session);
            waiting |= tape.is_waiting();
        }
        if let Some(windows) = &mut self.windows {
            moved |= windows.on_done(&mut self.session);
            waiting |= windows.is_waiting();
        }
        if moved || !waiting {
            self.session.progress.gone_round();
        }
    }

    /// Sentences about the recorder itself, for the files and the person.
    fn put_remarks(&mut self, time: Timestamp) {
        for notice in self.session.take_remarks() {
            self.put(&Entry::Notice { time, notice });
        }
    }

    /// Marks and triggers.
    fn put_events(&mut self) {
        for mut event in self.session.progress.take_events() {
            self.session.name(&mut event);
            let time = event.time;
            let is_mark = event.is_mark();
            self.put(&Entry::Event(event));
            if is_mark {
                self.alarm(|triggers, fired| triggers.mark(time, fired));
            }
        }
    }

    fn put_step(&mut self, step: &Step, time: Timestamp) {
        let sync = ClockSync {
            steady_ns: step.reading.steady,
            wall_ns: step.reading.wall,
            step_ns: step.nanos,
        };
        self.put(&Entry::Clock { time, sync });
        let milliseconds = step.nanos / 1_000_000;
        let text = format!(
            "the wall clock was set by {milliseconds:+} ms; times in this recording go on as before"
        );
        let notice = Notice { level: Level::Warning, text };
        self.put(&Entry::Notice { time, notice });
    }

    /// Once a second: the clocks and the books.
    fn put_stats(&mut self, now: Timestamp) {
        let (time, reading) = self.session.timeline.read();
        let sync = ClockSync { steady_ns: reading.steady, wall_ns: reading.wall, step_ns: 0 };
        self.put(&Entry::Clock { time, sync });
        #[allow(clippy::cast_precision_loss, reason = "a rate for people")]
        let seconds = now.since(self.last_stats) as f64 / SECOND as f64;
        for bus in 0..self.session.buses.len() {
            let recorded = &self.session.buses[bus];
            let totals = recorded.tally.totals();
            let stats = recorded.stats(&totals, &self.before[bus], seconds);
            self.before[bus] = totals;
            self.put(&Entry::Stats { bus, time: now, stats });
        }
        self.last_stats = now;
        self.session.progress.queued(self.queue.fill());
    }

    fn finish(mut self, reason: &str) -> Outcome {
        let now = self.session.timeline.now();
        self.put_remarks(now);
        self.put_stats(now);
        // A mark may set off a trigger, which has an event of its own.
        self.put_events();
        self.put_events();
        let mut outcome = Outcome::default();
        if let Some(windows) = self.windows {
            windows.finish(reason, &mut self.session, &mut outcome);
        }
        if let Some(mut tape) = self.tape {
            for notice in self.session.take_remarks() {
                tape.take(&Entry::Notice { time: now, notice }, &mut self.session);
            }
            let Ended { streams, files, error, full } = tape.finish(reason, &mut self.session);
            outcome.full |= full;
            outcome.error = error.or(outcome.error);
            (outcome.streams, outcome.files) = (streams, files);
        }
        outcome.totals = self.session.buses.iter().map(|bus| bus.tally.totals()).collect();
        outcome
    }
}
