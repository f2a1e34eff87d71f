//! Notices when the writer does not get on, since only the disk can hold it up.

use std::time::{Duration, Instant};

use crate::text::duration;

/// A disk may take so long for an answer before somebody should know. Cards and sticks pause for
/// seconds now and then.
const PATIENCE: Duration = Duration::from_secs(4);

/// Watches the writer's rounds.
pub struct Patience {
    rounds: u64,
    since: Instant,
    told: bool,
}

/// What there is to say.
#[derive(Debug, PartialEq, Eq)]
pub enum Word {
    /// The disk has not answered for this long.
    Waiting(String),
    /// It has answered again.
    Over(String),
}

impl Patience {
    /// Starts watching.
    pub fn new() -> Self {
        Self { rounds: 0, since: Instant::now(), told: false }
    }

    /// Looks at how often the writer has gone round; says something at most once a stall, and once when it is over.
    pub fn look(&mut self, rounds: u64, now: Instant) -> Option<Word> {
        let waited = now.saturating_duration_since(self.since);
        let nanos = u64::try_from(waited.as_nanos()).unwrap_or(u64::MAX);
        if rounds == self.rounds {
            if self.told || waited < PATIENCE {
                return None;
            }
            self.told = true;
            return Some(Word::Waiting(format!(
                "the disk has not answered for {}; capture goes on, and what does not fit into \
                 the queue (--queue) is counted as dropped",
                duration(nanos)
            )));
        }
        (self.rounds, self.since) = (rounds, now);
        let was_told = std::mem::take(&mut self.told);
        was_told.then(|| Word::Over(format!("the disk did not answer for {}", duration(nanos))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stall_is_told_once_and_once_more_when_it_is_over() {
        let mut patience = Patience::new();
        let start = patience.since;
        let mut said = Vec::new();
        for (rounds, seconds) in [(1, 1), (1, 4), (1, 5), (1, 9), (2, 13), (3, 14), (3, 17)] {
            let now = start + Duration::from_secs(seconds);
            said.extend(patience.look(rounds, now).map(|word| (seconds, word)));
        }
        let [(5, Word::Waiting(first)), (13, Word::Over(last))] = said.as_slice() else {
            panic!("{said:?}")
        };
        assert!(first.contains("not answered for 4"), "{first}");
        assert!(last.contains("for 12"), "{last}");
    }
}
