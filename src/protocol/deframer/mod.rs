//! Cuts bytes into frames, one byte at a time.
//!
//! No byte is looked at twice, nothing depends on how the bytes were cut into reads (except where
//! silence tells frames apart), and no more than one frame is held.

pub(super) mod cobs;
mod counted;
mod delimited;
mod silence;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use counted::Counted;
use delimited::Delimited;
use silence::Silence;

use super::framing::{Framing, Kind};
use crate::frame::Timestamp;

/// What was found in the bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cut {
    /// An unbroken run of bytes outside any frame.
    Garbage {
        /// How many.
        bytes: u64,
    },
    /// A frame that was given up because another one began.
    Truncated,
    /// A frame that was open when the input ended.
    Incomplete,
    /// A byte that must not follow the escape byte; the frame ended there.
    BadEscape {
        /// That byte.
        byte: u8,
    },
    /// A whole frame with a wrong check.
    CrcError {
        /// As sent.
        received: u64,
        /// As it should be.
        computed: u64,
        /// Bits of the check.
        width: u32,
    },
    /// A frame whose length is impossible or not the one it says.
    BadLength {
        /// Bytes of it that had been received.
        bytes: usize,
    },
    /// A frame longer than any can be; dropped up to its end.
    TooLong {
        /// How many bytes.
        bytes: u64,
    },
    /// A frame that is not COBS.
    BadEncoding {
        /// Bytes between the zeros.
        bytes: usize,
    },
    /// A good frame, unescaped, with everything that is in it.
    Frame(Vec<u8>),
}

/// Takes what was found, and when its first byte came.
pub type Take<'a> = dyn FnMut(Timestamp, Cut) + 'a;

/// Cuts the bytes of one line into frames.
#[derive(Debug)]
pub struct Deframer {
    framing: Arc<Framing>,
    state: State,
}

#[derive(Debug)]
enum State {
    Counted(Counted),
    Delimited(Delimited),
    Silence(Silence),
}

impl Deframer {
    /// Begins outside a frame.
    pub fn new(framing: Arc<Framing>) -> Self {
        let state = match &framing.kind {
            Kind::Counted { .. } => State::Counted(Counted::default()),
            Kind::Delimited { .. } => State::Delimited(Delimited::default()),
            Kind::Silence(_) => State::Silence(Silence::default()),
        };
        Self { framing, state }
    }

    /// Takes the next bytes of the line, which came at `time`.
    pub fn feed(&mut self, time: Timestamp, bytes: &[u8], take: &mut Take<'_>) {
        let layout = &self.framing.layout;
        match (&mut self.state, &self.framing.kind) {
            (State::Counted(state), Kind::Counted { start, escape }) => {
                let rules = counted::Rules { start, escape: escape.as_ref(), layout };
                for byte in bytes {
                    state.byte(&rules, time, *byte, take);
                }
            }
            (State::Delimited(state), Kind::Delimited { start, end, escape, cobs }) => {
                let escape = escape.as_ref();
                let rules = delimited::Rules { start: *start, end, escape, cobs: *cobs, layout };
                for byte in bytes {
                    state.byte(&rules, time, *byte, take);
                }
            }
            (State::Silence(state), Kind::Silence(gap)) => {
                state.feed(*gap, layout, time, bytes, take);
            }
            // A state is made for its kind and neither changes.
            _ => {}
        }
    }

    /// Says that it is `time` and no byte has come since; where silence ends frames, it may now.
    pub fn pass(&mut self, time: Timestamp, take: &mut Take<'_>) {
        if let (State::Silence(state), Kind::Silence(gap)) = (&mut self.state, &self.framing.kind) {
            state.pass(*gap, &self.framing.layout, time, take);
        }
    }

    /// Says that the input has ended (or that bytes are missing here) and starts afresh.
    pub fn finish(&mut self, take: &mut Take<'_>) {
        match &mut self.state {
            State::Counted(state) => state.finish(take),
            State::Delimited(state) => state.finish(take),
            State::Silence(state) => state.close(&self.framing.layout, take),
        }
    }
}

/// A run of bytes outside frames.
#[derive(Debug, Default)]
struct Run {
    bytes: u64,
    time: Timestamp,
}

impl Run {
    fn add(&mut self, time: Timestamp, bytes: u64) {
        if self.bytes == 0 {
            self.time = time;
        }
        self.bytes += bytes;
    }

    fn tell(&mut self, take: &mut Take<'_>) {
        let bytes = std::mem::take(&mut self.bytes);
        if bytes > 0 {
            take(self.time, Cut::Garbage { bytes });
        }
    }
}
