//! What can be measured in the plant.

use super::alarm::Alarms;
use super::plant::{CELLS, EQUALIZE_OFFSET, Plant, RATED, RECTIFIERS};
use super::rectifier::Rectifier;
use crate::simulate::battery::Battery;

/// The plant's clock at the beginning: 2024-04-15T06:00:00Z.
const BEGIN_UNIX: f64 = 1_713_160_800.0;

impl Plant {
    /// The plant's clock, seconds since 1970.
    pub fn unix_time(&self) -> f64 {
        BEGIN_UNIX + self.seconds as f64
    }

    /// Minutes left of a countdown over `period` minutes that starts again and again.
    pub fn minutes_until(&self, period: f64) -> f64 {
        (period - (self.unix_time() / 60.0).rem_euclid(period)).floor()
    }

    /// Voltage of mains phase 0..=2, V.
    pub fn phase(&self, index: usize) -> f64 {
        self.mains.voltage(index, self.hour())
    }

    /// Voltage of the bus bar, V.
    pub fn bus_voltage(&self) -> f64 {
        self.battery.voltage()
    }

    /// The battery.
    pub fn battery(&self) -> &Battery {
        &self.battery
    }

    /// Voltage of one battery cell, V.
    pub fn cell_voltage(&self, index: usize) -> f64 {
        let mean = self.battery.voltage() / f64::from(CELLS);
        mean + self.cells.get(index).copied().unwrap_or_default()
    }

    /// Current into the load, A.
    pub fn load_current(&self) -> f64 {
        self.load_current
    }

    /// Current out of all rectifiers, A.
    pub fn rectifier_current(&self) -> f64 {
        self.rectifier_current
    }

    /// Power out of all rectifiers, W.
    pub fn rectifier_power(&self) -> f64 {
        self.rectifier_current * self.battery.voltage()
    }

    /// The same over ten minutes, W.
    pub fn average_power(&self) -> f64 {
        self.average_power.value()
    }

    /// Load of the rectifiers, percent of what all of them could give.
    pub fn power_percent(&self) -> f64 {
        self.rectifier_current / (RATED * RECTIFIERS as f64) * 100.0
    }

    /// Room temperature, °C.
    pub fn ambient(&self) -> f64 {
        self.room.value()
    }

    /// Float voltage as set, V.
    pub fn float_voltage(&self) -> f64 {
        self.float_voltage
    }

    /// Sets the float voltage, V.
    pub fn set_float_voltage(&mut self, volts: f64) {
        self.float_voltage = volts;
    }

    /// Voltage the rectifiers are told to hold, V: the float voltage for the battery's temperature,
    /// and more while the battery is equalized.
    pub fn target_voltage(&self) -> f64 {
        self.battery.compensated(self.float_voltage) + self.equalize_offset()
    }

    /// How far the temperature of the battery moves the voltage, V.
    pub fn temperature_offset(&self) -> f64 {
        self.battery.compensated(0.0)
    }

    /// True while the battery is equalized.
    pub fn equalizing(&self) -> bool {
        self.equalizing
    }

    /// What equalizing adds to the voltage, V.
    pub fn equalize_offset(&self) -> f64 {
        if self.equalizing { EQUALIZE_OFFSET } else { 0.0 }
    }

    /// True while the battery may not take more current.
    pub fn limits_battery_current(&self) -> bool {
        self.limiting
    }

    /// How far the bus is held below its target while the battery's current is limited, V.
    pub fn limit_offset(&self) -> f64 {
        if self.limiting { self.battery.voltage() - self.target_voltage() } else { 0.0 }
    }

    /// The rectifier at `position`, if there is one.
    pub fn rectifier(&self, position: usize) -> Option<&Rectifier> {
        self.rectifiers.get(position)
    }

    /// Rectifiers that give current.
    pub fn count_working(&self) -> usize {
        self.rectifiers.iter().filter(|r| r.on).count()
    }

    /// Registration state of `position` (section 8, 0x40e2): 3 registered, 0 absent.
    pub fn registration(&self, position: usize) -> f64 {
        if position < self.rectifiers.len() { 3.0 } else { 0.0 }
    }

    /// Output voltage of the rectifier at `position`, V: a little above the bus bar's.
    pub fn output_voltage(&self, position: usize) -> f64 {
        self.rectifier(position)
            .map_or(0.0, |r| if r.on { self.bus_voltage() + 0.0012 * r.current } else { 0.0 })
    }

    /// The alarms.
    pub fn alarms(&self) -> &Alarms {
        &self.alarms
    }

    /// The alarms, to note that they were read.
    pub fn alarms_mut(&mut self) -> &mut Alarms {
        &mut self.alarms
    }
}
