//! Where the times of a log begin that counts them from its first frame.

use super::kept::{EARLIER, Unkept};
use crate::frame::Timestamp;

/// What heads of logs can say is whole milliseconds.
const STEP: u64 = 1_000_000;

/// Nanoseconds since 1970: the first frame's, rounded down to whole milliseconds. None before that.
#[derive(Clone, Copy, Debug, Default)]
pub struct Start(Option<u64>);

impl Start {
    /// The start, if there was a frame.
    pub fn nanos(self) -> Option<u64> {
        self.0
    }

    /// Fixes the start where there is none yet; true if there was none.
    pub fn begin(&mut self, nanos: u64) -> bool {
        let first = self.0.is_none();
        self.0.get_or_insert(nanos / STEP * STEP);
        first
    }

    /// Nanoseconds from the start to `time`, 0 where that is earlier.
    pub fn since(self, time: Timestamp, unkept: &mut Unkept) -> u64 {
        let start = self.0.unwrap_or_default();
        if time.nanos() < start {
            unkept.add(EARLIER);
        }
        time.nanos().saturating_sub(start)
    }
}
