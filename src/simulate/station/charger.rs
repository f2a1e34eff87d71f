//! The charger from 220 V: charges from mains or generator while the battery is low.

use super::Event;
use crate::simulate::STEP_SECONDS;
use crate::simulate::battery::Battery;

/// Largest current, A: 1000 W at 28 V.
const CURRENT_LIMIT: f64 = 35.0;
/// Charging voltage at 25 °C, V.
const VOLTAGE: f64 = 28.2;

/// The charger.
#[derive(Clone, Debug, Default)]
pub struct Charger {
    on: bool,
    powered: bool,
    ended: bool,
    current: f64,
    /// Seconds since it was switched on: the current rises over the first ones.
    running: f64,
}

impl Charger {
    /// One step: `mains` and `generator` there or not; `wanted` while the battery is low; `demand`
    /// is the current (A) drawn beside the battery and not yet given by the sun.
    pub fn step(
        &mut self,
        (mains, generator): (bool, bool),
        wanted: bool,
        demand: f64,
        battery: &Battery,
        events: &mut Vec<Event>,
    ) {
        self.powered = mains || generator;
        let on = wanted && self.powered;
        if on && !self.on {
            self.ended = false;
            self.running = 0.0;
            events.push(if mains {
                Event::ChargingFromMains
            } else {
                Event::ChargingFromGenerator
            });
            events.push(Event::ChargeOn);
        } else if self.on && !on {
            // The battery is well again, or the power is gone.
            self.ended = self.powered;
            events.push(if self.powered { Event::ChargeFinished } else { Event::ChargeOff });
        }
        self.on = on;
        self.running += STEP_SECONDS;
        let ramp = (self.running / 20.0).min(1.0) * CURRENT_LIMIT;
        let taken = battery.current_at(battery.compensated(VOLTAGE)) + demand;
        self.current = if on { taken.clamp(0.0, ramp) } else { 0.0 };
    }

    /// True while charging is switched on.
    pub fn on(&self) -> bool {
        self.on
    }

    /// True while there is 220 V at its input.
    pub fn powered(&self) -> bool {
        self.powered
    }

    /// True when the last charge has come to its end.
    pub fn ended(&self) -> bool {
        self.ended
    }

    /// Current, A.
    pub fn current(&self) -> f64 {
        self.current
    }
}
