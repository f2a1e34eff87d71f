//! What a person is told while a recording is played.

use super::Player;
use crate::replay::lane::Lane;
use crate::replay::stage::Position;
use crate::sys::timing::steady_nanos;

/// Time between two looks of a person at the status.
const STATUS: u64 = 200_000_000;
/// A target that has taken nothing for so long is worth a word.
const STUCK: u64 = 1_000_000_000;

impl Player<'_, '_, '_> {
    /// Now and then tells how things go.
    pub(super) fn status(&mut self) {
        let now = steady_nanos();
        if now < self.next_status {
            return;
        }
        self.next_status = now + STATUS;
        let stuck = |lane: &&Lane| lane.stuck_since().is_some_and(|since| now > since + STUCK);
        match self.stage.lanes.iter().find(stuck) {
            Some(lane) if !self.warned => {
                let why = if lane.waits_for_nodes() {
                    "; a CAN bus without another node that acknowledges frames takes none"
                } else {
                    ""
                };
                self.audience.warn(&format!("{} has taken nothing for 1 s{why}", lane.target));
                self.warned = true;
            }
            Some(_) => {}
            None => self.warned = false,
        }
        if self.audience.watches() {
            let latest = self.tallies.iter().map(|t| t.lateness.max()).max().unwrap_or(0);
            let timed = self.tallies.iter().any(|t| t.lateness.count() > 0);
            self.audience.show(&Position {
                time: self.position,
                rate: self.schedule.rate(),
                paused: self.schedule.is_paused(),
                lap: self.feed.lap(),
                sent: self.sent(),
                late: timed.then_some(latest),
            });
        }
    }

    /// The recorded time of the latest frame, for a person.
    pub(super) fn place(&self) -> String {
        let start = self.stage.recording.span().map_or(self.position, |span| span.0);
        let after = self.position.since(start);
        format!(
            "+{}.{:03} s ({})",
            after / 1_000_000_000,
            after / 1_000_000 % 1000,
            crate::text::rfc3339(self.position)
        )
    }

    /// Frames sent.
    pub(super) fn sent(&self) -> u64 {
        self.tallies.iter().map(|tally| tally.sent).sum()
    }
}
