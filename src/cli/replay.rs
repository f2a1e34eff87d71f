//! `bustape replay`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use crate::replay::schedule::Rate;
use crate::text::parse_duration;

/// What is said where a recorded dialogue ends, when it is asked again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Repeat {
    /// Begin again with the first recorded answer
    #[default]
    Cycle,
    /// Stay at the last one
    Last,
}

/// How long an answer takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Delay {
    /// As long as the recorded one took
    #[default]
    Recorded,
    /// No time
    None,
}

/// What becomes of a request that was never recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Unknown {
    /// Nothing is said
    #[default]
    Silent,
    /// The protocol's own error answer, which its definition must have
    Error,
}

const NOTES: &str = "\
Targets (BUS is a name in the recording; what is not mapped is not sent, there is no default):
  can0=vcan0                       SocketCAN interface
  can0=slcan:/dev/ttyACM0@500000   CAN adapter with the Lawicel ASCII protocol
  rect=pty:/tmp/ttyRECT            a new pseudo-terminal linked there
  rect=/dev/ttyUSB0,19200,8N1      serial port
  can0=trace:                      text on stdout: as candump -L prints it, serial bytes as hex

Replay sends on a real bus only when told so, each time. vcan interfaces, pty: and trace: are virtual;
every other target has to be repeated with --transmit-on, and confirmed on the terminal or by --yes.
Otherwise the exit status is 4 and nothing is sent.

On a terminal: space pause, . step, left/right 5 s, +/- rate, m mark, q quit.
Commands for --control, one a line: pause, resume, toggle, step [N], seek TIME, forward TIME,
back TIME, rate X|max, mark [TEXT], status, quit";

/// Options of `bustape replay`.
#[derive(Debug, Args)]
#[command(after_help = NOTES)]
#[allow(clippy::struct_excessive_bools, reason = "each is an option of its own")]
pub struct ReplayArgs {
    /// Files, or folders; segments follow each other, recordings run side by side by their times
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Play this recorded bus to this target, see below
    #[arg(long, required = true, value_name = "BUS=ADDRESS")]
    pub to: Vec<String>,

    /// How fast: 0.1 to 100, or max for as fast as the targets take it
    #[arg(long, value_name = "X", default_value = "1", value_parser = Rate::parse)]
    pub rate: Rate,

    /// From this time on: RFC 3339, seconds since 1970, or +1m30s after the start of the recording
    #[arg(long, value_name = "TIME")]
    pub start: Option<String>,

    /// Up to this time
    #[arg(long, value_name = "TIME", conflicts_with = "duration")]
    pub end: Option<String>,

    /// Only so much recorded time, e.g. 500ms, 10s [default: to the end]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub duration: Option<Duration>,

    /// Play so many times, or forever
    #[arg(long = "loop", value_name = "N|forever", default_value = "1", value_parser = parse_laps)]
    pub laps: Laps,

    /// Stop after so many frames of all buses together (a serial piece counts as one)
    /// [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,

    /// Of this bus only CAN frames that pass candump filters: can0,123:7FF,~400:700
    #[arg(short, long = "filter", value_name = "BUS,FILTER...")]
    pub filters: Vec<String>,

    /// Only CAN frames of this message, by its name in the database of its bus (see --decode)
    /// [default: all]
    #[arg(long = "message", value_name = "[BUS:]NAME")]
    pub messages: Vec<String>,

    /// The database of a CAN bus, or the definition of a serial line: hmi-can, FILE.dbc,
    /// zhongheng-09, FILE.toml [default: what the recording carries]
    #[arg(long, value_name = "BUS=PROTOCOL")]
    pub decode: Vec<String>,

    /// Only what the recording host received (rx), or what it sent (tx); of a serial line what the
    /// device said (rx), or the host (tx) [default: both]
    #[arg(long, value_name = "[BUS:]rx|tx")]
    pub only: Vec<String>,

    /// Shorten longer pauses to this, e.g. 500ms [default: none]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub max_gap: Option<Duration>,

    /// Send frames of this identifier or message under another identifier (8 digits: 29 bits):
    /// can0:123=456; or show a bus under another name in trace: output: can0=battery
    /// [default: as recorded]
    #[arg(long, value_name = "BUS:OLD=NEW")]
    pub remap: Vec<String>,

    /// Spread serial bytes as a line of so many baud would: a number, or "baud" for the recorded
    /// line's own [default: each recorded piece at once]
    #[arg(long, value_name = "BAUD")]
    pub pace: Option<String>,

    /// Look at the clock instead of sleeping for the last 150 us before each frame: late by less
    /// than 1 us, for one processor's whole attention
    #[arg(long)]
    pub precise: bool,

    /// Begin paused, until told to resume
    #[arg(long)]
    pub paused: bool,

    /// Take commands from this FIFO, or stdin for "-", see below [default: keys of the terminal]
    #[arg(long, value_name = "FIFO|-")]
    pub control: Option<PathBuf>,

    /// Send on this real interface, adapter or port: its name as in --to [default: none]
    #[arg(long, value_name = "NAME")]
    pub transmit_on: Vec<String>,

    /// Do not ask before sending on real buses
    #[arg(long)]
    pub yes: bool,

    /// Say what would go where, and send nothing
    #[arg(long)]
    pub dry_run: bool,

    /// Listen to the targets (CAN interfaces and pty:) while playing and compare; exit status 1
    /// with the first difference
    #[arg(long, conflicts_with_all = ["answer", "dry_run"])]
    pub verify: bool,

    /// Do not play this bus, but answer on its target as the recorded device did [default: none]
    #[arg(long, value_name = "BUS")]
    pub answer: Vec<String>,

    /// Answers: what follows the last recorded one
    #[arg(long, value_enum, default_value_t, requires = "answer")]
    pub repeat: Repeat,

    /// Answers: how long they take
    #[arg(long, value_enum, default_value_t, requires = "answer")]
    pub delay: Delay,

    /// Answers: what becomes of requests that were never recorded
    #[arg(long, value_enum, default_value_t, requires = "answer")]
    pub unknown: Unknown,

    /// Print the report as one JSON object
    #[arg(long)]
    pub json: bool,
}

/// How often to play; `None` without end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Laps(pub Option<u64>);

fn parse_laps(text: &str) -> Result<Laps, String> {
    match (text, text.parse()) {
        ("forever", _) => Ok(Laps(None)),
        (_, Ok(laps @ 1..)) => Ok(Laps(Some(laps))),
        _ => Err(format!("\"{text}\" is no number of times; write 1, 2, ... or forever")),
    }
}
