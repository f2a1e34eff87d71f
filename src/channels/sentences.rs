//! What goes wrong on a link, as sentences for the log: at most one a second.

use std::io;

use super::stream::Out;
use crate::frame::{Level, Notice, Timestamp};

/// Shortest time between two sentences, nanoseconds.
const SECOND: u64 = 1_000_000_000;

/// Says what goes wrong, and counts what there is no time to say. Goes by the times of the frames,
/// so that it says the same of a recording later as it does live.
#[derive(Debug, Default)]
pub struct Sentences {
    last: Option<Timestamp>,
    /// How many were not said since, and the latest of them.
    unsaid: Option<(u64, Timestamp, String)>,
}

impl Sentences {
    /// Something went wrong at `time`.
    pub fn say(&mut self, time: Timestamp, text: String, out: &mut Out<'_>) -> io::Result<()> {
        if self.last.is_some_and(|last| time.since(last) < SECOND) {
            let count = self.unsaid.as_ref().map_or(0, |(count, ..)| *count);
            self.unsaid = Some((count + 1, time, text));
            return Ok(());
        }
        self.end(out)?;
        self.last = Some(time);
        warn(time, text, out)
    }

    /// Says how many were not said.
    pub fn end(&mut self, out: &mut Out<'_>) -> io::Result<()> {
        let Some((count, time, text)) = self.unsaid.take() else { return Ok(()) };
        let more = if count == 1 { String::new() } else { format!("{count} more errors, last: ") };
        warn(time, format!("{more}{text}"), out)
    }
}

fn warn(time: Timestamp, text: String, out: &mut Out<'_>) -> io::Result<()> {
    out.log(time, "link", &Notice { level: Level::Warning, text })
}
