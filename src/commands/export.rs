//! `bustape export`: tables of signals, and frames in the formats of other tools.

mod beside;
mod can_rows;
mod decoders;
mod frame_table;
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
use crate::cli::export::{ExportArgs, Format, Shape};
use selection::Selection;

/// Runs the command.
pub fn run(args: &ExportArgs) -> Result<Ended> {
    let selection = Selection::of(args)?;
    let interrupt = Interrupt::watch()?;
    match args.format {
        Format::Parquet | Format::Csv | Format::Jsonl | Format::Influx => {
            target::check(args)?;
            match args.shape {
                Shape::Frames => frame_table::run(args, &selection, &interrupt),
                _ => tables::run(args, &selection, &interrupt),
            }
        }
        _ => frames::run(args, &selection, &interrupt),
    }
}
