//! The machine's clocks.

use nix::time::{ClockId, clock_gettime};

use crate::clock::{Clock, Reading};

/// A reading is good enough when both clocks were read within this many nanoseconds.
const TIGHT_NANOS: u64 = 20_000;

/// How often a reading that was torn apart (by an interrupt, a busy processor) is tried again.
const TRIES: u32 = 5;

/// `CLOCK_REALTIME` and `CLOCK_BOOTTIME`, the steady clock that runs on in suspend.
#[derive(Clone, Copy, Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    /// The wall clock between two readings of the steady clock; `steady` is their midpoint. Of up
    /// to five such readings the first within 20 µs counts, otherwise the narrowest.
    fn read(&self) -> Reading {
        read_between(|| nanos(ClockId::CLOCK_BOOTTIME), || nanos(ClockId::CLOCK_REALTIME))
    }
}

fn read_between(mut steady: impl FnMut() -> u64, mut wall: impl FnMut() -> u64) -> Reading {
    let mut best = Reading { wall: 0, steady: 0 };
    let mut narrowest = u64::MAX;
    for _ in 0..TRIES {
        let before = steady();
        let middle = wall();
        let width = steady().saturating_sub(before);
        if width < narrowest {
            narrowest = width;
            best = Reading { wall: middle, steady: before + width / 2 };
        }
        if narrowest <= TIGHT_NANOS {
            break;
        }
    }
    best
}

/// Nanoseconds of a clock. Neither clock can fail on Linux since 2.6.39; 0 stands for "before
/// 1970", which a machine without a battery clock may show.
fn nanos(clock: ClockId) -> u64 {
    clock_gettime(clock).map_or(0, |time| {
        let seconds = u64::try_from(time.tv_sec()).unwrap_or(0);
        seconds.saturating_mul(1_000_000_000) + u64::try_from(time.tv_nsec()).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_tight_reading_counts() {
        let mut times = [100, 100 + 2 * TIGHT_NANOS, 500_000, 510_000].into_iter();
        let mut walls = [1, 2].into_iter();
        let reading = read_between(|| times.next().unwrap(), || walls.next().unwrap());
        assert_eq!(reading, Reading { wall: 2, steady: 505_000 });
    }

    #[test]
    fn of_torn_readings_the_narrowest_counts() {
        let widths = [90_000, 30_000, 80_000, 40_000, 50_000];
        let mut times = widths.iter().enumerate().flat_map(|(i, w)| {
            let start = 1_000_000 * (i as u64 + 1);
            [start, start + w]
        });
        let mut walls = 1..;
        let reading = read_between(|| times.next().unwrap(), || walls.next().unwrap());
        assert_eq!(reading, Reading { wall: 2, steady: 2_015_000 });
    }

    #[test]
    fn the_machine_has_both_clocks_and_they_advance() {
        let first = SystemClock.read();
        std::thread::sleep(std::time::Duration::from_millis(2));
        let second = SystemClock.read();
        assert!(first.wall > 1_600_000_000_000_000_000 && first.steady > 0);
        assert!(second.steady - first.steady >= 2_000_000);
    }
}
