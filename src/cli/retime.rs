//! `bustape retime`.

use std::path::PathBuf;

use clap::Args;

/// Options of `bustape retime`.
#[allow(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
#[derive(Debug, Args)]
#[command(after_help = "\
Times in a recording follow a steady clock, so intervals are true whatever was done to the wall clock;
but a machine that started without a clock has put all of them in the wrong year. The recording tells
both clocks once a second and at each step of the wall clock. All times are moved by one offset for
each run of the machine (boot): by default to what the wall clock said at the last; so the recordings
of a boot that ended before the clock was set are moved by what a later one of the same boot knew.
Windows around triggers belong to their boot too: give DIR and DIR/windows together.
Nothing but times changes. The originals stay as they are.")]
#[command(group(clap::ArgGroup::new("target").required(true).args(["output", "dir", "dry_run"])))]
#[command(group(clap::ArgGroup::new("by").args(["offset", "from_clock", "per_file"])))]
pub struct RetimeArgs {
    /// Files, or a folder; give all segments of a boot at once
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// The new file, of one FILE; an existing file is never overwritten
    #[arg(short, long, value_name = "OUT")]
    pub output: Option<PathBuf>,

    /// Put the new files into this folder, under their names, with the new time where the name has one
    #[arg(short, long, value_name = "DIR")]
    pub dir: Option<PathBuf>,

    /// Only say what would be done
    #[arg(long)]
    pub dry_run: bool,

    /// Move all times by this much, e.g. +1h30m, -2.5s, 20000d [default: by the clock]
    #[arg(long, value_name = "TIME", value_parser = parse_offset, allow_hyphen_values = true)]
    pub offset: Option<i64>,

    /// By what the recorded wall clock said at the last, which is the default
    #[arg(long)]
    pub from_clock: bool,

    /// Move each file to what the wall clock said at its own end, or next where it had not been set by
    /// then: for months in which the clock went wrong and was set again and again. Within a file
    /// intervals stay true; between files there are the steps that the clock made
    #[arg(long)]
    pub per_file: bool,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Nanoseconds, with a sign in front where it is not forward.
fn parse_offset(text: &str) -> Result<i64, String> {
    let (negative, amount) = match text.strip_prefix('-') {
        Some(amount) => (true, amount),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let days = amount.strip_suffix('d').and_then(|days| days.parse::<u64>().ok());
    let duration = match days {
        Some(days) => std::time::Duration::from_secs(days.saturating_mul(86_400)),
        None => crate::text::parse_duration(amount)?,
    };
    let nanos = i64::try_from(duration.as_nanos());
    let nanos = nanos.map_err(|_| format!("{text} is too far; the most is 292 years"))?;
    Ok(if negative { -nanos } else { nanos })
}
