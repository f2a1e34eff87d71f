//! Options of `bustape import`.

use std::path::PathBuf;

use clap::Args;

use crate::import::format::Format;
use crate::recording::writer::Layout;

/// Options of `bustape import`.
#[derive(Debug, Args)]
#[command(after_help = "\
The format of a log is found by its content; it may be compressed (gzip, Zstandard). Buses keep the
names that the log has for them (can0; 1 where channels are numbered), and those of the same name in
several logs become one.
Examples:
  bustape import candump.log -o trip.mcap
  bustape import can.asc gps.log.gz --bus 1=powertrain --bus 2=body -o trip.mcap
  bustape import trace.trc --start 2026-11-22T03:15:00Z -o trace.mcap
  bustape import line.bin --format raw --baud 19200,8N1 --bus rect:rx -o line.mcap
Exit status: 3 when a line or object of a log could not be taken; each is counted, and the first
ones are shown.")]
pub struct ImportArgs {
    /// Logs of other tools; - is stdin
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,

    /// The new recording; an existing file is never overwritten
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// Rename buses: TO for the only bus of the logs, or FROM=TO. With --format raw the name of the
    /// line, with :tx for bytes that the host sent; one for each LOG, or one for all
    /// [default: the names in the logs]
    #[arg(long = "bus", value_name = "TO|FROM=TO")]
    pub buses: Vec<String>,

    /// How CAN frames stand in the file
    #[arg(long, value_enum, default_value_t)]
    pub layout: Layout,

    /// When logs begin that do not say so: RFC 3339, or seconds since 1970 [default: 1970]
    #[arg(long, value_name = "TIME")]
    pub start: Option<String>,

    /// Where the clock stood that wrote dates without a zone, such as Europe/Berlin
    #[arg(long, value_name = "ZONE", default_value = "UTC")]
    pub zone: String,

    /// The format of the logs [default: found by their content]
    #[arg(long, value_enum)]
    pub format: Option<Format>,

    /// --format raw: how fast the bytes came, such as 19200 or 19200,8E1, in bits per second [default: none]
    #[arg(long, value_name = "BAUD[,8N1]")]
    pub baud: Option<String>,

    /// zstd level, 1 to 19
    #[arg(long, value_name = "LEVEL", default_value_t = 3,
          value_parser = clap::value_parser!(i32).range(1..=19))]
    pub compression: i32,

    /// Print what was imported as one JSON object
    #[arg(long)]
    pub json: bool,
}
