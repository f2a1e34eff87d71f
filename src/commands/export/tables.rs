//! Tables.

use anyhow::Result;

use super::selection::Selection;
use crate::cli::export::ExportArgs;
use crate::commands::Ended;
use crate::commands::interrupt::Interrupt;
use crate::recording::reader::Recording;

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    let (origin, _) = recording.span().unwrap_or_default();
    super::input::each(&recording, selection.range(origin)?, interrupt, |_| true, |_| Ok(()))
}
