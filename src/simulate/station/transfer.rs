//! The automatic transfer switch: what feeds the loads, and after which delay it changes.
//!
//! Mixed mode: the inverters feed while the battery is well; a low battery hands the loads over to
//! the mains, or without mains to the generator, until it is charged again.

use super::Event;
use crate::simulate::STEP_SECONDS;

/// The battery is low below this state of charge, and well again above that.
const LOW: (f64, f64) = (0.52, 0.76);
/// Below this nothing may draw from the battery any more, until it is charged to that.
const EMPTY: (f64, f64) = (0.15, 0.22);
/// Moving the contacts to mains or generator takes this long, s.
const CONTACTS: f64 = 4.0;

/// What feeds the loads, numbered as on the bus (HMI CAN protocol, section 4.1, ALT_1 `power`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supply {
    /// Nothing, or not known.
    Unknown = 0,
    /// The public mains.
    Mains = 1,
    /// The generator.
    Generator = 2,
    /// The inverters.
    Inverters = 3,
}

/// What the switch decides from.
#[derive(Clone, Copy, Debug)]
pub struct Situation {
    /// State of charge, 0..=1.
    pub soc: f64,
    /// Mains present.
    pub mains: bool,
    /// Generator running.
    pub generator: bool,
    /// Both inverters on.
    pub inverters: bool,
    /// Settings: delays of switching the inverters on and off, s.
    pub delays: (u16, u16),
}

/// The switch.
#[derive(Clone, Debug)]
pub struct Transfer {
    supply: Supply,
    low: bool,
    empty: bool,
    mains: bool,
    /// What it is about to change to, and the seconds until then.
    pending: Option<(Supply, f64)>,
    /// Seconds that the inverters stay on after the loads have left them.
    lingering: f64,
}

impl Transfer {
    /// A switch with the loads on the inverters, as in a good morning.
    pub fn new(mains: bool) -> Self {
        let (supply, low, empty) = (Supply::Inverters, false, false);
        Self { supply, low, empty, mains, pending: None, lingering: 0.0 }
    }

    /// One step.
    pub fn step(&mut self, now: &Situation, events: &mut Vec<Event>) {
        if now.mains != self.mains {
            self.mains = now.mains;
            events.push(if now.mains { Event::MainsRestored } else { Event::MainsLost });
        }
        let was_low = self.low;
        self.low = now.soc < if self.low { LOW.1 } else { LOW.0 };
        self.empty = now.soc < if self.empty { EMPTY.1 } else { EMPTY.0 };
        if self.low && !was_low && now.mains {
            events.push(Event::BatteryLowMains);
        }
        self.lingering = (self.lingering - STEP_SECONDS).max(0.0);
        self.drop_what_is_gone(now);
        self.change(self.wanted(now), now, events);
    }

    fn wanted(&self, now: &Situation) -> Supply {
        match (self.low, now.mains, now.generator) {
            (false, ..) => Supply::Inverters,
            (true, true, _) => Supply::Mains,
            (true, false, true) => Supply::Generator,
            (true, false, false) if self.empty => Supply::Unknown,
            (true, false, false) => Supply::Inverters,
        }
    }

    fn drop_what_is_gone(&mut self, now: &Situation) {
        let there = match self.supply {
            Supply::Mains => now.mains,
            Supply::Generator => now.generator,
            Supply::Inverters => now.inverters && !self.empty,
            Supply::Unknown => true,
        };
        if !there {
            self.supply = Supply::Unknown;
        }
    }

    fn change(&mut self, wanted: Supply, now: &Situation, events: &mut Vec<Event>) {
        if wanted == self.supply {
            self.pending = None;
            return;
        }
        let left = match self.pending {
            Some((target, left)) if target == wanted => left - STEP_SECONDS,
            _ if wanted == Supply::Inverters => f64::from(now.delays.0),
            _ => CONTACTS,
        };
        self.pending = Some((wanted, left.max(0.0)));
        if left > 0.0 || (wanted == Supply::Inverters && !now.inverters) {
            return;
        }
        if self.supply == Supply::Inverters {
            self.lingering = f64::from(now.delays.1);
        }
        self.supply = wanted;
        self.pending = None;
        match wanted {
            Supply::Mains | Supply::Generator => events.push(Event::LoadOnMains),
            Supply::Inverters => events.push(Event::LoadOnInverters),
            Supply::Unknown => {}
        }
    }

    /// What feeds the loads.
    pub fn supply(&self) -> Supply {
        self.supply
    }

    /// True while the battery is to be charged from mains or generator.
    pub fn battery_low(&self) -> bool {
        self.low
    }

    /// True while the inverters have to be on.
    pub fn wants_inverters(&self) -> bool {
        let coming = matches!(self.pending, Some((Supply::Inverters, _)));
        !self.empty && (self.supply == Supply::Inverters || coming || self.lingering > 0.0)
    }

    /// Seconds left until the inverters are switched on or off; 0 when nothing is pending.
    pub fn seconds_left(&self) -> f64 {
        match self.pending {
            Some((Supply::Inverters, left)) => left,
            _ => self.lingering,
        }
    }
}
