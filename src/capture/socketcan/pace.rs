//! When to read: at once, or a moment later with more frames in one system call.

use std::time::Duration;

use crate::frame::Timestamp;

/// Reads that follow each other within this time could have been one.
const QUICK_NANOS: u64 = 4_000_000;
/// So many in a row mean a busy bus and not the burst that begins a cycle.
const QUICK_READS: u32 = 16;
/// Fewer frames than this in a nap, and napping saves nothing.
const WORTH: usize = 2;
/// A nap may fill only this part of the receive buffer.
const SHARE: usize = 8;
/// The fewest frames a receive buffer must hold for naps: 42 of the shortest frames pass at
/// 1 Mbit/s in the 2 ms that the shortest nap may last, and some room must be left.
const ROOM: usize = 256;
/// So many of the shortest frames pass in a millisecond at 1 Mbit/s.
const MOST_PER_MILLI: usize = 22;
/// Longest nap. To wake up costs as much as to record some thirty frames, so the longer the
/// better; a frame waits for its chunk far longer than this anyway.
const LONGEST_MILLIS: usize = 8;

/// Decides between waiting for each frame and napping between reads.
#[derive(Debug)]
pub(super) struct Pace {
    /// Frames the receive buffer holds.
    capacity: usize,
    /// How long a nap lasts.
    nap: Duration,
    last: Timestamp,
    quick: u32,
    napping: bool,
    /// Frames read since the last nap, as far as more followed at once.
    read: usize,
}

impl Pace {
    /// For a socket whose receive buffer holds `capacity` frames.
    pub(super) fn new(capacity: usize) -> Self {
        let millis = (capacity / SHARE / MOST_PER_MILLI).clamp(1, LONGEST_MILLIS);
        let nap = Duration::from_millis(millis as u64);
        Self { capacity, nap, last: Timestamp(0), quick: 0, napping: false, read: 0 }
    }

    /// Takes note of a read of `frames` that left more to read, which is no time for a nap.
    pub(super) fn go_on(&mut self, frames: usize) {
        self.read += frames;
    }

    /// Takes note of a read of `frames` at `now` and says how long to nap before the next, if at
    /// all.
    pub(super) fn nap_after(&mut self, frames: usize, now: Timestamp) -> Option<Duration> {
        let frames = frames + std::mem::take(&mut self.read);
        if self.napping {
            self.napping = frames >= WORTH && frames <= self.capacity / SHARE;
            self.quick = 0;
        } else {
            let quick = now.since(self.last) < QUICK_NANOS;
            self.quick = if quick { self.quick + 1 } else { 0 };
            self.napping = self.quick >= QUICK_READS && self.capacity >= ROOM;
        }
        self.last = now;
        self.napping.then_some(self.nap)
    }

    /// There was nothing to read: wait for the next frame.
    pub(super) fn rest(&mut self) {
        (self.napping, self.quick, self.read) = (false, 0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames every `gap` ns, one a read, and whether the pace naps after one of them.
    fn naps(pace: &mut Pace, reads: u64, gap: u64) -> bool {
        let mut nap = |i| pace.nap_after(1, Timestamp(1_000_000_000 + i * gap)).is_some();
        (1..=reads).any(&mut nap)
    }

    #[test]
    fn a_busy_bus_is_napped_a_quiet_one_is_not() {
        let mut busy = Pace::new(4_000);
        assert!(naps(&mut busy, 40, 250_000));
        let mut quiet = Pace::new(4_000);
        assert!(!naps(&mut quiet, 1_000, 4_000_000));
        let mut tight = Pace::new(100);
        assert!(!naps(&mut tight, 1_000, 100_000));
    }

    #[test]
    fn a_nap_is_short_enough_for_the_receive_buffer() {
        for capacity in [ROOM, 400, 4_000, 1_000_000] {
            let nap = Pace::new(capacity).nap.as_millis() as usize;
            assert!((1..=LONGEST_MILLIS).contains(&nap), "{capacity}: {nap} ms");
            // A nap may last a millisecond longer than asked for.
            assert!((nap + 1) * MOST_PER_MILLI < capacity / 4, "{capacity}: {nap} ms");
        }
    }

    #[test]
    fn napping_ends_when_it_saves_nothing_or_fills_the_buffer() {
        for frames in [0, 1, 101] {
            let mut pace = Pace::new(800);
            naps(&mut pace, 1 + u64::from(QUICK_READS), 1_000);
            assert!(pace.nap_after(100, Timestamp(3_000_000_000)).is_some());
            pace.go_on(frames / 2);
            let rest = frames - frames / 2;
            assert!(pace.nap_after(rest, Timestamp(3_002_000_000)).is_none());
        }
    }
}
