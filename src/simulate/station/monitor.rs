//! The battery monitor: what it shows, and what it remembers.

use crate::simulate::STEP_SECONDS;
use crate::simulate::battery::Battery;
use crate::simulate::random::{Drift, Lag, Random};

/// A battery is called full above this state of charge.
const FULL: f64 = 0.97;
/// The alarm relay closes below this voltage, V, and opens above that.
const LOW_VOLTAGE: (f64, f64) = (22.6, 23.6);

/// A battery monitor with its history (registers H1 to H11 of its kind).
#[derive(Clone, Debug)]
pub struct Monitor {
    random: Random,
    noise: Drift,
    voltage: Lag,
    current: Lag,
    /// Current over the last minutes, for the time to go.
    average: Lag,
    alarm: bool,
    full: bool,
    /// Ah taken out since the battery was last full.
    depth: f64,
    /// What the monitor remembers.
    pub history: History,
}

/// What the monitor has seen in its life.
#[derive(Clone, Copy, Debug)]
pub struct History {
    /// H1: deepest discharge, Ah, negative.
    pub deepest: f64,
    /// H2: last discharge, Ah, negative.
    pub last: f64,
    /// H3: average discharge, Ah, negative.
    pub average: f64,
    /// H4: number of charge cycles.
    pub cycles: u16,
    /// H5: number of full discharges.
    pub full_discharges: u16,
    /// H6: Ah drawn in all, negative.
    pub drawn: f64,
    /// H7: lowest battery voltage, V.
    pub lowest: f64,
    /// H8: highest battery voltage, V.
    pub highest: f64,
    /// H9: seconds since the last full charge.
    pub since_full: f64,
    /// H11: number of low-voltage alarms.
    pub low_alarms: u16,
}

impl Monitor {
    /// The monitor of a battery that has served for a year.
    pub fn new(seed: u64, battery: &Battery) -> Self {
        let mut random = Random::new(seed, 0xB43);
        let depth = (1.0 - battery.soc()) * battery.capacity();
        Self {
            noise: Drift::new(0.05, 4.0, &mut random),
            random,
            voltage: Lag::new(battery.voltage(), 2.0),
            current: Lag::new(0.0, 1.5),
            average: Lag::new(0.0, 180.0),
            alarm: false,
            full: false,
            depth,
            history: History {
                deepest: -291.4,
                last: -depth,
                average: -148.2,
                cycles: 187,
                full_discharges: 2,
                drawn: -28_412.0,
                lowest: 21.42,
                highest: 29.12,
                since_full: 1.3 * 86_400.0,
                low_alarms: 6,
            },
        }
    }

    /// One step.
    pub fn step(&mut self, battery: &Battery) {
        let (volts, amperes) = (battery.voltage(), battery.current());
        self.voltage.step(volts);
        self.current.step(amperes + self.noise.step(&mut self.random));
        self.average.step(amperes);
        self.remember(volts, amperes, battery);
        let low = volts < if self.alarm { LOW_VOLTAGE.1 } else { LOW_VOLTAGE.0 };
        self.history.low_alarms += u16::from(low && !self.alarm);
        self.alarm = low;
    }

    fn remember(&mut self, volts: f64, amperes: f64, battery: &Battery) {
        let history = &mut self.history;
        history.lowest = history.lowest.min(volts);
        history.highest = history.highest.max(volts);
        history.since_full += STEP_SECONDS;
        history.drawn += amperes.min(0.0) * STEP_SECONDS / 3600.0;
        self.depth = self.depth.max((1.0 - battery.soc()) * battery.capacity());
        let full = battery.soc() > if self.full { FULL - 0.05 } else { FULL };
        if full {
            history.since_full = 0.0;
        }
        if full && !self.full {
            history.cycles += 1;
            history.average += (-self.depth - history.average) / f64::from(history.cycles);
        } else if self.full && !full {
            self.depth = 0.0;
        }
        if !full {
            history.last = -self.depth;
            history.deepest = history.deepest.min(-self.depth);
        }
        self.full = full;
    }

    /// Battery voltage as shown, V, to 10 mV.
    pub fn voltage(&self) -> f64 {
        (self.voltage.value() * 100.0).round() / 100.0
    }

    /// Battery current as shown, A, to 0.1 A: plus charges.
    pub fn current(&self) -> f64 {
        (self.current.value() * 10.0).round() / 10.0
    }

    /// State of charge as shown, percent, to 0.1.
    pub fn soc(&self, battery: &Battery) -> f64 {
        (battery.soc() * 1000.0).round() / 10.0
    }

    /// Time until the battery is empty, minutes; 0 when it is not being discharged.
    pub fn minutes_to_go(&self, battery: &Battery) -> f64 {
        let drawn = -self.average.value();
        if drawn < 0.5 { 0.0 } else { battery.soc() * battery.capacity() / drawn * 60.0 }
    }

    /// True while the battery voltage is too low.
    pub fn alarm(&self) -> bool {
        self.alarm
    }
}
