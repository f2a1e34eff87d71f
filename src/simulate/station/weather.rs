//! Clouds and air.

use super::sun;
use crate::simulate::random::{Drift, Lag, Random};

/// The sky over the station.
#[derive(Clone, Debug)]
pub struct Weather {
    random: Random,
    /// Fair or dull, changing over half a day.
    cloudiness: Drift,
    /// Single clouds passing within minutes.
    passing: Drift,
    /// A cloud's edge takes some time to cross the panels.
    edge: Lag,
    /// Warmer or colder days.
    air: Drift,
    temperature: Lag,
}

/// What arrives on the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// From the sun's disc, on a surface facing it, W/m².
    pub beam: f64,
    /// From the rest of the sky, W/m².
    pub diffuse: f64,
}

impl Weather {
    /// Weather for one seed; `hour` (0..24) is the time of day it begins with.
    pub fn new(seed: u64, hour: f64) -> Self {
        let mut random = Random::new(seed, 0x5E7);
        let cloudiness = Drift::new(1.15, 11.0 * 3600.0, &mut random);
        let passing = Drift::new(1.0, 420.0, &mut random);
        let air = Drift::new(2.2, 14.0 * 3600.0, &mut random);
        let temperature = Lag::new(day_curve(hour) + air.value(), 900.0);
        Self { random, cloudiness, passing, edge: Lag::new(0.8, 35.0), air, temperature }
    }

    /// One step at time of day `hour` (0..24).
    pub fn step(&mut self, hour: f64) {
        let dull = self.cloudiness.step(&mut self.random) - 0.1;
        let cloud = self.passing.step(&mut self.random) + 1.5 * dull;
        // A cloud either covers the sun or does not: steep between the two.
        let open = 1.0 / (1.0 + (3.5 * (cloud - 0.7)).exp());
        self.edge.step(open);
        let warming = 3.0 * (self.edge.value() - 0.6);
        let air = self.air.step(&mut self.random);
        self.temperature.step(day_curve(hour) + air + warming);
    }

    /// The light while the sun stands `elevation` degrees high.
    pub fn light(&self, elevation: f64) -> Light {
        let clear = sun::clear_beam(elevation);
        let height = elevation.to_radians().sin().max(0.0);
        let open = self.edge.value();
        // What a cloud takes from the beam comes down, in part, from all over the sky.
        let diffuse = clear * (0.08 + 0.22 * (1.0 - open) * height.sqrt());
        Light { beam: clear * (0.06 + 0.94 * open), diffuse }
    }

    /// Air temperature, °C.
    pub fn temperature(&self) -> f64 {
        self.temperature.value()
    }
}

/// A spring day, °C: coldest before sunrise, warmest in the afternoon.
fn day_curve(hour: f64) -> f64 {
    12.5 - 5.5 * ((hour - 3.5) / 24.0 * std::f64::consts::TAU).cos()
}
