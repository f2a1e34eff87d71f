//! Chance that is the same every time: a seeded generator, and noise as nature makes it.

use super::STEP_SECONDS;

/// A small generator of pseudo-random numbers (SplitMix64 by Steele, Lea and Flood).
///
/// Not for secrets. The same seed gives the same numbers on every machine and in every version.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// Numbers for one subsystem. Each takes its own `stream` of the one seed, so that a change in
    /// one subsystem does not turn the others upside down.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = Self(seed ^ stream.wrapping_mul(0xD134_2543_DE82_EF95));
        random.bits();
        random
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number in 0..1.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number in `from..to`.
    pub fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }

    /// An index in `0..count`; 0 when there is nothing to choose from.
    pub fn index(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// True with `probability` 0..=1.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// The time to the next of events that come by chance, on average every `mean`.
    pub fn wait(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.unit()).ln()
    }

    /// Normally distributed, mean 0, standard deviation 1, never beyond ±3.5.
    ///
    /// Four 16-bit numbers added up: near enough for noise, and without a logarithm.
    pub fn normal(&mut self) -> f64 {
        let bits = self.bits();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xFFFF).sum();
        (sum as f64 / 65_536.0 - 2.0) * 3.0_f64.sqrt()
    }
}

/// Correlated noise around 0: wanders, and comes back within some time (an Ornstein-Uhlenbeck
/// process). Independent samples would make a plot look like a brush; measured values never do.
#[derive(Clone, Debug)]
pub struct Drift {
    value: f64,
    keep: f64,
    push: f64,
}

impl Drift {
    /// Noise with the standard deviation `sigma` that forgets itself within `seconds`.
    pub fn new(sigma: f64, seconds: f64, random: &mut Random) -> Self {
        let keep = (-STEP_SECONDS / seconds).exp();
        let push = sigma * (1.0 - keep * keep).sqrt();
        Self { value: sigma * random.normal(), keep, push }
    }

    /// One step further.
    pub fn step(&mut self, random: &mut Random) -> f64 {
        self.value = self.value * self.keep + self.push * random.normal();
        self.value
    }

    /// The noise now.
    pub fn value(&self) -> f64 {
        self.value
    }
}

/// Follows a target with a time constant, as temperatures and filtered measurements do.
#[derive(Clone, Debug)]
pub struct Lag {
    value: f64,
    share: f64,
}

impl Lag {
    /// Starts at `value`; covers 63 % of the way to its target within `seconds`.
    pub fn new(value: f64, seconds: f64) -> Self {
        Self { value, share: 1.0 - (-STEP_SECONDS / seconds).exp() }
    }

    /// One step towards `target`.
    pub fn step(&mut self, target: f64) -> f64 {
        self.value += (target - self.value) * self.share;
        self.value
    }

    /// Where it is now.
    pub fn value(&self) -> f64 {
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_of_a_seed_never_change() {
        let mut random = Random(0);
        // The published test values of SplitMix64 for seed 0.
        assert_eq!(random.bits(), 0xE220_A839_7B1D_CDAF);
        assert_eq!(random.bits(), 0x6E78_9E6A_A1B9_65F4);
        assert_ne!(Random::new(1, 1).bits(), Random::new(1, 2).bits());
    }

    #[test]
    fn normal_numbers_are_normal() {
        let mut random = Random::new(7, 0);
        let all: Vec<f64> = (0..100_000).map(|_| random.normal()).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let variance = all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / all.len() as f64;
        assert!(mean.abs() < 0.02, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.02, "variance {variance}");
    }

    #[test]
    fn drift_keeps_its_size_and_moves_slowly() {
        let mut random = Random::new(7, 0);
        let mut drift = Drift::new(2.0, 100.0, &mut random);
        let all: Vec<f64> = (0..200_000).map(|_| drift.step(&mut random)).collect();
        let spread = (all.iter().map(|x| x * x).sum::<f64>() / all.len() as f64).sqrt();
        assert!((spread - 2.0).abs() < 0.3, "spread {spread}");
        let jump = all.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(jump < 1.1, "jump {jump}");
    }
}
