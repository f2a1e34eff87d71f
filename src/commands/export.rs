//! `bustape export`: tables of signals, and frames in the formats of other tools.

mod decoders;
mod frames;
pub(super) mod input;
mod report;
mod routes;
mod selection;
mod tables;
mod target;

use anyhow::Result;

use super::Ended;
use super::interrupt::Interrupt;
use crate::cli::export::{ExportArgs, Format};
use selection::Selection;

/// Runs the command.
pub fn run(args: &ExportArgs) -> Result<Ended> {
    let selection = Selection::of(args)?;
    let interrupt = Interrupt::watch()?;
    match args.format {
        Format::Parquet | Format::Csv | Format::Jsonl | Format::Influx => {
            tables::run(args, &selection, &interrupt)
        }
        _ => frames::run(args, &selection, &interrupt),
    }
}
