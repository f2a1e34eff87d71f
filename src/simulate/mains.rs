//! The public mains: mostly there, never quite 220 V, and now and then gone for a while.

use super::STEP_SECONDS;
use super::random::{Drift, Random};

/// Nominal voltage, V.
const NOMINAL: f64 = 220.0;

/// Three phases of one grid.
#[derive(Clone, Debug)]
pub struct Mains {
    random: Random,
    present: bool,
    /// Seconds to the next failure or return.
    left: f64,
    mean_up: f64,
    outage: (f64, f64),
    /// The grid of the whole village, and what each phase does on its own.
    grid: Drift,
    phases: [Drift; 3],
}

impl Mains {
    /// Mains that fail on average after `mean_up` seconds, for a time within `outage` seconds.
    pub fn new(seed: u64, mean_up: f64, outage: (f64, f64)) -> Self {
        let mut random = Random::new(seed, 0x3A11);
        let left = random.wait(mean_up);
        let grid = Drift::new(2.2, 1500.0, &mut random);
        let phases = std::array::from_fn(|_| Drift::new(1.1, 240.0, &mut random));
        Self { random, present: true, left, mean_up, outage, grid, phases }
    }

    /// One step.
    pub fn step(&mut self) {
        self.grid.step(&mut self.random);
        for phase in &mut self.phases {
            phase.step(&mut self.random);
        }
        self.left -= STEP_SECONDS;
        if self.left <= 0.0 {
            self.present = !self.present;
            self.left = if self.present {
                self.random.wait(self.mean_up)
            } else {
                self.random.between(self.outage.0, self.outage.1)
            };
        }
    }

    /// True while there is voltage.
    pub fn present(&self) -> bool {
        self.present
    }

    /// Voltage of phase 0..=2 to neutral, V; 0 while the mains are gone. The evening peak of
    /// `hour` (0..24) pulls it down by a few volts.
    pub fn voltage(&self, phase: usize, hour: f64) -> f64 {
        let Some(own) = self.phases.get(phase).filter(|_| self.present) else { return 0.0 };
        let evening = (-((hour - 19.5) / 2.5).powi(2)).exp();
        NOMINAL + 3.0 - 6.0 * evening + self.grid.value() + own.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mains_fail_and_come_back_for_every_seed() {
        for seed in 0..20 {
            let mut mains = Mains::new(seed, 20.0 * 3600.0, (1200.0, 14_400.0));
            let mut up = 0_u32;
            for _ in 0..10 * 86_400 {
                mains.step();
                up += u32::from(mains.present());
                let volts = mains.voltage(0, 12.0);
                assert!(if mains.present() {
                    (190.0..250.0).contains(&volts)
                } else {
                    volts == 0.0
                });
            }
            let share = f64::from(up) / 864_000.0;
            assert!((0.6..0.999).contains(&share), "seed {seed}: present {share}");
        }
    }
}
