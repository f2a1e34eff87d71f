//! Times of frames that one read returned together.

use crate::frame::Timestamp;

/// The adapter's stamp counts milliseconds and starts anew after a minute.
const MINUTE: u64 = 60_000;
const MILLISECOND: u64 = 1_000_000;

/// Gives frames of one read their distance in time, where the adapter stamps them.
///
/// The last frame of a read has the time of the read; the others came earlier by the difference
/// of their stamps (to the millisecond), but not before the read before. Without stamps all have
/// the time of the read. The adapter's clock is used over one read only, so its drift is nothing.
#[derive(Debug)]
pub(crate) struct Spacing {
    /// No frame may be earlier.
    floor: Timestamp,
}

impl Spacing {
    /// Frames come from `start` on.
    pub fn new(start: Timestamp) -> Self {
        Self { floor: start }
    }

    /// The times of frames with `stamps` that were read at `read`.
    pub fn times(&mut self, read: Timestamp, stamps: &[Option<u16>]) -> Vec<Timestamp> {
        let last = stamps.iter().rev().find_map(|s| *s);
        let mut earliest = self.floor.min(read);
        let times = stamps.iter().map(|stamp| {
            let ago = match (stamp, last) {
                (Some(stamp), Some(last)) => {
                    (MINUTE + u64::from(last) - u64::from(*stamp)) % MINUTE * MILLISECOND
                }
                // Between stamped ones: as early as order allows.
                (None, Some(_)) => u64::MAX,
                _ => 0,
            };
            earliest = earliest.max(Timestamp(read.nanos().saturating_sub(ago)));
            earliest
        });
        let times = times.collect();
        self.floor = read;
        times
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: u64 = 1_700_000_000_000_000_000;

    fn ms(count: u64) -> Timestamp {
        Timestamp(AT + count * MILLISECOND)
    }

    #[test]
    fn frames_of_one_read_keep_their_distance() {
        let mut spacing = Spacing::new(ms(0));
        let times = spacing.times(ms(100), &[Some(59_990), Some(59_999), Some(5), Some(5)]);
        assert_eq!(times, [ms(85), ms(94), ms(100), ms(100)]);
        assert_eq!(spacing.times(ms(105), &[None, None]), [ms(105), ms(105)]);
    }

    #[test]
    fn no_stamp_moves_a_frame_before_the_read_before_it_or_after_its_own() {
        let mut spacing = Spacing::new(ms(90));
        for stamps in [[Some(0), Some(50_000)], [Some(50_000), Some(0)], [None, Some(7)]] {
            let times = spacing.times(ms(100), &stamps);
            assert!(times.is_sorted() && times[0] >= ms(90) && times[1] <= ms(100), "{times:?}");
            spacing = Spacing::new(ms(90));
        }
        assert_eq!(Spacing::new(ms(9)).times(ms(5), &[None]), [ms(5)]);
    }
}
