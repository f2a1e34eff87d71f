//! When to read: at once, or a moment later with more frames in one system call.

use crate::frame::Timestamp;

/// Reads that follow each other within this time could have been one.
const QUICK_NANOS: u64 = 1_000_000;
/// So many in a row mean a busy bus and not the burst that begins a cycle.
const QUICK_READS: u32 = 16;
/// Fewer frames than this in a nap, and napping saves nothing.
const WORTH: usize = 2;
/// A nap may fill only this part of the receive buffer.
const SHARE: usize = 8;
/// The fewest frames a receive buffer must hold for naps: 42 of the shortest frames pass at
/// 1 Mbit/s in the 2 ms that a nap may last, and some room must be left.
const ROOM: usize = 256;

/// Decides between waiting for each frame and napping between reads.
#[derive(Debug)]
pub(super) struct Pace {
    /// Frames the receive buffer holds.
    capacity: usize,
    last: Timestamp,
    quick: u32,
    napping: bool,
}

impl Pace {
    /// For a socket whose receive buffer holds `capacity` frames.
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity, last: Timestamp(0), quick: 0, napping: false }
    }

    /// Takes note of a read of `frames` at `now` and says whether to nap before the next.
    pub(super) fn nap_after(&mut self, frames: usize, now: Timestamp) -> bool {
        if self.napping {
            self.napping = frames >= WORTH && frames <= self.capacity / SHARE;
            self.quick = 0;
        } else {
            let quick = now.since(self.last) < QUICK_NANOS;
            self.quick = if quick { self.quick + 1 } else { 0 };
            self.napping = self.quick >= QUICK_READS && self.capacity >= ROOM;
        }
        self.last = now;
        self.napping
    }

    /// There was nothing to read: wait for the next frame.
    pub(super) fn rest(&mut self) {
        (self.napping, self.quick) = (false, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames every `gap` ns, one a read, and whether the pace naps after each.
    fn naps(pace: &mut Pace, reads: u64, gap: u64) -> Vec<bool> {
        (1..=reads).map(|i| pace.nap_after(1, Timestamp(1_000_000_000 + i * gap))).collect()
    }

    #[test]
    fn a_busy_bus_is_napped_a_quiet_one_is_not() {
        let mut busy = Pace::new(4_000);
        assert!(naps(&mut busy, 40, 250_000).contains(&true));
        let mut quiet = Pace::new(4_000);
        assert!(!naps(&mut quiet, 1_000, 1_000_000).contains(&true));
        let mut tight = Pace::new(100);
        assert!(!naps(&mut tight, 1_000, 100_000).contains(&true));
    }

    #[test]
    fn napping_ends_when_it_saves_nothing_or_fills_the_buffer() {
        for frames in [0, 1, 101] {
            let mut pace = Pace::new(800);
            naps(&mut pace, 1 + u64::from(QUICK_READS), 1_000);
            assert!(pace.nap_after(100, Timestamp(3_000_000_000)));
            assert!(!pace.nap_after(frames, Timestamp(3_002_000_000)));
        }
    }
}
