//! The generator: starts by itself when the battery is low and the mains are gone.

use super::Event;
use crate::simulate::STEP_SECONDS;
use crate::simulate::random::Random;

/// Starts below this state of charge, stops above that.
const CHARGE: (f64, f64) = (0.49, 0.78);
/// Chance that an attempt succeeds: it is an old machine.
const START_CHANCE: f64 = 0.75;

/// Settings of the generator, seconds (HMI CAN protocol, section 5.4, CFG_GEN_*).
#[derive(Clone, Copy, Debug)]
pub struct Delays {
    /// After the mains are lost, before the start.
    pub start: u16,
    /// After the mains are back, before the stop.
    pub stop: u16,
    /// Longest run.
    pub run: u16,
    /// Rest after a run.
    pub sleep: u16,
    /// Attempts to start.
    pub attempts: u8,
}

/// What it does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Off.
    Off,
    /// Waiting whether the mains come back; seconds left.
    Waiting(f64),
    /// The starter turns or rests between attempts: attempt from 0, seconds left.
    Starting(u8, f64),
    /// Running: seconds so far, seconds left.
    Running(f64, f64),
    /// The mains are back, still running: seconds so far, seconds until the stop.
    Stopping(f64, f64),
    /// Resting after a full run, or after all attempts failed; seconds left.
    Resting(f64),
}

/// The generator and its automatic start.
#[derive(Clone, Debug)]
pub struct Generator {
    random: Random,
    stage: Stage,
    failed: bool,
}

impl Generator {
    /// A generator that is off.
    pub fn new(seed: u64) -> Self {
        Self { random: Random::new(seed, 0x6E4), stage: Stage::Off, failed: false }
    }

    /// One step: battery charged to `soc` (0..=1), `mains` present or not.
    pub fn step(&mut self, soc: f64, mains: bool, delays: &Delays, events: &mut Vec<Event>) {
        let before = self.stage;
        let step = STEP_SECONDS;
        let needed = !mains && soc < CHARGE.0;
        self.stage = match before {
            Stage::Off if needed => Stage::Waiting(f64::from(delays.start)),
            Stage::Off => Stage::Off,
            Stage::Waiting(_) if mains => Stage::Off,
            Stage::Waiting(left) if left > step => Stage::Waiting(left - step),
            Stage::Waiting(_) => Stage::Starting(0, 8.0),
            Stage::Starting(attempt, left) if left > step => Stage::Starting(attempt, left - step),
            Stage::Starting(attempt, _) => self.attempt(attempt, delays),
            Stage::Running(run, _) if mains => Stage::Stopping(run, f64::from(delays.stop)),
            Stage::Running(..) if soc > CHARGE.1 => Stage::Off,
            Stage::Running(run, left) if left > step => Stage::Running(run + step, left - step),
            Stage::Running(..) => Stage::Resting(f64::from(delays.sleep)),
            Stage::Stopping(run, left) if left > step => Stage::Stopping(run + step, left - step),
            Stage::Stopping(..) => Stage::Off,
            Stage::Resting(left) if left > step => Stage::Resting(left - step),
            Stage::Resting(_) => Stage::Off,
        };
        if matches!((before, self.stage), (Stage::Waiting(_), Stage::Starting(..))) {
            events.push(Event::BatteryLowGeneratorStarts);
        }
        if std::mem::discriminant(&before) != std::mem::discriminant(&self.stage) {
            events.push(Event::Generator);
        }
    }

    fn attempt(&mut self, attempt: u8, delays: &Delays) -> Stage {
        self.failed = !self.random.chance(START_CHANCE);
        match self.failed {
            false => Stage::Running(0.0, f64::from(delays.run)),
            true if attempt + 1 < delays.attempts => Stage::Starting(attempt + 1, 8.0),
            true => Stage::Resting(f64::from(delays.sleep)),
        }
    }

    /// What it does.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// True while it gives power.
    pub fn running(&self) -> bool {
        matches!(self.stage, Stage::Running(..) | Stage::Stopping(..))
    }

    /// True when the last start failed for good.
    pub fn start_failed(&self) -> bool {
        self.failed && !matches!(self.stage, Stage::Starting(..))
    }
}
