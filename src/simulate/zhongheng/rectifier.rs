//! One rectifier module.

use crate::simulate::random::{Drift, Lag};

/// One rectifier.
#[derive(Clone, Debug)]
pub struct Rectifier {
    pub(super) serial: u32,
    /// How much more or less than its share it gives.
    pub(super) share: Drift,
    pub(super) current: f64,
    pub(super) temperature: Lag,
    pub(super) on: bool,
    pub(super) mains: bool,
    /// Seconds that a broken fan keeps it off.
    pub(super) broken: f64,
    pub(super) run_seconds: f64,
}

impl Rectifier {
    /// Output current, A.
    pub fn current(&self) -> f64 {
        self.current
    }

    /// Heat sink temperature, °C.
    pub fn temperature(&self) -> f64 {
        self.temperature.value()
    }

    /// Serial number.
    pub fn serial(&self) -> u32 {
        self.serial
    }

    /// True while it gives current.
    pub fn on(&self) -> bool {
        self.on
    }

    /// Seconds in operation.
    pub fn run_seconds(&self) -> f64 {
        self.run_seconds
    }

    /// Fault bits (section 8, 0x40ec): 0x0001 fan, 0x0100 shut down, 0x0200 mains.
    pub fn faults(&self) -> u16 {
        u16::from(self.broken > 0.0) | u16::from(!self.on) << 8 | u16::from(!self.mains) << 9
    }
}
