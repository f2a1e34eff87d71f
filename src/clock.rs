//! Time: one steady timeline for everything that is recorded.
//!
//! The kernel stamps CAN frames with the wall clock, which a person, NTP or a GPS receiver may set
//! at any moment. [`Timeline`] turns such stamps into times on a line that starts at the wall clock
//! and then only follows the steady clock. As long as nobody steps the wall clock the two are equal
//! to the nanosecond; after a step the difference is kept as a correction and reported once.

use std::sync::{Arc, Mutex, PoisonError};

use crate::frame::Timestamp;

/// A wall clock change smaller than this is taken for measuring noise, not for a step.
///
/// Both clocks are slewed alike by NTP, so between steps their difference only shows the time
/// that passes between reading one and the other.
const STEP_NANOS: u64 = 500_000;

/// Both clocks, read together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// Wall clock, nanoseconds since 1970 (UTC).
    pub wall: u64,
    /// Steady clock, nanoseconds since some fixed moment (boot), running on in suspend.
    pub steady: u64,
}

/// Where time comes from: the machine, or a test's hand.
pub trait Clock: Send + Sync {
    /// Both clocks, read as close together as possible.
    fn read(&self) -> Reading;
}

/// A wall clock step that was noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// When, on the timeline.
    pub time: Timestamp,
    /// The clocks after the step.
    pub reading: Reading,
    /// By how much the wall clock jumped, nanoseconds, positive when forward.
    pub nanos: i64,
}

/// The recording's timeline. Cheap to clone; all clones share one state.
#[derive(Clone)]
pub struct Timeline {
    clock: Arc<dyn Clock>,
    state: Arc<Mutex<State>>,
}

/// Wall minus steady, in nanoseconds. Negative only on machines whose clock is before 1970.
type Offset = i128;

#[derive(Clone, Copy)]
struct Offsets {
    /// The offset the timeline keeps: the one at its start.
    base: Offset,
    current: Offset,
    /// The offset before the latest step, for stamps taken before it but read after it.
    previous: Offset,
}

struct State {
    offsets: Offsets,
    steps: Vec<Step>,
}

impl Timeline {
    /// A timeline that starts now.
    pub fn start(clock: Arc<dyn Clock>) -> Self {
        let base = offset(clock.read());
        let offsets = Offsets { base, current: base, previous: base };
        let state = Mutex::new(State { offsets, steps: Vec::new() });
        Self { clock, state: Arc::new(state) }
    }

    /// The time now. Also notices steps of the wall clock.
    pub fn now(&self) -> Timestamp {
        self.read().0
    }

    /// The time now, and both clocks as they were read for it.
    pub fn read(&self) -> (Timestamp, Reading) {
        let reading = self.clock.read();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let time = place(i128::from(reading.steady) + state.offsets.base);
        let nanos = offset(reading) - state.offsets.current;
        if nanos.unsigned_abs() > u128::from(STEP_NANOS) {
            state.offsets.previous = state.offsets.current;
            state.offsets.current = offset(reading);
            let nanos = i64::try_from(nanos).unwrap_or(if nanos > 0 { i64::MAX } else { i64::MIN });
            state.steps.push(Step { time, reading, nanos });
        }
        (time, reading)
    }

    /// The steps noticed since the last call.
    pub fn take_steps(&self) -> Vec<Step> {
        std::mem::take(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner).steps)
    }

    /// A stamper for one source of wall clock stamps.
    pub fn stamper(&self) -> Stamper {
        let offsets = self.state.lock().unwrap_or_else(PoisonError::into_inner).offsets;
        let start = Timestamp(0);
        Stamper { timeline: self.clone(), offsets, last: start, floor: start, now: start }
    }
}

/// Turns the kernel's wall clock stamps of one source into times that never go back.
pub struct Stamper {
    timeline: Timeline,
    /// As they were at the read, so that stamping many frames takes no lock.
    offsets: Offsets,
    /// The latest time given out.
    last: Timestamp,
    /// The moment of the read before this one: what is read now came after it.
    floor: Timestamp,
    now: Timestamp,
}

impl Stamper {
    /// Call once after each read, before stamping what it returned.
    pub fn begin_read(&mut self) -> Timestamp {
        self.floor = self.now;
        self.now = self.timeline.now();
        self.offsets = self.timeline.state.lock().unwrap_or_else(PoisonError::into_inner).offsets;
        self.now
    }

    /// The time of something the kernel stamped with `wall` nanoseconds.
    pub fn stamp(&mut self, wall: u64) -> Timestamp {
        let Offsets { base, current, previous } = self.offsets;
        let after = place(i128::from(wall) - current + base);
        let mut time = after;
        if previous != current && !self.plausible(after) {
            let before = place(i128::from(wall) - previous + base);
            time = if self.plausible(before) { before } else { self.now };
        }
        self.last = self.last.max(time);
        self.last
    }

    /// What was read just now cannot have come after now, nor before the read before it. One
    /// step's worth of tolerance covers the stamp and the clock being taken at different moments.
    fn plausible(&self, time: Timestamp) -> bool {
        time <= self.now.plus(STEP_NANOS) && time.plus(STEP_NANOS) >= self.floor
    }
}

fn offset(reading: Reading) -> Offset {
    i128::from(reading.wall) - i128::from(reading.steady)
}

fn place(nanos: i128) -> Timestamp {
    // Time 0 means "unknown" to MCAP readers, so no frame may carry it.
    Timestamp(u64::try_from(nanos.max(1)).unwrap_or(u64::MAX))
}

/// A clock that moves only when told to. Ships with the library for tests of code that uses it.
#[derive(Clone)]
pub struct ManualClock(Arc<Mutex<Reading>>);

impl ManualClock {
    /// A clock that stands at `reading`.
    pub fn new(reading: Reading) -> Self {
        Self(Arc::new(Mutex::new(reading)))
    }

    /// Lets `nanos` pass on both clocks.
    pub fn advance(&self, nanos: u64) {
        let mut reading = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        reading.wall += nanos;
        reading.steady += nanos;
    }

    /// Sets the wall clock `nanos` forward (or back), as a person or NTP does.
    pub fn step(&self, nanos: i64) {
        let mut reading = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        reading.wall = reading.wall.saturating_add_signed(nanos);
    }
}

impl Clock for ManualClock {
    fn read(&self) -> Reading {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn clock_at_noon() -> ManualClock {
        ManualClock::new(Reading { wall: 1_700_000_000 * SECOND, steady: 42 * SECOND })
    }

    #[test]
    fn without_a_step_stamps_stay_as_the_kernel_gave_them() {
        let clock = clock_at_noon();
        let timeline = Timeline::start(Arc::new(clock.clone()));
        let mut stamper = timeline.stamper();
        clock.advance(SECOND);
        let kernel = clock.read().wall - 123;
        stamper.begin_read();
        assert_eq!(stamper.stamp(kernel), Timestamp(kernel));
        assert_eq!(timeline.take_steps(), []);
    }

    #[test]
    fn a_step_bends_no_interval_and_is_reported_once() {
        for step in [3_600 * SECOND as i64, -3_600 * SECOND as i64, 10_000_000, -10_000_000] {
            let clock = clock_at_noon();
            let timeline = Timeline::start(Arc::new(clock.clone()));
            let mut stamper = timeline.stamper();
            let mut times = Vec::new();
            for frame in 0..10 {
                clock.advance(SECOND / 10);
                if frame == 5 {
                    clock.step(step);
                }
                let kernel = clock.read().wall;
                stamper.begin_read();
                times.push(stamper.stamp(kernel).nanos());
            }
            assert!(times.windows(2).all(|pair| pair[1] - pair[0] == SECOND / 10), "{times:?}");
            let steps = timeline.take_steps();
            assert_eq!(steps.iter().map(|s| s.nanos).collect::<Vec<_>>(), [step]);
        }
    }

    #[test]
    fn frames_stamped_before_a_step_but_read_after_it_keep_their_place() {
        let clock = clock_at_noon();
        let timeline = Timeline::start(Arc::new(clock.clone()));
        let mut stamper = timeline.stamper();
        stamper.begin_read();
        let start = clock.read().wall;
        let before = start + SECOND / 100;
        clock.advance(SECOND / 10);
        clock.step(-3_600 * SECOND as i64);
        let after = clock.read().wall;
        clock.advance(SECOND / 100);
        stamper.begin_read();
        assert_eq!(stamper.stamp(before).nanos(), before);
        assert_eq!(stamper.stamp(after).nanos(), start + SECOND / 10);
    }
}
