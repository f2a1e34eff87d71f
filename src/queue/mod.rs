//! Between capture and the writer: a queue bounded by bytes that never makes capture wait.
//!
//! Each bus pushes through its [`Inlet`]; what does not fit is counted there. Each bus has its
//! [`Tally`], and at the end of every recording received = written + dropped.

mod inlet;
mod tally;
mod wire;

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

pub use inlet::{Allowance, Inlet};
pub use tally::{Controller, Tally, Totals};

use crate::frame::{Frame, Stamped};

/// The writer is woken early when this much waits for it, or half of what may wait; otherwise it
/// comes by itself.
const WAKE_BYTES: usize = 256 << 10;

/// Index of a bus in the recording, in the order of the command line.
pub type BusIndex = u16;

/// One thing on its way to the writer.
#[derive(Clone, Debug)]
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
    wake_bytes: usize,
}

#[derive(Default)]
struct State {
    items: VecDeque<Item>,
    bytes: usize,
    /// Set when nothing more will come, and by [`Queue::poke`].
    closed: bool,
    poked: bool,
}

impl Queue {
    /// A queue that holds at most `limit` bytes.
    pub fn new(limit: usize) -> Arc<Self> {
        let state = Mutex::new(State::default());
        let wake_bytes = WAKE_BYTES.min(limit / 2);
        Arc::new(Self { state, wake: Condvar::new(), limit, wake_bytes })
    }

    /// Moves up to `most` items into `into`, waiting at most `wait` for enough of them to be worth
    /// the trouble. Returns false once the queue is closed and empty.
    pub fn take(&self, into: &mut Vec<Item>, most: usize, wait: Duration) -> bool {
        let idle = |s: &mut State| s.bytes < self.wake_bytes && !s.closed && !s.poked;
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

    /// Bytes waiting now.
    pub fn fill(&self) -> usize {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).bytes
    }

    /// Takes all of `frames` or nothing. With `force`, also beyond the limit: for the few small
    /// things that must not be lost, such as the last gaps and what a person should know.
    fn push(&self, bus: BusIndex, frames: &mut Vec<Stamped<Frame>>, force: bool) -> bool {
        let bytes: usize = frames.iter().map(|f| size_of::<Item>() + heap(&f.value)).sum();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if !force && state.bytes + bytes > self.limit {
            return false;
        }
        let before = state.bytes;
        state.bytes += bytes;
        state.items.extend(frames.drain(..).map(|frame| Item { bus, frame }));
        if before < self.wake_bytes && state.bytes >= self.wake_bytes {
            self.wake.notify_one();
        }
        true
    }
}

fn cost(item: &Item) -> usize {
    size_of::<Item>() + heap(&item.frame.value)
}

/// Bytes of memory that a frame takes elsewhere.
pub fn heap(frame: &Frame) -> usize {
    match frame {
        Frame::Can(_) | Frame::Gap(_) => 0,
        Frame::Serial(bytes) => bytes.data.capacity() + bytes.errors.capacity() * 8,
        Frame::Notice(notice) => notice.text.capacity(),
    }
}
