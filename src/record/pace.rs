//! When things reach the disk.

use std::time::Duration;

use crate::frame::Timestamp;

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

impl Pace {
    /// Half the chunk time, so that a frame waits at most that long for the writer and again as long
    /// in the open chunk.
    pub fn half(self) -> Duration {
        self.chunk / 2
    }

    /// True when what waits since the first of `pending` has to be written.
    pub fn is_due(self, pending: Option<(Timestamp, Timestamp)>, now: Timestamp) -> bool {
        let half = u64::try_from(self.half().as_nanos()).unwrap_or(u64::MAX);
        pending.is_some_and(|(oldest, _)| now.since(oldest) >= half)
    }
}
