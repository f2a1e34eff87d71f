//! The books of a bus over all files of a recording.

use std::collections::BTreeMap;

use crate::recording::definition::Facts;
use crate::recording::reader::Recording;
use crate::recording::segment::Segment;

/// Metadata of windows around triggers.
pub const WINDOW: &str = "bustape.window";
/// Of a bus in a summary: some of what was received is not in these books.
const INCOMPLETE: &str = "incomplete";
/// What of a bus is in one file; all else in a summary counts from the session's start.
const IN_SEGMENT: &str = "segment_written";

/// The books of one bus.
pub struct Books {
    /// By their names in the summary, without the bus.
    pub totals: Facts,
    /// False if a file has none, because it was not finished: its part is missing.
    pub complete: bool,
}

impl Books {
    /// Adds up what the sessions of `recording` say of `bus`.
    pub fn of(recording: &Recording, bus: &str) -> Self {
        let about = format!("bustape.bus.{bus}");
        let mut sessions: BTreeMap<String, Vec<&Segment>> = BTreeMap::new();
        for segment in recording.segments.iter().filter(|s| s.metadata.contains_key(&about)) {
            let id = segment.fact("bustape.recording", "session_id").map(str::to_owned);
            // A file that does not tell stands for itself.
            let id = id.unwrap_or_else(|| segment.path.display().to_string());
            sessions.entry(id).or_default().push(segment);
        }
        let mut books = Self { totals: Facts::new(), complete: true };
        for segments in sessions.values() {
            books.add_session(segments, bus);
        }
        books.complete &= books.totals.remove(INCOMPLETE).is_none();
        books
    }

    /// The books of a session are those of its last file; windows have books of their own.
    fn add_session(&mut self, segments: &[&Segment], bus: &str) {
        let is_window = |segment: &&Segment| segment.metadata.contains_key(WINDOW);
        let (windows, files): (Vec<&Segment>, Vec<&Segment>) =
            segments.iter().copied().partition(is_window);
        let of_files = files.iter().rev().find_map(|segment| totals(segment, bus));
        let Some(mut own) = of_files else {
            self.complete &= files.iter().all(|segment| has_end(segment));
            for window in windows {
                self.complete &= has_end(window);
                add_up(&mut self.totals, totals(window, bus).unwrap_or_default());
            }
            return;
        };
        self.complete &= files.last().is_some_and(|last| has_end(last));
        own.remove(IN_SEGMENT);
        add_up(&mut self.totals, own);
        for segment in files {
            let written = totals(segment, bus).and_then(|mut own| own.remove(IN_SEGMENT));
            let written = written.map(|count| (IN_SEGMENT.to_owned(), count));
            add_up(&mut self.totals, written.into_iter().collect());
        }
    }

    /// The lines of `bus` in a summary.
    pub fn enter(self, bus: &str, summary: &mut Facts) {
        let old = format!("{bus}.");
        summary.retain(|key, _| !key.starts_with(&old));
        // Where there are no books at all nobody takes them for complete.
        let part = !self.complete && !self.totals.is_empty();
        let incomplete = part.then(|| (INCOMPLETE.to_owned(), "true".to_owned()));
        let lines = self.totals.into_iter().chain(incomplete);
        summary.extend(lines.map(|(key, value)| (format!("{bus}.{key}"), value)));
    }
}

/// False for a file that was not finished.
fn has_end(segment: &Segment) -> bool {
    segment.metadata.contains_key("bustape.summary")
}

/// What the end of a file says of `bus`.
fn totals(segment: &Segment, bus: &str) -> Option<Facts> {
    let prefix = format!("{bus}.");
    let summary = segment.metadata.get("bustape.summary")?.iter();
    let own: Facts = summary
        .filter_map(|(key, value)| Some((key.strip_prefix(&prefix)?.to_owned(), value.clone())))
        .collect();
    (!own.is_empty()).then_some(own)
}

/// Adds numbers; of all else the latest stays.
fn add_up(sum: &mut Facts, more: Facts) {
    for (key, value) in more {
        let numbers = sum.get(&key).and_then(|old| old.parse::<u64>().ok()).zip(value.parse().ok());
        let value = numbers.map_or(value, |(old, new): (u64, u64)| (old + new).to_string());
        sum.insert(key, value);
    }
}
