//! A hybrid solar power station: panels on a tracker, a 24 V battery, two inverters, mains,
//! generator, and the controller that decides between them.
//!
//! Nothing here knows of a bus. The state advances in steps of one second of station time, however
//! the calls to [`Station::advance`] are cut, so that one seed always lives the same life.

pub mod charger;
pub mod generator;
pub mod inverter;
mod life;
pub mod loads;
pub mod monitor;
pub mod solar;
pub mod sun;
pub mod tracker;
pub mod transfer;
pub mod weather;

use super::battery::Battery;
use super::mains::Mains;
use super::random::Random;
use charger::Charger;
use generator::{Delays, Generator};
use inverter::{Inverter, Kind};
use loads::Loads;
use monitor::Monitor;
use solar::Solar;
use sun::{Position, Site};
use tracker::Tracker;
use transfer::Transfer;
use weather::Weather;

/// Where the station stands: near Rostov-on-Don.
pub const SITE: Site = Site { latitude: 47.235_7, longitude: 39.701_5, timezone: 3.0 };
/// Every life of the station begins on this morning.
pub const START: jiff::civil::DateTime = jiff::civil::datetime(2024, 4, 15, 6, 0, 0, 0);

const TS_1000: Kind = Kind {
    rated: 1000.0,
    own: (11.0, 4.0),
    events: [Event::Small(0), Event::Small(1), Event::Small(2), Event::Small(3)],
};
const TS_3000: Kind = Kind {
    rated: 3000.0,
    own: (19.0, 6.0),
    events: [Event::Large(0), Event::Large(1), Event::Large(2), Event::Large(3)],
};

/// Something happened that the controller reports at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Event {
    LoadOnMains,
    LoadOnInverters,
    MainsRestored,
    MainsLost,
    BatteryLowMains,
    BatteryLowGeneratorStarts,
    ChargingFromMains,
    ChargingFromGenerator,
    ChargeOn,
    ChargeOff,
    ChargeFinished,
    PanelsConnected,
    PanelsDisconnected,
    ActuatorsOn,
    ActuatorsOff,
    /// The generator's state changed.
    Generator,
    /// The 1000 W inverter: 0 switching on, 1 on, 2 switching off, 3 off.
    Small(u8),
    /// The 3000 W inverter, numbered in the same way.
    Large(u8),
}

/// What a person can set.
#[derive(Clone, Copy, Debug)]
pub struct Orders {
    /// Delays of switching the inverters on and off, s.
    pub inverter_delays: (u16, u16),
    /// The generator's times.
    pub generator: Delays,
}

/// Where the energy went, Wh since the beginning, all on the 24 V side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ledger {
    /// From the panels.
    pub solar: f64,
    /// From the charger.
    pub charger: f64,
    /// Into the inverters.
    pub inverters: f64,
    /// Into the controllers.
    pub controllers: f64,
    /// Into the battery.
    pub charged: f64,
    /// Out of the battery.
    pub discharged: f64,
    /// On the 220 V side: to the loads, from the inverters.
    pub loads: f64,
}

/// The station.
#[derive(Clone, Debug)]
pub struct Station {
    seconds: u64,
    remainder: f64,
    orders: Orders,
    day: sun::Day,
    sun: Position,
    weather: Weather,
    mains: Mains,
    battery: Battery,
    solar: Solar,
    tracker: Tracker,
    loads: Loads,
    inverters: [Inverter; 2],
    charger: Charger,
    transfer: Transfer,
    generator: Generator,
    monitor: Monitor,
    ledger: Ledger,
    events: Vec<Event>,
}

impl Station {
    /// The station of one seed, on the morning of [`START`].
    pub fn new(seed: u64, orders: Orders) -> Self {
        let mut random = Random::new(seed, 0);
        let hour = f64::from(START.hour());
        let day = sun::day(SITE, f64::from(START.day_of_year()));
        let sun = day.position(SITE, hour);
        let weather = Weather::new(seed, hour);
        let ambient = weather.temperature();
        let battery = Battery::new(12, 340.0, random.between(0.55, 0.74), ambient + 5.0);
        let mains = Mains::new(seed, 16.0 * 3600.0, (1500.0, 10.0 * 3600.0));
        let room = ambient + 5.0;
        Self {
            seconds: 0,
            remainder: 0.0,
            orders,
            day,
            sun,
            solar: Solar::new(seed, ambient),
            tracker: Tracker::new(sun),
            loads: Loads::new(seed),
            inverters: [
                Inverter::new(seed, 0x1000, TS_1000, room),
                Inverter::new(seed, 0x3000, TS_3000, room),
            ],
            charger: Charger::default(),
            transfer: Transfer::new(mains.present()),
            generator: Generator::new(seed),
            monitor: Monitor::new(seed, &battery),
            ledger: Ledger::default(),
            events: Vec::new(),
            weather,
            mains,
            battery,
        }
    }

    /// What has happened since the last call, in order.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// What a person has set.
    pub fn orders_mut(&mut self) -> &mut Orders {
        &mut self.orders
    }

    /// Local date and time.
    pub fn date_time(&self) -> jiff::civil::DateTime {
        let passed = i64::try_from(self.seconds).unwrap_or(i64::MAX);
        START.saturating_add(jiff::SignedDuration::from_secs(passed))
    }

    fn seconds_of_day(&self) -> u64 {
        (u64::from(START.hour().unsigned_abs()) * 3600 + self.seconds) % 86_400
    }

    /// Local time of day, decimal hours, 0..24.
    pub fn hour(&self) -> f64 {
        self.seconds_of_day() as f64 / 3600.0
    }

    /// Where the sun stands.
    pub fn sun(&self) -> Position {
        self.sun
    }

    /// Sunrise and sunset of today.
    pub fn day(&self) -> sun::Day {
        self.day
    }

    /// Clouds and air.
    pub fn weather(&self) -> &Weather {
        &self.weather
    }

    /// The public mains.
    pub fn mains(&self) -> &Mains {
        &self.mains
    }

    /// The 24 V battery.
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// Panels and their charge controller.
    pub fn solar(&self) -> &Solar {
        &self.solar
    }

    /// The tracker that turns the panels.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// What people have switched on.
    pub fn loads(&self) -> &Loads {
        &self.loads
    }

    /// The inverters: 1000 W, 3000 W.
    pub fn inverters(&self) -> &[Inverter; 2] {
        &self.inverters
    }

    /// The charger from 220 V.
    pub fn charger(&self) -> &Charger {
        &self.charger
    }

    /// The transfer switch.
    pub fn transfer(&self) -> &Transfer {
        &self.transfer
    }

    /// The generator.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }

    /// The battery monitor.
    pub fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    /// Where the energy went.
    pub fn ledger(&self) -> Ledger {
        self.ledger
    }
}

#[cfg(test)]
mod tests;
