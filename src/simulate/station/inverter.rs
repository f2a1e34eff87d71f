//! An inverter from the 24 V battery to 220 V, with the contactor in front of it.

use super::Event;
use crate::simulate::STEP_SECONDS;
use crate::simulate::random::{Drift, Lag, Random};

/// Seconds each step of switching on or off takes: contactor, wait, software, check.
const CYCLE: [f64; 4] = [1.0, 3.0, 2.0, 2.0];
/// Below this the inverter only listens for a load, W, after this time, s.
const IDLE_WATTS: f64 = 10.0;
const IDLE_SECONDS: f64 = 120.0;

/// Mode, numbered as on the bus (HMI CAN protocol, section 9, INVMODE).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Switched off.
    Off = 1,
    /// Feeding.
    On = 2,
    /// On, but without a load worth the trouble.
    Standby = 3,
}

/// What tells this inverter's events from the other's.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Rated power, W.
    pub rated: f64,
    /// What it draws for itself, W, while on and in standby.
    pub own: (f64, f64),
    /// Events: switching on, on, switching off, off.
    pub events: [Event; 4],
}

/// One inverter.
#[derive(Clone, Debug)]
pub struct Inverter {
    random: Random,
    kind: Kind,
    on: bool,
    /// Step of the cycle that is running, from 0, and the seconds left in it.
    cycle: Option<(usize, f64)>,
    idle: f64,
    watts: f64,
    ac: Drift,
    reading: Lag,
    temperature: Lag,
}

impl Inverter {
    /// An inverter that is on, in a room of `ambient` °C.
    pub fn new(seed: u64, stream: u64, kind: Kind, ambient: f64) -> Self {
        let mut random = Random::new(seed, stream);
        Self {
            ac: Drift::new(0.9, 90.0, &mut random),
            random,
            kind,
            on: true,
            cycle: None,
            idle: 0.0,
            watts: 0.0,
            reading: Lag::new(0.0, 1.2),
            temperature: Lag::new(ambient + 6.0, 1100.0),
        }
    }

    /// One step; `wanted` on or off, feeding `watts`, in a room of `ambient` °C.
    pub fn step(&mut self, wanted: bool, watts: f64, ambient: f64, events: &mut Vec<Event>) {
        self.switch(wanted, events);
        self.watts = if self.on { watts } else { 0.0 };
        self.reading.step(self.watts);
        self.ac.step(&mut self.random);
        self.idle = if self.watts < IDLE_WATTS { self.idle + STEP_SECONDS } else { 0.0 };
        let losses = self.dc_power() - self.watts;
        self.temperature.step(ambient + 0.16 * losses * (1000.0 / self.kind.rated).sqrt());
    }

    fn switch(&mut self, wanted: bool, events: &mut Vec<Event>) {
        let [switching_on, on, switching_off, off] = self.kind.events;
        match self.cycle {
            None if wanted != self.on => {
                self.cycle = Some((0, CYCLE[0]));
                events.push(if wanted { switching_on } else { switching_off });
            }
            None => {}
            Some((step, left)) if left > STEP_SECONDS => {
                self.cycle = Some((step, left - STEP_SECONDS));
            }
            Some((step, _)) => {
                self.cycle = CYCLE.get(step + 1).map(|left| (step + 1, *left));
                if self.cycle.is_none() {
                    self.on = !self.on;
                    self.idle = 0.0;
                    events.push(if self.on { on } else { off });
                }
            }
        }
    }

    /// True while it can feed.
    pub fn ready(&self) -> bool {
        self.on
    }

    /// True while the battery contactor is closed: a step earlier than on, a step later than off.
    pub fn contactor(&self) -> bool {
        self.on || self.cycle.is_some_and(|(step, _)| step > 0)
    }

    /// Step of switching, 0 when idle, else 1..=4.
    pub fn cycle_step(&self) -> u8 {
        self.cycle.map_or(0, |(step, _)| step as u8 + 1)
    }

    /// Mode.
    pub fn mode(&self) -> Mode {
        match self.on {
            false => Mode::Off,
            true if self.idle > IDLE_SECONDS => Mode::Standby,
            true => Mode::On,
        }
    }

    /// Power taken from the battery, W.
    pub fn dc_power(&self) -> f64 {
        match self.mode() {
            Mode::Off => 0.0,
            Mode::Standby => self.kind.own.1,
            Mode::On => self.watts / 0.93 + self.kind.own.0,
        }
    }

    /// Power given, W.
    pub fn watts(&self) -> f64 {
        self.watts
    }

    /// Power given, as the inverter's slow meter shows it, W and percent of the rated power.
    pub fn reading(&self) -> (f64, f64) {
        (self.reading.value(), self.reading.value() / self.kind.rated * 100.0)
    }

    /// Output voltage, V; 0 when off.
    pub fn ac_voltage(&self) -> f64 {
        if !self.on {
            return 0.0;
        }
        221.5 + self.ac.value() - 4.0 * self.watts / self.kind.rated
    }

    /// Temperature, °C.
    pub fn temperature(&self) -> f64 {
        self.temperature.value()
    }
}
