//! What hangs on the inverters: a refrigerator, lamps, a kettle, a pump, switched as people do.

use crate::simulate::STEP_SECONDS;
use crate::simulate::random::{Drift, Random};

/// Which inverter feeds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The 1000 W inverter: what is always there.
    Small,
    /// The 3000 W inverter: what is switched on for minutes.
    Large,
}

/// One kind of appliance.
struct Appliance {
    line: Line,
    watts: f64,
    /// Mean time on, s; it varies by half.
    on: f64,
    /// How often it is switched on: (from hour, to hour, times per hour).
    habit: &'static [(f64, f64, f64)],
}

const ALWAYS: &[(f64, f64, f64)] = &[(0.0, 24.0, 60.0)];
const EVENING: &[(f64, f64, f64)] = &[(5.8, 7.2, 1.2), (19.0, 23.2, 2.0)];
const MEALS: &[(f64, f64, f64)] = &[(6.3, 8.5, 0.9), (12.2, 13.8, 0.8), (17.8, 21.5, 0.7)];

#[rustfmt::skip]
const APPLIANCES: &[Appliance] = &[
    // Radio link, router and the controllers' own display.
    Appliance { line: Line::Small, watts: 36.0, on: 1.0e9, habit: ALWAYS },
    // Refrigerator and freezer: compressors that come on twice an hour.
    Appliance { line: Line::Small, watts: 104.0, on: 840.0, habit: &[(0.0, 24.0, 2.2)] },
    Appliance { line: Line::Small, watts: 118.0, on: 960.0, habit: &[(0.0, 24.0, 1.1)] },
    // Lamps: kitchen, room, yard.
    Appliance { line: Line::Small, watts: 28.0, on: 5400.0, habit: EVENING },
    Appliance { line: Line::Small, watts: 44.0, on: 7200.0, habit: EVENING },
    Appliance { line: Line::Small, watts: 20.0, on: 14_000.0, habit: &[(19.5, 22.0, 1.5)] },
    // Television, computer.
    Appliance { line: Line::Small, watts: 84.0, on: 6000.0, habit: &[(18.5, 22.0, 0.8)] },
    Appliance { line: Line::Small, watts: 58.0, on: 5000.0, habit: &[(8.5, 22.5, 0.35)] },
    // Kettle, microwave oven, water pump, washing machine, tools.
    Appliance { line: Line::Large, watts: 1850.0, on: 200.0, habit: MEALS },
    Appliance { line: Line::Large, watts: 1150.0, on: 170.0, habit: MEALS },
    Appliance { line: Line::Large, watts: 740.0, on: 900.0, habit: &[(6.0, 22.0, 0.5)] },
    Appliance { line: Line::Large, watts: 380.0, on: 3000.0, habit: &[(9.0, 15.0, 0.07)] },
    Appliance { line: Line::Large, watts: 620.0, on: 420.0, habit: &[(9.5, 17.5, 0.35)] },
];

/// Nobody switches the kettle on while the line is nearly full, W.
const LINE_LIMIT: [f64; 2] = [900.0, 2800.0];

/// All appliances, and who of them is on.
#[derive(Clone, Debug)]
pub struct Loads {
    random: Random,
    /// Seconds each appliance stays on; 0 is off.
    left: Vec<f64>,
    variation: Drift,
    watts: [f64; 2],
}

impl Loads {
    /// The appliances of one seed, those switched on that always are.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, 0x10AD);
        let left = APPLIANCES.iter().map(|a| if a.on > 1.0e8 { a.on } else { 0.0 }).collect();
        let variation = Drift::new(0.015, 60.0, &mut random);
        Self { random, left, variation, watts: [0.0; 2] }
    }

    /// One step at time of day `hour` (0..24). Without `power` everything is off, and what was on
    /// stays switched off except for what starts by itself.
    pub fn step(&mut self, hour: f64, power: bool) {
        let variation = 1.0 + self.variation.step(&mut self.random);
        let mut watts = [0.0; 2];
        for (appliance, left) in APPLIANCES.iter().zip(&mut self.left) {
            *left = (*left - STEP_SECONDS).max(0.0);
            watts[appliance.line as usize] += if *left > 0.0 { appliance.watts } else { 0.0 };
        }
        for (appliance, left) in APPLIANCES.iter().zip(&mut self.left) {
            let per_hour = if *left > 0.0 { 0.0 } else { starts(appliance.habit, hour) };
            let line = appliance.line as usize;
            if self.random.chance(per_hour * STEP_SECONDS / 3600.0)
                && power
                && watts[line] + appliance.watts < LINE_LIMIT[line]
            {
                *left = appliance.on * self.random.between(0.5, 1.5);
                watts[line] += appliance.watts;
            }
        }
        self.watts = if power { watts.map(|w| w * variation) } else { [0.0; 2] };
    }

    /// Power drawn from `line`, W.
    pub fn watts(&self, line: Line) -> f64 {
        self.watts[line as usize]
    }
}

fn starts(habit: &[(f64, f64, f64)], hour: f64) -> f64 {
    habit.iter().filter(|(from, to, _)| (*from..*to).contains(&hour)).map(|(.., times)| times).sum()
}
