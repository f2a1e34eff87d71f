//! Panels and the MPPT charge controller between them and the battery.

use super::weather::Light;
use crate::simulate::STEP_SECONDS;
use crate::simulate::battery::Battery;
use crate::simulate::random::{Drift, Lag, Random};

/// Power of all panels under 1000 W/m² at 25 °C, W.
const PEAK_POWER: f64 = 1080.0;
/// Largest output current of the controller (SS-50C), A.
const CURRENT_LIMIT: f64 = 50.0;
/// Share of the panels' power that reaches the battery.
const EFFICIENCY: f64 = 0.965;
/// Charging voltages of the 24 V battery at 25 °C, V.
const ABSORPTION: f64 = 28.4;
const FLOAT: f64 = 27.2;
/// Absorption ends when the battery takes less than this, A, or after this time, s.
const TAIL_CURRENT: f64 = 8.0;
const ABSORPTION_SECONDS: f64 = 3.0 * 3600.0;

/// Charge mode, numbered as the controller does (HMI CAN protocol, section 9, MPPTMODE).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Night.
    Off = 0,
    /// Taking all the panels give.
    Tracking = 1,
    /// As much as the controller can.
    Fast = 2,
    /// Holding the absorption voltage.
    Saturation = 3,
    /// Holding the float voltage: the battery is full.
    Float = 4,
    /// Waking up in the morning.
    Start = 5,
}

/// The panels and their charge controller.
#[derive(Clone, Debug)]
pub struct Solar {
    random: Random,
    flicker: Drift,
    mode: Mode,
    panel_temperature: Lag,
    controller_temperature: Lag,
    /// Power that the panels could give, W.
    available: f64,
    /// Panel voltage, V.
    voltage: f64,
    /// Output current, A.
    current: f64,
    /// Output voltage, V.
    out_voltage: f64,
    /// Seconds in the present mode.
    in_mode: f64,
    float_seconds: f64,
    charge_seconds: f64,
    /// Output today, Wh and Ah.
    today: (f64, f64),
}

impl Solar {
    /// A controller waiting for the morning, in air of `ambient` °C.
    pub fn new(seed: u64, ambient: f64) -> Self {
        let mut random = Random::new(seed, 0x50A);
        Self {
            flicker: Drift::new(0.004, 20.0, &mut random),
            random,
            mode: Mode::Off,
            panel_temperature: Lag::new(ambient, 300.0),
            controller_temperature: Lag::new(ambient, 1200.0),
            available: 0.0,
            voltage: 0.0,
            current: 0.0,
            out_voltage: 0.0,
            in_mode: 0.0,
            float_seconds: 0.0,
            charge_seconds: 0.0,
            today: (0.0, 0.0),
        }
    }

    /// One step. `aim` is the share of the beam that the panels catch, `demand` the current (A)
    /// that the station draws beside the battery.
    pub fn step(&mut self, light: Light, aim: f64, ambient: f64, demand: f64, battery: &Battery) {
        let irradiance = light.beam * aim + light.diffuse;
        let cell = self.panel_temperature.step(ambient + 0.028 * irradiance);
        let heat = 1.0 - 0.0042 * (cell - 25.0);
        let flicker = 1.0 + self.flicker.step(&mut self.random);
        self.available = PEAK_POWER * irradiance / 1000.0 * heat * flicker;
        self.choose_mode(battery);
        self.current = self.deliver(demand, battery);
        self.voltage = self.panel_voltage(irradiance, heat, battery);
        self.out_voltage = battery.voltage() + 0.0022 * self.current;
        let output = self.power();
        self.controller_temperature.step(ambient + 4.0 + 0.022 * output);
        self.count(output);
    }

    /// The day's counters start again at midnight.
    pub fn new_day(&mut self) {
        self.float_seconds = 0.0;
        self.charge_seconds = 0.0;
        self.today = (0.0, 0.0);
    }

    fn deliver(&self, demand: f64, battery: &Battery) -> f64 {
        let ceiling = match self.mode {
            Mode::Off => return 0.0,
            Mode::Float => FLOAT,
            _ => ABSORPTION,
        };
        let possible = self.available * EFFICIENCY / battery.voltage().max(1.0);
        let wanted = battery.current_at(battery.compensated(ceiling)) + demand;
        possible.min(CURRENT_LIMIT).min(wanted).max(0.0)
    }

    fn choose_mode(&mut self, battery: &Battery) {
        self.in_mode += STEP_SECONDS;
        let held = |volts: f64| battery.voltage() >= battery.compensated(volts) - 0.06;
        let next = match self.mode {
            Mode::Off if self.available > 6.0 => Mode::Start,
            Mode::Off => Mode::Off,
            _ if self.available < 2.0 => Mode::Off,
            Mode::Start if self.in_mode < 90.0 => Mode::Start,
            Mode::Start => Mode::Tracking,
            Mode::Tracking | Mode::Fast if held(ABSORPTION) => Mode::Saturation,
            Mode::Tracking | Mode::Fast if self.current >= CURRENT_LIMIT - 0.1 => Mode::Fast,
            Mode::Tracking | Mode::Fast => Mode::Tracking,
            Mode::Saturation if !held(ABSORPTION - 0.5) => Mode::Tracking,
            Mode::Saturation
                if battery.current() < TAIL_CURRENT && held(ABSORPTION)
                    || self.in_mode > ABSORPTION_SECONDS =>
            {
                Mode::Float
            }
            Mode::Saturation => Mode::Saturation,
            // Cloud and load pull the battery down for minutes: only a real discharge counts.
            Mode::Float if battery.soc() < 0.93 => Mode::Tracking,
            Mode::Float => Mode::Float,
        };
        if next != self.mode {
            self.mode = next;
            self.in_mode = 0.0;
        }
    }

    /// At the point of full power while all is taken, rising to open circuit when less is.
    fn panel_voltage(&self, irradiance: f64, heat: f64, battery: &Battery) -> f64 {
        if irradiance < 0.5 {
            return 0.0;
        }
        let light = irradiance / (irradiance + 12.0);
        let (full_power, open) = (71.0 * heat * light, 86.5 * heat * light);
        let taken = self.current * battery.voltage() / EFFICIENCY / self.available.max(0.1);
        open - (open - full_power) * taken.clamp(0.0, 1.0).powf(0.6)
    }

    fn count(&mut self, output: f64) {
        let hours = STEP_SECONDS / 3600.0;
        self.today.0 += output * hours;
        self.today.1 += self.current * hours;
        self.charge_seconds += if self.current > 0.05 { STEP_SECONDS } else { 0.0 };
        self.float_seconds += if self.mode == Mode::Float { STEP_SECONDS } else { 0.0 };
    }

    /// Charge mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// True while the panels are connected: by day.
    pub fn connected(&self) -> bool {
        self.mode != Mode::Off
    }

    /// Panel voltage, V.
    pub fn voltage(&self) -> f64 {
        self.voltage
    }

    /// Panel current, A.
    pub fn panel_current(&self) -> f64 {
        if self.voltage < 5.0 { 0.0 } else { self.power() / EFFICIENCY / self.voltage }
    }

    /// Output current, A.
    pub fn current(&self) -> f64 {
        self.current
    }

    /// Output voltage, V: the battery's, and what the cable takes.
    pub fn out_voltage(&self) -> f64 {
        self.out_voltage
    }

    /// Output power, W.
    pub fn power(&self) -> f64 {
        self.current * self.out_voltage
    }

    /// Temperature of the controller, °C.
    pub fn temperature(&self) -> f64 {
        self.controller_temperature.value()
    }

    /// Output since midnight, Wh and Ah.
    pub fn today(&self) -> (f64, f64) {
        self.today
    }

    /// Seconds since midnight with charging, and of them in float.
    pub fn seconds(&self) -> (f64, f64) {
        (self.charge_seconds, self.float_seconds)
    }
}
