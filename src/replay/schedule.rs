//! When a frame is due: reckoned from the start on the steady clock, never by adding up pauses.

/// How fast time passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// So many recorded seconds a second, 0.1 to 100.
    Times(f64),
    /// As fast as the targets take it.
    Max,
}

impl Rate {
    /// Slowest.
    pub const LEAST: f64 = 0.1;
    /// Fastest, short of [`Rate::Max`].
    pub const MOST: f64 = 100.0;

    /// Reads `0.5`, `2` or `max`.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text == "max" {
            return Ok(Self::Max);
        }
        match text.trim_end_matches('x').parse() {
            Ok(times) if (Self::LEAST..=Self::MOST).contains(&times) => Ok(Self::Times(times)),
            _ => Err(format!("\"{text}\" is no rate; write a number from 0.1 to 100, or max")),
        }
    }
}

impl std::fmt::Display for Rate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Times(times) => write!(f, "{}x", (times * 100.0).round() / 100.0),
            Self::Max => f.write_str("max"),
        }
    }
}

/// Maps media time, nanoseconds since the start of what is played, to the steady clock.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    rate: Rate,
    /// This media time...
    media: u64,
    /// ...is due at this steady time.
    steady: u64,
    paused: bool,
}

impl Schedule {
    /// Media time 0 is due at the steady time `start`.
    pub fn new(rate: Rate, start: u64) -> Self {
        Self { rate, media: 0, steady: start, paused: false }
    }

    /// When `media` is due; at once (0) at the highest rate; `None` while paused.
    pub fn due(&self, media: u64) -> Option<u64> {
        if self.paused {
            return None;
        }
        let ahead = media.saturating_sub(self.media);
        match self.rate {
            Rate::Max => Some(0),
            // Exactly, whatever the length of the recording.
            Rate::Times(1.0) => Some(self.steady.saturating_add(ahead)),
            Rate::Times(times) => {
                #[allow(clippy::cast_possible_truncation, reason = "positive, and saturates")]
                let nanos = (ahead as f64 / times) as u64;
                Some(self.steady.saturating_add(nanos))
            }
        }
    }

    /// The rate.
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// True while time stands still.
    pub fn is_paused(&self) -> bool {
        self.paused
    }

    /// Time stands still from `now` on.
    pub fn pause(&mut self, now: u64, played: u64) {
        if !self.paused {
            self.anchor(now, played);
            self.paused = true;
        }
    }

    /// Time passes again from `now` on.
    pub fn resume(&mut self, now: u64) {
        if self.paused {
            self.steady = now;
            self.paused = false;
        }
    }

    /// From `now` on time passes at another rate.
    pub fn set_rate(&mut self, rate: Rate, now: u64, played: u64) {
        if !self.paused {
            self.anchor(now, played);
        }
        self.rate = rate;
    }

    /// `media` is now.
    pub fn jump(&mut self, media: u64, now: u64) {
        (self.media, self.steady) = (media, now);
    }

    /// Now is where time has got to; at the highest rate that is what was played.
    fn anchor(&mut self, now: u64, played: u64) {
        let passed = now.saturating_sub(self.steady);
        self.media = match self.rate {
            Rate::Max => played.max(self.media),
            #[allow(clippy::cast_possible_truncation, reason = "positive, and saturates")]
            Rate::Times(times) => self.media.saturating_add((passed as f64 * times) as u64),
        };
        self.steady = now.max(self.steady);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn the_last_frame_of_a_long_recording_is_due_as_exactly_as_the_first() {
        let schedule = Schedule::new(Rate::Times(1.0), 7);
        let year = 365 * 86_400 * SECOND + 1;
        assert_eq!((schedule.due(0), schedule.due(year)), (Some(7), Some(year + 7)));
        let slow = Schedule::new(Rate::Times(0.1), 0);
        assert_eq!(slow.due(3 * SECOND), Some(30 * SECOND));
    }

    #[test]
    fn rate_and_pause_change_what_is_to_come_only() {
        let mut schedule = Schedule::new(Rate::Times(1.0), 0);
        schedule.set_rate(Rate::Times(2.0), 10 * SECOND, 0);
        assert_eq!(schedule.due(10 * SECOND), Some(10 * SECOND));
        assert_eq!(schedule.due(14 * SECOND), Some(12 * SECOND));
        schedule.pause(12 * SECOND, 0);
        assert_eq!(schedule.due(14 * SECOND), None);
        schedule.resume(100 * SECOND);
        assert_eq!(schedule.due(14 * SECOND), Some(100 * SECOND));
        assert_eq!(schedule.due(16 * SECOND), Some(101 * SECOND));
        schedule.set_rate(Rate::Max, 100 * SECOND, 0);
        assert_eq!(schedule.due(900 * SECOND), Some(0));
        schedule.set_rate(Rate::Times(1.0), 101 * SECOND, 900 * SECOND);
        assert_eq!(schedule.due(901 * SECOND), Some(102 * SECOND));
        schedule.jump(5 * SECOND, 200 * SECOND);
        assert_eq!(schedule.due(6 * SECOND), Some(201 * SECOND));
    }

    #[test]
    fn rates_are_read_within_their_range() {
        assert_eq!(Rate::parse("0.1"), Ok(Rate::Times(0.1)));
        assert_eq!(Rate::parse("2x"), Ok(Rate::Times(2.0)));
        assert_eq!(Rate::parse("max"), Ok(Rate::Max));
        for text in ["0", "0.09", "101", "-1", "NaN", "fast", ""] {
            assert!(Rate::parse(text).is_err(), "{text}");
        }
    }
}
