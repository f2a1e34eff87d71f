//! How often a simulated device misbehaves, and in which way.

use super::random::Random;

/// The faults of a device and their rates. At most one of them happens at a time.
#[derive(Clone, Debug)]
pub struct Rates<F: 'static> {
    known: &'static [(&'static str, F)],
    /// One for each of `known`.
    rates: Vec<f64>,
}

impl<F: Copy> Rates<F> {
    /// None of the faults in `known` ever happens.
    pub fn none(known: &'static [(&'static str, F)]) -> Self {
        Self { known, rates: vec![0.0; known.len()] }
    }

    /// Reads `NAME=RATE[,NAME=RATE]...`, rates from 0 (never) to 1 (always).
    ///
    /// # Errors
    /// A sentence that says which part is wrong and what may stand there.
    pub fn parse(known: &'static [(&'static str, F)], text: &str) -> Result<Self, String> {
        let mut rates = Self::none(known);
        for part in text.split(',') {
            let (name, rate) = part.split_once('=').unwrap_or((part, ""));
            if !rates.set(name, rate)? {
                let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
                return Err(format!(
                    "there is no fault \"{}\"; there are {}",
                    name.escape_debug(),
                    names.join(", ")
                ));
            }
        }
        Ok(rates)
    }

    /// Sets the rate of one fault; false if there is none of that name.
    ///
    /// # Errors
    /// A sentence, when `rate` is none or all rates together exceed 1.
    pub fn set(&mut self, name: &str, rate: &str) -> Result<bool, String> {
        let Some(index) = self.known.iter().position(|(known, _)| *known == name) else {
            return Ok(false);
        };
        let number: f64 = rate.parse().ok().filter(|r| (0.0..=1.0).contains(r)).ok_or_else(|| {
            format!(
                "\"{}\" is no rate for {name}; write a number from 0 (never) to 1 (always), as in \
                 {name}=0.01",
                rate.escape_debug()
            )
        })?;
        if let Some(slot) = self.rates.get_mut(index) {
            *slot = number;
        }
        if self.rates.iter().sum::<f64>() > 1.0 + 1e-9 {
            return Err("the rates of all faults together are more than 1".to_owned());
        }
        Ok(true)
    }

    /// The rate of one fault.
    pub fn rate(&self, fault: F) -> f64
    where
        F: PartialEq,
    {
        let place = self.known.iter().position(|(_, known)| *known == fault);
        place.and_then(|index| self.rates.get(index)).copied().unwrap_or(0.0)
    }

    /// True if nothing ever goes wrong.
    pub fn is_none(&self) -> bool {
        self.rates.iter().all(|rate| *rate == 0.0)
    }

    /// What goes wrong this time, if anything.
    pub fn pick(&self, random: &mut Random) -> Option<F> {
        if self.is_none() {
            return None;
        }
        let mut left = random.unit();
        for ((_, fault), rate) in self.known.iter().zip(&self.rates) {
            if left < *rate {
                return Some(*fault);
            }
            left -= rate;
        }
        None
    }
}

impl<F> std::fmt::Display for Rates<F> {
    /// As it is read.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let happening = self.known.iter().zip(&self.rates).filter(|(_, rate)| **rate > 0.0);
        for (index, ((name, _), rate)) in happening.enumerate() {
            write!(f, "{}{name}={rate}", if index == 0 { "" } else { "," })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &[(&str, char)] = &[("late", 'l'), ("bad-crc", 'c'), ("garbage", 'g')];

    #[test]
    fn each_fault_happens_as_often_as_it_is_told_to() {
        let rates = Rates::parse(KNOWN, "garbage=0.25,late=0.5").unwrap();
        assert_eq!(rates.to_string(), "late=0.5,garbage=0.25");
        let mut random = Random::new(1, 1);
        let picked: String = (0..10_000).map(|_| rates.pick(&mut random).unwrap_or('-')).collect();
        for (fault, expected) in [('l', 5000), ('c', 0), ('g', 2500), ('-', 2500)] {
            let count = picked.matches(fault).count();
            assert!(count.abs_diff(expected) < 200, "{fault} {count} times");
        }
        let always = Rates::parse(KNOWN, "bad-crc=1").unwrap();
        assert!((0..1000).all(|_| always.pick(&mut random) == Some('c')));
        assert_eq!(Rates::none(KNOWN).pick(&mut random), None);
    }

    #[test]
    fn what_is_no_fault_and_no_rate_is_said() {
        for (text, part) in [
            ("smoke=0.1", "no fault \"smoke\"; there are late, bad-crc, garbage"),
            ("", "no fault \"\""),
            ("late", "\"\" is no rate for late"),
            ("late=often", "as in late=0.01"),
            ("late=NaN", "is no rate"),
            ("late=1.5", "from 0 (never) to 1 (always)"),
            ("late=0.6,garbage=0.6", "together are more than 1"),
        ] {
            let error = Rates::parse(KNOWN, text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
