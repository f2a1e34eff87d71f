//! The books of each bus: received = written + dropped, always.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::frame::GapReason;

/// Counters of one bus. CAN counts frames, serial counts bytes.
///
/// Capture adds to `received` and the drops it sees, the writer to `written` and its own drops;
/// when both have finished, [`Totals::balanced`] holds.
#[derive(Debug, Default)]
pub struct Tally {
    received: AtomicU64,
    written: AtomicU64,
    dropped: [AtomicU64; GapReason::ALL.len()],
    /// Gaps of which nobody knows how much they cost.
    outages: AtomicU64,
    /// Bits on the wire, for the bus load.
    bits: AtomicU64,
}

/// A [`Tally`] at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// What reached the host: read by us, or counted by the kernel, driver or adapter as lost.
    pub received: u64,
    /// What is in the file.
    pub written: u64,
    /// What is not, by reason, in the order of [`GapReason::ALL`].
    pub dropped: [u64; GapReason::ALL.len()],
    /// Gaps of unknown size: the link was away.
    pub outages: u64,
    /// Bits on the wire so far.
    pub bits: u64,
}

impl Tally {
    /// `count` frames or bytes were read from the bus.
    pub fn received(&self, count: u64) {
        self.received.fetch_add(count, Relaxed);
    }

    /// `count` frames or bytes are in the file.
    pub fn written(&self, count: u64) {
        self.written.fetch_add(count, Relaxed);
    }

    /// `count` frames or bytes that had been counted as received are lost.
    pub fn dropped(&self, reason: GapReason, count: u64) {
        self.dropped[index(reason)].fetch_add(count, Relaxed);
    }

    /// `count` frames or bytes were lost before we could read them: received and dropped at once.
    /// 0 stands for a number nobody knows.
    pub fn missed(&self, reason: GapReason, count: u64) {
        self.outages.fetch_add(u64::from(count == 0), Relaxed);
        self.received(count);
        self.dropped(reason, count);
    }

    /// `bits` passed on the wire.
    pub fn bits(&self, bits: u64) {
        self.bits.fetch_add(bits, Relaxed);
    }

    /// The counters now.
    pub fn totals(&self) -> Totals {
        Totals {
            received: self.received.load(Relaxed),
            written: self.written.load(Relaxed),
            dropped: std::array::from_fn(|i| self.dropped[i].load(Relaxed)),
            outages: self.outages.load(Relaxed),
            bits: self.bits.load(Relaxed),
        }
    }
}

impl Totals {
    /// All drops together.
    pub fn lost(&self) -> u64 {
        self.dropped.iter().sum()
    }

    /// Drops for one reason.
    pub fn lost_to(&self, reason: GapReason) -> u64 {
        self.dropped[index(reason)]
    }

    /// True when nothing was lost, not even an unknown number.
    pub fn complete(&self) -> bool {
        self.lost() == 0 && self.outages == 0
    }

    /// received = written + dropped.
    pub fn balanced(&self) -> bool {
        self.received == self.written + self.lost()
    }
}

/// The place of a reason's counter: that of its declaration, which is that in [`GapReason::ALL`].
fn index(reason: GapReason) -> usize {
    reason as usize
}
