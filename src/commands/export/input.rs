//! What an export reads: recordings.

use std::io::IsTerminal as _;
use std::ops::RangeInclusive;

use anyhow::Result;

use crate::commands::interrupt::Interrupt;
use crate::commands::{Ended, info, output};
use crate::frame::{Stamped, Timestamp};
use crate::recording::reader::{Entry, Recording};

/// Entries between two looks at what a person wants and is told.
const PACE: u32 = 1 << 14;

/// Gives everything on the wanted topics to `visit`, in time order, and says what could not be read.
pub fn each(
    recording: &Recording,
    range: RangeInclusive<Timestamp>,
    interrupt: &Interrupt,
    wanted: impl Fn(&str) -> bool,
    mut visit: impl FnMut(&Stamped<Entry>) -> Result<()>,
) -> Result<Ended> {
    let mut entries = recording.entries(range, wanted);
    let mut progress = Progress::new(entries.bytes_left());
    let mut count = 0_u32;
    while let Some(entry) = entries.next() {
        visit(&entry)?;
        count = count.wrapping_add(1);
        if count.is_multiple_of(PACE) {
            interrupt.check()?;
            progress.show(entries.bytes_left());
        }
    }
    interrupt.check()?;
    progress.clear();
    let damage = entries.damage();
    for sentence in damage {
        output::warning(sentence);
    }
    for segment in recording.unfinished() {
        output::warning(&info::unfinished(segment));
    }
    let skipped = !damage.is_empty() || recording.unfinished().any(info::is_damaged);
    Ok(if skipped { Ended::WithLoss } else { Ended::Well })
}

/// How far it is, on a terminal only.
pub struct Progress {
    total: u64,
    percent: Option<u64>,
    on_terminal: bool,
}

impl Progress {
    /// `total` bytes are to be read.
    pub fn new(total: u64) -> Self {
        let on_terminal = std::io::stderr().is_terminal();
        Self { total: total.max(1), percent: None, on_terminal }
    }

    /// `left` bytes are still to be read.
    pub fn show(&mut self, left: u64) {
        let percent = 100 - (left.min(self.total) * 100 / self.total);
        if self.on_terminal && self.percent != Some(percent) {
            self.percent = Some(percent);
            anstream::eprint!("\r{percent:3} %\r");
        }
    }

    /// Makes room for other output.
    pub fn clear(&mut self) {
        if self.percent.take().is_some() {
            anstream::eprint!("\r     \r");
        }
    }
}
