//! One second in the life of the station: what is switched on, what flows, where it goes.

use super::inverter::Inverter;
use super::loads::Line;
use super::transfer::{Situation, Supply};
use super::{Event, SITE, Station, sun};
use crate::simulate::STEP_SECONDS;

/// What the controllers draw from the battery, A.
const CONTROLLERS: f64 = 0.9;
/// The sun is looked up this often, seconds: it moves by a 25th of a degree.
const SUN_SECONDS: u64 = 10;

impl Station {
    /// Lets `seconds` of station time pass.
    pub fn advance(&mut self, seconds: f64) {
        self.remainder += seconds.max(0.0);
        while self.remainder >= STEP_SECONDS {
            self.remainder -= STEP_SECONDS;
            self.step();
        }
    }

    fn step(&mut self) {
        self.seconds += 1;
        let hour = self.hour();
        if self.seconds.is_multiple_of(SUN_SECONDS) {
            self.look_at_the_sun(hour);
        }
        self.weather.step(hour);
        self.mains.step();
        self.decide(hour);
        self.flow();
        self.tracker.step(self.sun, &mut self.events);
        self.monitor.step(&self.battery);
    }

    fn look_at_the_sun(&mut self, hour: f64) {
        if self.seconds_of_day() < SUN_SECONDS {
            self.day = sun::day(SITE, f64::from(self.date_time().day_of_year()));
            self.solar.new_day();
        }
        self.sun = self.day.position(SITE, hour);
    }

    /// What is switched on.
    fn decide(&mut self, hour: f64) {
        let mains = self.mains.present();
        let soc = self.battery.soc();
        self.generator.step(soc, mains, &self.orders.generator, &mut self.events);
        let situation = Situation {
            soc,
            mains,
            generator: self.generator.running(),
            inverters: self.inverters.iter().all(Inverter::ready),
            delays: self.orders.inverter_delays,
        };
        self.transfer.step(&situation, &mut self.events);
        self.loads.step(hour, self.transfer.supply() != Supply::Unknown);
        let feeds = self.transfer.supply() == Supply::Inverters;
        let (wanted, room) = (self.transfer.wants_inverters(), self.room());
        for (inverter, line) in self.inverters.iter_mut().zip([Line::Small, Line::Large]) {
            let watts = if feeds { self.loads.watts(line) } else { 0.0 };
            inverter.step(wanted, watts, room, &mut self.events);
        }
    }

    /// What flows on the 24 V side, and what it does to the battery.
    fn flow(&mut self) {
        let volts = self.battery.voltage().max(15.0);
        let inverters: f64 = self.inverters.iter().map(|i| i.dc_power() / volts).sum();
        let demand = inverters + CONTROLLERS;
        let panels = self.solar.connected();
        let (light, aim) = (self.weather.light(self.sun.elevation), self.tracker.aim(self.sun));
        self.solar.step(light, aim, self.weather.temperature(), demand, &self.battery);
        if self.solar.connected() != panels {
            let event = if panels { Event::PanelsDisconnected } else { Event::PanelsConnected };
            self.events.push(event);
        }
        let sources = (self.mains.present(), self.generator.running());
        let missing = demand - self.solar.current();
        let low = self.transfer.battery_low();
        self.charger.step(sources, low, missing, &self.battery, &mut self.events);
        let current = self.solar.current() + self.charger.current() - demand;
        self.battery.step(current, self.room());
        self.book(volts, inverters);
    }

    fn book(&mut self, volts: f64, inverters: f64) {
        let watt_hours = volts * STEP_SECONDS / 3600.0;
        let ledger = &mut self.ledger;
        ledger.solar += self.solar.current() * watt_hours;
        ledger.charger += self.charger.current() * watt_hours;
        ledger.inverters += inverters * watt_hours;
        ledger.controllers += CONTROLLERS * watt_hours;
        ledger.charged += self.battery.current().max(0.0) * watt_hours;
        ledger.discharged -= self.battery.current().min(0.0) * watt_hours;
        let loads: f64 = self.inverters.iter().map(Inverter::watts).sum();
        ledger.loads += loads * STEP_SECONDS / 3600.0;
    }

    /// The hut is a little warmer than the air.
    fn room(&self) -> f64 {
        self.weather.temperature() + 5.0
    }
}
