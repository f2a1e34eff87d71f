//! A lead-acid battery: charge counted in, charge counted out, and the voltage that goes with it.
//!
//! The model is the usual one for such batteries: an open-circuit voltage that rises with the
//! state of charge, a resistance that answers at once, and a polarisation that follows the current
//! within minutes. While charging, the polarisation grows steeply near full charge: that makes the
//! voltage bend upwards, and the current taper off once the charger holds the voltage.

use super::STEP_SECONDS;
use super::random::Lag;

/// Open-circuit voltage of an empty cell at rest, V.
const CELL_EMPTY: f64 = 1.96;
/// What a full charge adds to it, V.
const CELL_RISE: f64 = 0.17;
/// Time constant of the polarisation, s.
const POLARISATION_SECONDS: f64 = 420.0;
/// Share of the charging current that is stored while the battery is far from full.
const CHARGE_EFFICIENCY: f64 = 0.96;

/// A string of 2 V cells.
#[derive(Clone, Debug)]
pub struct Battery {
    cells: f64,
    capacity: f64,
    soc: f64,
    /// Polarisation of one cell, V.
    polarisation: Lag,
    temperature: Lag,
    current: f64,
    voltage: f64,
}

impl Battery {
    /// A battery of `cells` cells and `capacity` Ah, charged to `soc` (0..=1), at rest.
    pub fn new(cells: u8, capacity: f64, soc: f64, temperature: f64) -> Self {
        let mut battery = Self {
            cells: f64::from(cells),
            capacity,
            soc,
            polarisation: Lag::new(0.0, POLARISATION_SECONDS),
            // Hundreds of kilograms of lead and acid take half a day to follow the room.
            temperature: Lag::new(temperature, 6.0 * 3600.0),
            current: 0.0,
            voltage: 0.0,
        };
        battery.voltage = battery.voltage_at(0.0);
        battery
    }

    /// One step with `current` A (plus charges, minus discharges) in a room of `ambient` °C.
    pub fn step(&mut self, current: f64, ambient: f64) {
        let stored = if current > 0.0 { CHARGE_EFFICIENCY * self.acceptance() } else { 1.0 };
        let moved = current * stored * STEP_SECONDS / 3600.0;
        self.soc = (self.soc + moved / self.capacity).clamp(0.0, 1.0);
        self.voltage = self.voltage_at(current);
        self.polarisation.step(current * self.polarisation_resistance(current));
        // Losses warm it a little: 20 A and more for hours make about one degree.
        let heating = 2.0 * (current / (0.1 * self.capacity)).abs().min(3.0);
        self.temperature.step(ambient + heating);
        self.current = current;
    }

    /// Terminal voltage, V.
    pub fn voltage(&self) -> f64 {
        self.voltage
    }

    /// Current, A: plus charges, minus discharges.
    pub fn current(&self) -> f64 {
        self.current
    }

    /// State of charge, 0..=1.
    pub fn soc(&self) -> f64 {
        self.soc
    }

    /// Capacity, Ah.
    pub fn capacity(&self) -> f64 {
        self.capacity
    }

    /// Temperature, °C.
    pub fn temperature(&self) -> f64 {
        self.temperature.value()
    }

    /// The current (A) that flows when the terminals are held at `volts`; negative when the
    /// battery's own voltage is higher.
    pub fn current_at(&self, volts: f64) -> f64 {
        (volts / self.cells - self.cell_rest() - self.polarisation.value()) / self.resistance()
    }

    /// `volts`, given for 25 °C, as a charger sets it for the battery's temperature: 4 mV per cell
    /// and degree less when it is warmer.
    pub fn compensated(&self, volts: f64) -> f64 {
        volts - 0.004 * self.cells * (self.temperature() - 25.0)
    }

    fn voltage_at(&self, current: f64) -> f64 {
        let cell = self.cell_rest() + self.polarisation.value() + current * self.resistance();
        self.cells * cell
    }

    fn cell_rest(&self) -> f64 {
        // The last few percent take the voltage down much faster than those before.
        CELL_EMPTY + CELL_RISE * self.soc - 0.12 * (1.0 - self.soc).powi(12)
    }

    /// What answers at once, Ω per cell: 0.8 mΩ at 400 Ah.
    fn resistance(&self) -> f64 {
        0.32 / self.capacity
    }

    fn polarisation_resistance(&self, current: f64) -> f64 {
        let shape = if current > 0.0 {
            0.5 + 2.6 * self.soc.powi(10) + 66.0 * self.soc.powi(60)
        } else {
            0.24 + 1.3 * (1.0 - self.soc).powi(6)
        };
        shape / self.capacity
    }

    /// Near full charge more and more of the current makes gas instead of charge.
    fn acceptance(&self) -> f64 {
        1.0 - self.soc.powi(40)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(battery: &mut Battery, current: f64, hours: f64) {
        for _ in 0..(hours * 3600.0 / STEP_SECONDS) as usize {
            battery.step(current, 20.0);
        }
    }

    #[test]
    fn discharge_counts_every_ampere_hour() {
        let mut battery = Battery::new(12, 400.0, 0.9, 20.0);
        run(&mut battery, -40.0, 5.0);
        assert!((battery.soc() - 0.4).abs() < 1e-6, "{}", battery.soc());
    }

    #[test]
    fn a_charge_at_constant_voltage_tapers_off_and_fills_the_battery() {
        let mut battery = Battery::new(12, 400.0, 0.6, 20.0);
        let mut currents = Vec::new();
        for _ in 0..15 * 3600 {
            let current = battery.current_at(28.4).min(40.0);
            battery.step(current, 20.0);
            currents.push(current);
        }
        assert!(battery.soc() > 0.97, "{}", battery.soc());
        assert!((currents[60] - 40.0).abs() < 1e-9);
        assert!(currents[15 * 3600 - 1] < 4.0, "{}", currents[15 * 3600 - 1]);
        assert!(battery.voltage() < 28.41, "{}", battery.voltage());
    }

    #[test]
    fn an_empty_battery_gives_a_low_voltage_and_never_a_negative_charge() {
        let mut battery = Battery::new(12, 400.0, 0.05, 20.0);
        run(&mut battery, -40.0, 1.0);
        assert_eq!(battery.soc(), 0.0);
        assert!((18.0..22.5).contains(&battery.voltage()), "{}", battery.voltage());
    }

    #[test]
    fn a_warm_battery_is_charged_with_less_voltage() {
        let warm = Battery::new(12, 400.0, 0.5, 35.0);
        assert!((warm.compensated(28.4) - 27.92).abs() < 1e-9);
    }
}
