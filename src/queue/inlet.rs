//! A bus's way into the recording: counts what comes, and owes a gap for what found no room.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::wire::Wire;
use super::{BusIndex, Queue, Tally};
use crate::clock::Timeline;
use crate::frame::{Frame, Gap, GapReason, Level, Notice, Stamped, Timestamp, Unit};

/// How many frames the whole recording may still take (`--count`), shared by all buses.
#[derive(Debug)]
pub struct Allowance(AtomicU64);

impl Allowance {
    /// At most `count` frames; `None` for no end.
    pub fn new(count: Option<u64>) -> Arc<Self> {
        Arc::new(Self(AtomicU64::new(count.unwrap_or(u64::MAX))))
    }

    /// Takes up to `wanted` and says how many were granted.
    fn take(&self, wanted: u64) -> u64 {
        let mut granted = 0;
        let _ = self.0.fetch_update(Relaxed, Relaxed, |left| {
            granted = wanted.min(left);
            Some(if left == u64::MAX { left } else { left - granted })
        });
        granted
    }

    /// True when nothing more may be taken.
    pub fn used_up(&self) -> bool {
        self.0.load(Relaxed) == 0
    }
}

/// One bus's way into the recording. Never blocks.
pub struct Inlet {
    bus: BusIndex,
    unit: Unit,
    queue: Arc<Queue>,
    tally: Arc<Tally>,
    allowance: Arc<Allowance>,
    timeline: Timeline,
    /// Gaps that wait until something fits into the full queue again, at most one a reason.
    owed: Vec<Gap>,
    wire: Wire,
    scratch: Vec<Stamped<Frame>>,
}

impl Inlet {
    /// The way into `queue` for bus number `bus`, whose loss is counted in `unit`.
    pub fn new(
        bus: BusIndex,
        unit: Unit,
        queue: Arc<Queue>,
        tally: Arc<Tally>,
        allowance: Arc<Allowance>,
        timeline: Timeline,
    ) -> Self {
        let scratch = Vec::with_capacity(1);
        Self {
            bus,
            unit,
            queue,
            tally,
            allowance,
            timeline,
            owed: Vec::new(),
            wire: Wire::default(),
            scratch,
        }
    }

    /// The same, on a bus whose nominal and data bit rates are known.
    #[must_use]
    pub fn at_rates(mut self, nominal: Option<u32>, data: Option<u32>) -> Self {
        self.wire = Wire { rates: nominal.zip(data) };
        self
    }

    /// The recording's timeline.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// The counters of this bus.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Hands over frames that were read from the bus, in their order; `frames` is empty
    /// afterwards. Frames beyond `--count` were not asked for and are not counted.
    pub fn push(&mut self, frames: &mut Vec<Stamped<Frame>>) {
        let granted = self.allowance.take(frames.len() as u64);
        frames.truncate(usize::try_from(granted).unwrap_or(usize::MAX));
        let Some(first) = frames.first().map(|f| f.time) else { return };
        let last = frames.last().map_or(first, |f| f.time);
        let count: u64 = frames.iter().map(|f| f.value.weight()).sum();
        self.tally.received(count);
        self.tally.bits(frames.iter().map(|frame| self.wire.bits(&frame.value)).sum());
        // Gaps travel in front of what follows them, or not at all yet.
        let owed = self.owed.iter().map(|gap| Stamped { time: gap.to, value: Frame::Gap(*gap) });
        frames.splice(0..0, owed);
        if self.queue.push(self.bus, frames, false) {
            self.owed.clear();
            return;
        }
        frames.clear();
        self.tally.dropped(GapReason::RecorderQueue, count);
        self.owe(GapReason::RecorderQueue, count, first, last);
    }

    fn owe(&mut self, reason: GapReason, count: u64, from: Timestamp, to: Timestamp) {
        match self.owed.iter_mut().find(|gap| gap.reason == reason) {
            Some(gap) => {
                gap.count += count;
                gap.to = gap.to.max(to);
            }
            None => self.owed.push(Gap { count, unit: self.unit, reason, from, to }),
        }
    }

    /// Hands over one frame.
    pub fn push_one(&mut self, time: Timestamp, value: Frame) {
        let mut one = std::mem::take(&mut self.scratch);
        one.push(Stamped { time, value });
        self.push(&mut one);
        self.scratch = one;
    }

    /// Something was lost before it could be read. Counted as received and dropped.
    pub fn gap(&mut self, reason: GapReason, count: u64, from: Timestamp, to: Timestamp) {
        self.tally.missed(reason, count);
        self.owe(reason, count, from, to);
        let gap = |gap: &Gap| Stamped { time: gap.to, value: Frame::Gap(*gap) };
        let mut owed: Vec<_> = self.owed.iter().map(gap).collect();
        // Where even this does not fit, gaps of one reason add up until it does: a bus that is
        // lost faster than the disk takes it must not fill the memory with gaps.
        if self.queue.push(self.bus, &mut owed, false) {
            self.owed.clear();
        }
    }

    /// A sentence for `/bustape/log`.
    pub fn notice(&mut self, level: Level, text: impl Into<String>) {
        let time = self.timeline.now();
        self.force(time, Frame::Notice(Notice { level, text: text.into() }));
    }

    /// True when `--count` is reached and nothing more needs to be read.
    pub fn satisfied(&self) -> bool {
        self.allowance.used_up()
    }

    fn force(&mut self, time: Timestamp, value: Frame) {
        let mut one = vec![Stamped { time, value }];
        self.queue.push(self.bus, &mut one, true);
    }
}

impl Drop for Inlet {
    /// What the full queue cost at the very end is in the file too.
    fn drop(&mut self) {
        for gap in std::mem::take(&mut self.owed) {
            self.force(gap.to, Frame::Gap(gap));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::Item;
    use super::*;
    use crate::clock::{ManualClock, Reading};
    use crate::frame::{CanFlags, CanFrame};

    const ITEM: usize = size_of::<Item>();

    fn inlet(limit: usize, count: Option<u64>) -> (Arc<Queue>, Arc<Tally>, Inlet) {
        let clock = ManualClock::new(Reading { wall: 1_000, steady: 0 });
        let timeline = Timeline::start(Arc::new(clock));
        let (queue, tally) = (Queue::new(limit), Arc::new(Tally::default()));
        let allowance = Allowance::new(count);
        let inlet = Inlet::new(0, Unit::Frames, queue.clone(), tally.clone(), allowance, timeline);
        (queue, tally, inlet)
    }

    fn frames(times: std::ops::Range<u64>) -> Vec<Stamped<Frame>> {
        let frame = Frame::Can(CanFrame::new(1, CanFlags::default(), &[]));
        times.map(|t| Stamped { time: Timestamp(t), value: frame.clone() }).collect()
    }

    fn take(queue: &Queue) -> Vec<Stamped<Frame>> {
        let mut items = Vec::new();
        queue.take(&mut items, usize::MAX, Duration::ZERO);
        items.into_iter().map(|item| item.frame).collect()
    }

    fn gap(count: u64, reason: GapReason, from: u64, to: u64) -> Frame {
        let (from, to) = (Timestamp(from), Timestamp(to));
        Frame::Gap(Gap { count, unit: Unit::Frames, reason, from, to })
    }

    #[test]
    fn what_a_full_queue_costs_stands_in_front_of_what_follows() {
        let (queue, tally, mut inlet) = inlet(4 * ITEM, None);
        inlet.push(&mut frames(0..4));
        inlet.push(&mut frames(4..7));
        inlet.push(&mut frames(7..9));
        assert_eq!(take(&queue), frames(0..4));
        inlet.push(&mut frames(9..10));
        let taken = take(&queue);
        assert_eq!(taken[0].value, gap(5, GapReason::RecorderQueue, 4, 8));
        assert_eq!(taken[1..], frames(9..10));
        let totals = tally.totals();
        assert_eq!((totals.received, totals.lost()), (10, 5));
    }

    #[test]
    fn a_small_queue_does_not_wait_for_the_timer_until_it_is_full() {
        let (queue, _, mut inlet) = inlet(8 * ITEM, None);
        inlet.push(&mut frames(0..4));
        let mut items = Vec::new();
        // Comes back at once; in an hour otherwise.
        queue.take(&mut items, usize::MAX, Duration::from_secs(3600));
        assert_eq!(items.len(), 4);
    }

    #[test]
    fn gaps_cannot_fill_the_memory_and_none_is_forgotten() {
        let (queue, tally, mut inlet) = inlet(2 * ITEM, None);
        inlet.push(&mut frames(0..2));
        for t in 2..1_000 {
            inlet.gap(GapReason::KernelQueue, 3, Timestamp(t), Timestamp(t + 1));
        }
        assert_eq!(queue.fill(), 2 * ITEM);
        assert_eq!(take(&queue), frames(0..2));
        drop(inlet);
        let rest = take(&queue);
        assert_eq!(rest[0].value, gap(998 * 3, GapReason::KernelQueue, 2, 1_000));
        assert_eq!(tally.totals().lost(), 998 * 3);
    }

    #[test]
    fn no_more_frames_are_taken_than_were_asked_for() {
        let (queue, tally, mut inlet) = inlet(1 << 20, Some(3));
        inlet.push(&mut frames(0..2));
        inlet.push(&mut frames(2..9));
        assert!(inlet.satisfied());
        assert_eq!(take(&queue), frames(0..3));
        assert_eq!(tally.totals().received, 3);
    }
}
