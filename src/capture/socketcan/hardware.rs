//! From the clock of a CAN controller to the recording's timeline.

use crate::frame::Timestamp;

/// How long the smallest delay seen counts. Shorter: more jitter gets through. Longer: the two
/// clocks, some 10 to 100 millionths apart, drift further between corrections.
const WINDOW_NANOS: u64 = 1_000_000_000;

/// A controller whose clock jumps by more than this was restarted.
const RESTART_NANOS: u128 = 1_000_000_000;

/// Maps one controller's clock, which counts from some moment of its own, to the timeline.
///
/// The kernel's stamp is never early, only late, by as long as the driver and the interrupt took.
/// So the smallest difference between the two stamps in the last second or two is the best
/// estimate of the clocks' offset, and hardware time plus that offset is when the frame really
/// was received: never later than the kernel's stamp, and free of the host's jitter.
#[derive(Debug, Default)]
pub(super) struct HardwareTime {
    current: Option<Offset>,
}

/// Timeline minus hardware clock, nanoseconds.
#[derive(Clone, Copy, Debug)]
struct Offset {
    used: i128,
    /// The smallest since the window began.
    smallest: i128,
    window_ends: Timestamp,
}

impl HardwareTime {
    /// When the controller received what it stamped with `hardware` ns and the kernel `kernel`.
    pub(super) fn map(&mut self, hardware: u64, kernel: Timestamp) -> Timestamp {
        let seen = i128::from(kernel.nanos()) - i128::from(hardware);
        let window_ends = kernel.plus(WINDOW_NANOS);
        let fresh = Offset { used: seen, smallest: seen, window_ends };
        let offset = match self.current {
            Some(offset) if (seen - offset.used).unsigned_abs() <= RESTART_NANOS => {
                let smallest = offset.smallest.min(seen);
                if kernel >= offset.window_ends {
                    Offset { used: smallest, smallest: seen, window_ends }
                } else {
                    Offset { used: offset.used.min(seen), smallest, ..offset }
                }
            }
            _ => fresh,
        };
        self.current = Some(offset);
        Timestamp(u64::try_from(i128::from(hardware) + offset.used).unwrap_or(kernel.nanos()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MILLI: u64 = 1_000_000;

    #[test]
    fn jitter_of_the_host_does_not_get_through() {
        let mut clock = HardwareTime::default();
        let start = 1_700_000_000_000 * MILLI;
        let mut times = Vec::new();
        for (frame, delay) in [50, 400, 90, 50, 3_000, 60].into_iter().enumerate() {
            let hardware = 10 * MILLI * (frame as u64 + 1);
            times.push(clock.map(hardware, Timestamp(start + hardware + delay * 1_000)).nanos());
        }
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 10 * MILLI), "{times:?}");
    }

    #[test]
    fn drift_is_followed() {
        let mut clock = HardwareTime::default();
        for frame in 1..1_000 {
            let kernel = frame * 10 * MILLI;
            let hardware = kernel - kernel / 10_000; // 100 millionths slow
            let error = kernel - clock.map(hardware, Timestamp(kernel)).nanos();
            assert!(error <= 250_000, "{error} at frame {frame}");
        }
    }

    #[test]
    fn a_restarted_controller_is_noticed() {
        let mut clock = HardwareTime::default();
        clock.map(5_000 * MILLI, Timestamp(90_000 * MILLI));
        assert_eq!(clock.map(MILLI, Timestamp(91_000 * MILLI)), Timestamp(91_000 * MILLI));
    }
}
