//! How late frames went out: a histogram of bounded size.

/// Buckets for each power of two: values are told apart to 1/32 (3 %).
const STEPS: usize = 32;

/// Counts of durations in nanoseconds. Exact up to 31 ns, to 3 % above.
#[derive(Clone, Debug)]
pub struct Lateness {
    buckets: Vec<u64>,
    count: u64,
    max: u64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self { buckets: vec![0; STEPS * 60], count: 0, max: 0 }
    }
}

impl Lateness {
    /// Counts one duration.
    pub fn add(&mut self, nanos: u64) {
        if let Some(bucket) = self.buckets.get_mut(bucket_of(nanos)) {
            *bucket += 1;
        }
        self.count += 1;
        self.max = self.max.max(nanos);
    }

    /// How many were counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The longest.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// The duration that `percent` of a hundred do not exceed; 0 if there are none.
    pub fn percentile(&self, percent: u64) -> u64 {
        let rank = (self.count * percent).div_ceil(100).max(1);
        let mut seen = 0;
        for (index, bucket) in self.buckets.iter().enumerate() {
            seen += bucket;
            if seen >= rank {
                return upper_of(index).min(self.max);
            }
        }
        self.max
    }
}

fn bucket_of(nanos: u64) -> usize {
    if nanos < STEPS as u64 {
        return usize::try_from(nanos).unwrap_or(0);
    }
    let power = nanos.ilog2();
    // The five bits below the highest one.
    let step = usize::try_from(nanos >> (power - 5)).unwrap_or(0) - STEPS;
    (power as usize - 4) * STEPS + step
}

/// The largest duration that falls into a bucket.
fn upper_of(index: usize) -> u64 {
    if index < STEPS {
        return index as u64;
    }
    let (power, step) = (index / STEPS + 4, index % STEPS);
    let first = ((STEPS + step) as u64) << (power - 5);
    first + ((1u64 << (power - 5)) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_within_3_percent() {
        let mut lateness = Lateness::default();
        for nanos in 1..=100_000 {
            lateness.add(nanos);
        }
        for percent in [1, 50, 90, 99] {
            let (found, exact) = (lateness.percentile(percent), 1000 * percent);
            assert!(found >= exact && found <= exact + exact / 32 + 1, "{percent}: {found}");
        }
        assert_eq!((lateness.max(), lateness.percentile(100)), (100_000, 100_000));
    }

    #[test]
    fn every_duration_has_its_bucket() {
        for nanos in
            (0..64).map(|bit| 1u64 << bit).flat_map(|n| [n - 1, n, n + 1]).chain([u64::MAX])
        {
            let bucket = bucket_of(nanos);
            assert!(bucket < STEPS * 60 && upper_of(bucket) >= nanos, "{nanos}");
            assert!(bucket == 0 || upper_of(bucket - 1) < nanos, "{nanos}");
        }
        assert_eq!(Lateness::default().percentile(50), 0);
    }
}
