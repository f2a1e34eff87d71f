//! Which of candump's formats a log has, by its beginning.

use super::line::{self, Time};
use super::printed;
use crate::frame::Timestamp;

/// How the times of a log are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// Each is a moment (`-t a`, `-t A`) or counts from the first line (`-t z`).
    Moments,
    /// Each counts from the line before (`-t d`).
    Differences,
    /// There are none.
    None,
}

impl Clock {
    /// The time of a line, after that of the `last` one.
    pub fn time(
        self,
        said: Option<Time>,
        last: &mut Timestamp,
        zone: &jiff::tz::TimeZone,
    ) -> Timestamp {
        match said {
            Some(Time::Relative(nanos)) if self == Self::Differences => *last = last.plus(nanos),
            Some(Time::Local(time)) => *last = crate::import::dates::in_zone(time, zone),
            Some(time) => *last = time.stamp(),
            None => {}
        }
        *last
    }
}

/// What the beginning of a log tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dialect {
    /// How times are meant.
    pub clock: Clock,
    /// Times do not tell the date.
    pub relative: bool,
}

/// Looks at the whole lines of a log's beginning.
pub fn of(head: &[u8]) -> Dialect {
    let (mut first, mut before, mut lines, mut back) = (None, 0, 0u32, 0u32);
    for time in head.split(|&byte| byte == b'\n').filter_map(time_of) {
        first.get_or_insert(time);
        let Some(Time::Relative(nanos)) = time else { continue };
        // Times that count from the first line grow; of differences about every second is smaller
        // than the one before.
        back += u32::from(lines > 0 && (nanos < before || nanos == before && nanos > 0));
        lines += 1;
        before = nanos;
    }
    match first.flatten() {
        None => Dialect { clock: Clock::None, relative: true },
        Some(Time::Relative(_)) if back > 0 && back * 8 > lines => {
            Dialect { clock: Clock::Differences, relative: true }
        }
        Some(time) => {
            Dialect { clock: Clock::Moments, relative: matches!(time, Time::Relative(_)) }
        }
    }
}

/// The time of a line that is a frame; the inner `None` if it has no time.
fn time_of(text: &[u8]) -> Option<Option<Time>> {
    let text = text.trim_ascii_end();
    if let Ok(line) = line::line(text) {
        return Some(line.time);
    }
    let (time, rest) = line::time_and_rest(text).ok()?;
    printed::serial(rest).map(|_| time)
}

/// True for a text with a line of candump's near its beginning.
pub fn recognises(head: &[u8]) -> bool {
    let lines = head.split(|&byte| byte == b'\n').take(200);
    lines.filter(|line| line.len() < 1000).any(|line| {
        let line = line.trim_ascii_end();
        // A bare frame (123#00) is taken where it is asked for, but is too little to go by.
        let found = line::line(line).is_ok_and(|line| line.bus.is_some());
        found
            || line.starts_with(b"DROPCOUNT: ")
            || time_of(line).is_some_and(|time| time.is_some())
    })
}
