//! The 48 V plant: six rectifiers on three-phase mains, a battery of 24 cells, a radio site as the
//! load.

use super::alarm::{Alarm, Alarms};
use super::rectifier::Rectifier;
use crate::simulate::STEP_SECONDS;
use crate::simulate::battery::Battery;
use crate::simulate::mains::Mains;
use crate::simulate::random::{Drift, Lag, Random};

/// Rectifiers that are plugged in, at the positions from 0 on.
pub const RECTIFIERS: usize = 6;
/// Positions the monitor knows of (Zhongheng 09-series RS232 protocol, section 8, 0x40e2).
pub const POSITIONS: usize = 40;
/// Rated current of one rectifier, A.
pub(super) const RATED: f64 = 50.0;
pub(super) const CELLS: u8 = 24;
/// Battery capacity, Ah, and the share of it that may flow in as A.
const CAPACITY: f64 = 400.0;
const CURRENT_LIMIT: f64 = 0.1 * CAPACITY;
/// Float voltage the plant starts with, V.
const FLOAT: f64 = 53.5;
/// A battery discharged below this state of charge is equalized with so many volts more, until it
/// takes less than this current, A.
const EQUALIZE_BELOW: f64 = 0.93;
pub(super) const EQUALIZE_OFFSET: f64 = 2.9;
const EQUALIZE_UNTIL: f64 = 0.02 * CAPACITY;
/// Rectifiers wait this long after the mains are back, s, and then take this long to full power.
const START_DELAY: f64 = 10.0;
const START_RAMP: f64 = 45.0;
const BEGIN_HOUR: f64 = 6.0;

/// A battery that has been kept at its float voltage for hours.
fn floating_battery() -> Battery {
    let mut battery = Battery::new(CELLS, CAPACITY, 0.985, 23.0);
    for _ in 0..4 * 3600 {
        let current = battery.current_at(battery.compensated(FLOAT)).clamp(0.0, 5.0);
        battery.step(current, 22.0);
    }
    battery
}

/// The plant.
#[derive(Clone, Debug)]
pub struct Plant {
    pub(super) random: Random,
    pub(super) seconds: u64,
    pub(super) remainder: f64,
    pub(super) mains: Mains,
    pub(super) battery: Battery,
    pub(super) rectifiers: Vec<Rectifier>,
    pub(super) cells: [f64; CELLS as usize],
    /// Power of the load, W: traffic over the day, and what it does within minutes.
    pub(super) traffic: Drift,
    pub(super) flutter: Drift,
    pub(super) load_current: f64,
    pub(super) rectifier_current: f64,
    pub(super) average_power: Lag,
    pub(super) room: Lag,
    pub(super) float_voltage: f64,
    /// Seconds since the mains came back.
    pub(super) since_mains: f64,
    /// Seconds to the next visitor (or, while positive in `visit`, to his leaving).
    pub(super) visitor: f64,
    pub(super) visit: f64,
    pub(super) limiting: bool,
    pub(super) equalizing: bool,
    pub(super) alarms: Alarms,
}

impl Plant {
    /// The plant of one seed, at six in the morning.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, 0x48);
        let rectifiers = (0..RECTIFIERS)
            .map(|_| Rectifier {
                serial: 21_090_000 + random.index(9_999) as u32,
                share: Drift::new(0.012, 900.0, &mut random),
                current: 0.0,
                temperature: Lag::new(38.0, 700.0),
                on: true,
                mains: true,
                broken: 0.0,
                run_seconds: random.between(2.0e7, 4.0e7).floor(),
            })
            .collect();
        let mut plant = Self {
            seconds: 0,
            remainder: 0.0,
            mains: Mains::new(seed ^ 0x48, 12.0 * 3600.0, (600.0, 5400.0)),
            battery: floating_battery(),
            rectifiers,
            cells: std::array::from_fn(|_| random.between(-0.012, 0.012)),
            traffic: Drift::new(170.0, 2400.0, &mut random),
            flutter: Drift::new(25.0, 12.0, &mut random),
            load_current: 0.0,
            rectifier_current: 0.0,
            average_power: Lag::new(4400.0, 600.0),
            room: Lag::new(22.0, 1800.0),
            float_voltage: FLOAT,
            since_mains: 1.0e6,
            visitor: random.wait(14.0 * 3600.0),
            visit: 0.0,
            limiting: false,
            equalizing: false,
            alarms: Alarms::default(),
            random,
        };
        plant.step();
        plant
    }

    /// Lets `seconds` of plant time pass.
    pub fn advance(&mut self, seconds: f64) {
        self.remainder += seconds.max(0.0);
        while self.remainder >= STEP_SECONDS {
            self.remainder -= STEP_SECONDS;
            self.step();
        }
    }

    fn step(&mut self) {
        self.seconds += 1;
        self.mains.step();
        let present = self.mains.present();
        self.since_mains = if present { self.since_mains + STEP_SECONDS } else { 0.0 };
        let hour = self.hour();
        self.room.step(23.0 + 2.5 * ((hour - 15.0) / 24.0 * std::f64::consts::TAU).cos());
        self.wear();
        self.share_the_load(hour);
        self.welcome_visitors();
        self.watch();
    }

    /// Fans break now and then, and somebody changes them.
    fn wear(&mut self) {
        for rectifier in &mut self.rectifiers {
            rectifier.broken = (rectifier.broken - STEP_SECONDS).max(0.0);
        }
        if self.random.chance(STEP_SECONDS / (36.0 * 3600.0)) {
            let index = self.random.index(RECTIFIERS);
            self.rectifiers[index].broken = self.random.between(1800.0, 9000.0);
        }
    }

    fn share_the_load(&mut self, hour: f64) {
        // Few calls before dawn, most in the evening.
        let day = 0.5 - 0.5 * ((hour - 3.5) / 24.0 * std::f64::consts::TAU).cos();
        let evening = (-((hour - 20.0) / 2.2).powi(2)).exp();
        let noise = self.traffic.step(&mut self.random) + self.flutter.step(&mut self.random);
        let power = 3500.0 + 1100.0 * day + 700.0 * evening + noise;
        self.load_current = power / self.battery.voltage().max(40.0);
        let started = ((self.since_mains - START_DELAY) / START_RAMP).clamp(0.0, 1.0);
        let ready: Vec<usize> = (0..RECTIFIERS).filter(|i| self.ready(*i)).collect();
        let possible = started * RATED * ready.len() as f64;
        self.equalizing = if self.equalizing {
            !self.mains.present() || self.battery.current() > EQUALIZE_UNTIL || started < 1.0
        } else {
            self.battery.soc() < EQUALIZE_BELOW
        };
        let charging = self.battery.current_at(self.target_voltage());
        self.limiting = charging > CURRENT_LIMIT && possible > 0.0;
        let wanted = self.load_current + charging.min(CURRENT_LIMIT);
        self.rectifier_current = wanted.clamp(0.0, possible);
        let battery = self.rectifier_current - self.load_current;
        self.battery.step(battery, self.room.value());
        self.average_power.step(self.rectifier_power());
        self.load_rectifiers(&ready);
    }

    fn ready(&self, index: usize) -> bool {
        let started = self.since_mains > START_DELAY;
        started && self.rectifiers.get(index).is_some_and(|r| r.broken <= 0.0)
    }

    fn load_rectifiers(&mut self, ready: &[usize]) {
        let (present, room) = (self.mains.present(), self.room.value());
        let fair = self.rectifier_current / ready.len().max(1) as f64;
        for (index, rectifier) in self.rectifiers.iter_mut().enumerate() {
            let more = rectifier.share.step(&mut self.random);
            rectifier.mains = present;
            rectifier.on = ready.contains(&index);
            rectifier.current = if rectifier.on { fair * (1.0 + more) } else { 0.0 };
            rectifier.run_seconds += if rectifier.on { STEP_SECONDS } else { 0.0 };
            rectifier.temperature.step(room + 6.0 + 0.62 * rectifier.current);
        }
    }

    /// Somebody opens the cabinet twice a day or so.
    fn welcome_visitors(&mut self) {
        self.visit = (self.visit - STEP_SECONDS).max(0.0);
        self.visitor -= STEP_SECONDS;
        if self.visitor <= 0.0 {
            self.visit = self.random.between(600.0, 2700.0);
            self.visitor = self.visit + self.random.wait(14.0 * 3600.0);
        }
    }

    fn watch(&mut self) {
        let volts = self.mains.voltage(0, self.hour());
        let present = self.mains.present();
        let (battery, alarms) = (&self.battery, &mut self.alarms);
        alarms.set(Alarm::AcFail, !present);
        alarms.set(Alarm::AcHigh, volts > 242.0);
        alarms.set(Alarm::AcLow, present && volts < 187.0);
        alarms.set(Alarm::Equalize, self.equalizing && present);
        alarms.set(Alarm::InDischarge, battery.current() < -2.0);
        alarms.set(Alarm::LowFloat, battery.voltage() < 46.5);
        alarms.set(Alarm::BatteryCurrentLimit, self.limiting);
        alarms.set(Alarm::BatteryTemperatureHigh, battery.temperature() > 40.0);
        alarms.set(Alarm::RectifierFail, self.rectifiers.iter().any(|r| r.broken > 0.0));
        alarms.set(Alarm::DigitalInput1, self.visit > 0.0);
    }

    /// Local time of day, decimal hours, 0..24.
    pub(super) fn hour(&self) -> f64 {
        (BEGIN_HOUR + self.seconds as f64 / 3600.0).rem_euclid(24.0)
    }
}
