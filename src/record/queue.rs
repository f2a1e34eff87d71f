//! Between capture and the writer: a queue bounded by bytes that never makes capture wait.
//!
//! When it is full, what arrives is counted and dropped, and the next thing that fits is preceded
//! by a [`Gap`] that says how much and from when to when.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::tally::Tally;
use crate::clock::Timeline;
use crate::frame::{Frame, Gap, GapReason, Level, Notice, Stamped, Timestamp, Unit};

/// The writer is woken early when this much waits for it; otherwise it comes by itself.
const WAKE_BYTES: usize = 256 << 10;

/// Index of a bus in the recording, in the order of the command line.
pub type BusIndex = u16;

/// One thing on its way to the writer.
#[derive(Debug)]
pub struct Item {
    /// Which bus it happened on.
    pub bus: BusIndex,
    /// What happened, and when.
    pub frame: Stamped<Frame>,
}

/// The queue. Capture pushes through [`Inlet`]s, the writer takes.
pub struct Queue {
    state: Mutex<State>,
    wake: Condvar,
    limit: usize,
}

#[derive(Default)]
struct State {
    items: VecDeque<Item>,
    bytes: usize,
    peak: usize,
    /// Set when nothing more will come, and by [`Queue::poke`].
    closed: bool,
    poked: bool,
}

impl Queue {
    /// A queue that holds at most `limit` bytes.
    pub fn new(limit: usize) -> Arc<Self> {
        let state = Mutex::new(State::default());
        Arc::new(Self { state, wake: Condvar::new(), limit })
    }

    /// Moves up to `most` items into `into`, waiting at most `wait` for enough of them to be worth
    /// the trouble. Returns false once the queue is closed and empty.
    pub fn take(&self, into: &mut Vec<Item>, most: usize, wait: Duration) -> bool {
        let idle = |s: &mut State| s.bytes < WAKE_BYTES && !s.closed && !s.poked;
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut state, _) =
            self.wake.wait_timeout_while(state, wait, idle).unwrap_or_else(PoisonError::into_inner);
        state.poked = false;
        let count = state.items.len().min(most);
        let freed: usize = state.items.range(..count).map(cost).sum();
        into.extend(state.items.drain(..count));
        state.bytes -= freed;
        !(state.closed && state.items.is_empty() && count == 0)
    }

    /// Nothing more will come: `take` returns what is left, then false.
    pub fn close(&self) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.wake.notify_all();
    }

    /// Wakes the writer now.
    pub fn poke(&self) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).poked = true;
        self.wake.notify_all();
    }

    /// Bytes waiting now, and the most that ever waited.
    pub fn fill(&self) -> (usize, usize) {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        (state.bytes, state.peak)
    }

    /// Takes all of `frames` or nothing. With `force`, also beyond the limit: for the few small
    /// things that must not be lost, such as the gap that says that others were.
    fn push(&self, bus: BusIndex, frames: &mut Vec<Stamped<Frame>>, force: bool) -> bool {
        let bytes: usize = frames.iter().map(|f| size_of::<Item>() + heap(&f.value)).sum();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if !force && state.bytes + bytes > self.limit {
            return false;
        }
        let before = state.bytes;
        state.bytes += bytes;
        state.peak = state.peak.max(state.bytes);
        state.items.extend(frames.drain(..).map(|frame| Item { bus, frame }));
        if before < WAKE_BYTES && state.bytes >= WAKE_BYTES {
            self.wake.notify_one();
        }
        true
    }
}

fn cost(item: &Item) -> usize {
    size_of::<Item>() + heap(&item.frame.value)
}

fn heap(frame: &Frame) -> usize {
    match frame {
        Frame::Can(_) | Frame::Gap(_) => 0,
        Frame::Serial(bytes) => bytes.data.capacity() + bytes.errors.capacity() * 8,
        Frame::Notice(notice) => notice.text.capacity(),
    }
}

/// How many frames the whole recording may still take (`--count`), shared by all buses.
#[derive(Debug)]
pub struct Allowance(AtomicU64);

impl Allowance {
    /// At most `count` frames; `None` for no end.
    pub fn new(count: Option<u64>) -> Arc<Self> {
        Arc::new(Self(AtomicU64::new(count.unwrap_or(u64::MAX))))
    }

    /// Takes up to `wanted` and says how many were granted.
    fn take(&self, wanted: u64) -> u64 {
        let mut granted = 0;
        let _ = self.0.fetch_update(Relaxed, Relaxed, |left| {
            granted = wanted.min(left);
            Some(if left == u64::MAX { left } else { left - granted })
        });
        granted
    }

    /// True when nothing more may be taken.
    pub fn used_up(&self) -> bool {
        self.0.load(Relaxed) == 0
    }
}

/// One bus's way into the recording. Never blocks.
pub struct Inlet {
    bus: BusIndex,
    unit: Unit,
    queue: Arc<Queue>,
    tally: Arc<Tally>,
    allowance: Arc<Allowance>,
    timeline: Timeline,
    /// What the full queue has cost since something last fitted.
    owed: Option<Gap>,
    scratch: Vec<Stamped<Frame>>,
}

impl Inlet {
    /// The way into `queue` for bus number `bus`, whose loss is counted in `unit`.
    pub fn new(
        bus: BusIndex,
        unit: Unit,
        queue: Arc<Queue>,
        tally: Arc<Tally>,
        allowance: Arc<Allowance>,
        timeline: Timeline,
    ) -> Self {
        let scratch = Vec::with_capacity(1);
        Self { bus, unit, queue, tally, allowance, timeline, owed: None, scratch }
    }

    /// The recording's timeline.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// The counters of this bus.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Hands over frames that were read from the bus, in their order; `frames` is empty
    /// afterwards. Frames beyond `--count` were not asked for and are not counted.
    pub fn push(&mut self, frames: &mut Vec<Stamped<Frame>>) {
        let granted = self.allowance.take(frames.len() as u64);
        frames.truncate(usize::try_from(granted).unwrap_or(usize::MAX));
        let Some(first) = frames.first().map(|f| f.time) else { return };
        let last = frames.last().map_or(first, |f| f.time);
        let count: u64 = frames.iter().map(|f| weight(&f.value)).sum();
        self.tally.received(count);
        if let Some(gap) = self.owed {
            // The gap travels in front of what follows it, or not at all yet.
            frames.insert(0, Stamped { time: gap.to, value: Frame::Gap(gap) });
        }
        if self.queue.push(self.bus, frames, false) {
            self.owed = None;
            return;
        }
        frames.clear();
        self.tally.dropped(GapReason::RecorderQueue, count);
        let gap = self.owed.get_or_insert(Gap {
            count: 0,
            unit: self.unit,
            reason: GapReason::RecorderQueue,
            from: first,
            to: last,
        });
        gap.count += count;
        gap.to = last;
    }

    /// Hands over one frame.
    pub fn push_one(&mut self, time: Timestamp, value: Frame) {
        let mut one = std::mem::take(&mut self.scratch);
        one.push(Stamped { time, value });
        self.push(&mut one);
        self.scratch = one;
    }

    /// Something was lost before it could be read. Counted as received and dropped.
    pub fn gap(&mut self, reason: GapReason, count: u64, from: Timestamp, to: Timestamp) {
        self.tally.missed(reason, count);
        let gap = Gap { count, unit: self.unit, reason, from, to };
        self.force(to, Frame::Gap(gap));
    }

    /// A sentence for `/bustape/log`.
    pub fn notice(&mut self, level: Level, text: impl Into<String>) {
        let time = self.timeline.now();
        self.force(time, Frame::Notice(Notice { level, text: text.into() }));
    }

    /// True when `--count` is reached and nothing more needs to be read.
    pub fn satisfied(&self) -> bool {
        self.allowance.used_up()
    }

    fn force(&mut self, time: Timestamp, value: Frame) {
        let mut one = vec![Stamped { time, value }];
        self.queue.push(self.bus, &mut one, true);
    }
}

impl Drop for Inlet {
    /// What the full queue cost at the very end is in the file too.
    fn drop(&mut self) {
        if let Some(gap) = self.owed.take() {
            self.force(gap.to, Frame::Gap(gap));
        }
    }
}

/// What a frame counts for in its bus's unit.
pub fn weight(frame: &Frame) -> u64 {
    match frame {
        Frame::Can(_) => 1,
        Frame::Serial(bytes) => bytes.data.len() as u64,
        Frame::Gap(_) | Frame::Notice(_) => 0,
    }
}
