//! Logs of other tools, read as frames: one reader a format, one shape for what comes out.

pub mod asc;
pub mod blf;
pub mod candump;
pub mod csv;
pub mod dates;
pub mod digits;
pub mod expand;
pub mod format;
pub mod lines;
pub mod merge;
pub mod mf4;
pub mod names;
pub mod pcap;
pub mod raw;
pub mod trc;

mod little_endian;
mod spool;

use std::io;

use jiff::tz::TimeZone;

use crate::frame::{Frame, Stamped};

/// What a person says about logs that they do not say themselves.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the clock stood that wrote dates without a zone.
    pub zone: TimeZone,
    /// The line that raw bytes were on.
    pub line: Option<raw::Line>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { zone: TimeZone::UTC, line: None }
    }
}

/// A frame of a log, and the bus it was on: an index into [`LogReader::buses`].
#[derive(Clone, Debug, PartialEq)]
pub struct LogFrame {
    /// Index of the bus.
    pub bus: u16,
    /// What happened, and when.
    pub frame: Stamped<Frame>,
}

/// Reads one log from its start, whatever its format.
///
/// A damaged log is no error as long as something is intact: what is intact is given, the rest is
/// counted in [`LogReader::skipped`], and reading ends as usual.
pub trait LogReader {
    /// Appends the next frames, at most a few thousand, in the log's own order. `false` at the end.
    ///
    /// # Errors
    /// The log cannot be read any further.
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError>;

    /// The buses seen so far, as the log calls them (`can0`, `1`, ...).
    fn buses(&self) -> &[String];

    /// What could not be taken so far.
    fn skipped(&self) -> &Skipped;

    /// True when times are the log's own zero-based ones, not dates. Known once
    /// [`LogReader::read`] has given a frame.
    fn times_are_relative(&self) -> bool {
        false
    }

    /// Sentences for a person about the log as a whole. Complete at its end.
    fn notes(&self) -> &[String] {
        &[]
    }
}

/// Lines or objects of a log that should have been frames but could not be taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// How many.
    pub count: u64,
    /// The first [`Skipped::KEPT`]: the place (`line 12`, `byte 4711`, `object 33`), and why.
    pub first: Vec<(String, String)>,
}

impl Skipped {
    /// How many are kept with place and reason.
    pub const KEPT: usize = 10;

    /// Counts one, and keeps it if it is among the first. The texts are made only then.
    pub fn add(&mut self, place: impl FnOnce() -> String, reason: impl FnOnce() -> String) {
        self.count += 1;
        if self.first.len() < Self::KEPT {
            self.first.push((place(), reason()));
        }
    }
}

/// Why a log cannot be read, or not any further. Whoever opened it says which log it is.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file gives no more bytes.
    #[error("it cannot be read any further: {0}")]
    Read(#[from] io::Error),
    /// The bytes are not what they should be from the very start. A whole sentence part, such as
    /// `it is no PEAK trace: the first line has no $FILEVERSION`.
    #[error("{0}")]
    Format(String),
}
