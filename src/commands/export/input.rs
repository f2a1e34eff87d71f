//! What an export reads: recordings, or logs of other tools.

use std::fs::File;
use std::io::{IsTerminal as _, Read as _};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use super::selection::Selection;
use crate::commands::interrupt::Interrupt;
use crate::commands::{Ended, UsageError, import, info, output};
use crate::frame::{Frame, Stamped, Timestamp};
use crate::import::merge::Merge;
use crate::import::{LogFrame, Settings, Skipped, format};
use crate::recording::reader::{Entry, Recording};
use crate::text::grouped;

/// Entries between two looks at what a person wants and is told.
const PACE: u32 = 1 << 14;

/// Gives everything on the wanted topics to `visit`, in time order, and says what could not
/// be read unless `quiet`.
pub fn each(
    recording: &Recording,
    range: RangeInclusive<Timestamp>,
    interrupt: &Interrupt,
    quiet: bool,
    wanted: impl Fn(&str) -> bool,
    mut visit: impl FnMut(Stamped<Entry>) -> Result<()>,
) -> Result<Ended> {
    let mut entries = recording.entries(range, wanted);
    let mut progress = Progress::new(entries.bytes_left());
    let mut count = 0_u32;
    while let Some(entry) = entries.next() {
        visit(entry)?;
        count = count.wrapping_add(1);
        if count.is_multiple_of(PACE) {
            interrupt.check()?;
            progress.show(entries.bytes_left());
        }
    }
    interrupt.check()?;
    progress.clear();
    if quiet {
        return Ok(Ended::Well);
    }
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

/// What the files are.
pub enum Source {
    /// Segments of a recording.
    Recording(Recording),
    /// Logs of other tools.
    Logs(Vec<PathBuf>),
}

impl Source {
    /// Opens recordings; logs are opened when their turn comes.
    pub fn open(files: &[PathBuf]) -> Result<Self> {
        let mut recordings = 0;
        for file in files {
            recordings += usize::from(is_recording(file)?);
        }
        match recordings {
            0 => Ok(Self::Logs(files.to_vec())),
            count if count == files.len() => Ok(Self::Recording(Recording::open(files)?)),
            _ => bail!(UsageError(
                "some of the files are recordings and some are logs of other tools; export them \
                 one by one"
                    .to_owned()
            )),
        }
    }
}

/// True for a folder, and for a file that begins as MCAP files do.
fn is_recording(path: &Path) -> Result<bool> {
    let unreadable = || format!("cannot read {}", path.display());
    if path.is_dir() {
        return Ok(true);
    }
    // Of a pipe, and stdin, nothing may be taken before its turn has come.
    if path.as_os_str() == "-" || path.metadata().is_ok_and(|about| !about.is_file()) {
        return Ok(false);
    }
    let mut head = Vec::new();
    let file = File::open(path).with_context(unreadable)?;
    file.take(mcap::MAGIC.len() as u64).read_to_end(&mut head).with_context(unreadable)?;
    Ok(head == mcap::MAGIC || path.extension().is_some_and(|ending| ending == "mcap"))
}

/// Gives each frame of the logs to `visit`, in time order, with the name of its bus and the
/// selected range of time; frames up to `margin` nanoseconds outside of it, too.
pub fn each_of_logs(
    logs: &[PathBuf],
    selection: &Selection,
    margin: u64,
    interrupt: &Interrupt,
    quiet: bool,
    mut visit: impl FnMut(&str, &Stamped<Frame>, &RangeInclusive<Timestamp>) -> Result<()>,
) -> Result<Ended> {
    let (mut readers, mut taken, mut total) = (Vec::new(), Vec::new(), 0);
    for path in logs {
        let opened = format::open(path, None, &Settings::default());
        let opened = opened.map_err(|error| import::cannot_import(path, &error))?;
        total += opened.size.unwrap_or(0);
        taken.push(opened.taken);
        readers.push(opened.reader);
    }
    let mut merge = Merge::new(readers, Timestamp(0), Box::new(|_, name| Ok(name.to_owned())));
    let mut progress = Progress::new(total);
    let (mut frames, mut range) = (Vec::new(), None);
    while merge.next(&mut frames).map_err(|error| import::failed(logs, error))? {
        let range: &RangeInclusive<Timestamp> = match &range {
            Some(range) => range,
            None => range.insert(selection.range(frames[0].frame.time)?),
        };
        let read = widened(range, margin);
        for LogFrame { bus, frame } in &frames {
            let name = merge.buses().get(usize::from(*bus)).map_or("?", String::as_str);
            if read.contains(&frame.time) {
                visit(name, frame, range)?;
            }
        }
        interrupt.check()?;
        if total > 0 {
            progress.show(total.saturating_sub(taken.iter().map(|taken| taken.get()).sum()));
        }
    }
    progress.clear();
    let mut ended = Ended::Well;
    for (path, source) in logs.iter().zip(merge.sources()).filter(|_| !quiet) {
        if say_skipped(path, source.skipped(), source.notes()) {
            ended = Ended::WithLoss;
        }
    }
    if merge.disordered() > 0 && !quiet {
        let count = grouped(merge.disordered());
        output::note(&format!("{count} frames stand behind later ones, as in the log"));
    }
    Ok(ended)
}

/// A range of time and `margin` nanoseconds on both sides.
pub fn widened(range: &RangeInclusive<Timestamp>, margin: u64) -> RangeInclusive<Timestamp> {
    let start = Timestamp(range.start().nanos().saturating_sub(margin));
    start..=Timestamp(range.end().nanos().saturating_add(margin))
}

/// Says what of a log could not be taken; true if there is anything.
pub fn say_skipped(path: &Path, skipped: &Skipped, notes: &[String]) -> bool {
    for (place, reason) in &skipped.first {
        output::warning(&format!("{}: {place}: {reason}", path.display()));
    }
    let more = skipped.count.saturating_sub(skipped.first.len() as u64);
    if more > 0 {
        output::warning(&format!("{}: {more} more could not be taken", path.display()));
    }
    for sentence in notes {
        output::note(&format!("{}: {sentence}", path.display()));
    }
    skipped.count > 0
}
