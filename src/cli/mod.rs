//! Every command and option, defined and documented once.

pub mod decode;
pub mod export;
pub mod import;
pub mod install;
pub mod keep;
pub mod mark;
pub mod protocols;
pub mod record;
pub mod recover;
pub mod replay;
pub mod retime;
pub mod simulate;

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};

pub use self::decode::DecodeArgs;
pub use self::export::ExportArgs;
pub use self::import::ImportArgs;
pub use self::install::{CompletionsArgs, ManArgs};
pub use self::keep::KeepArgs;
pub use self::mark::{LONGEST_MARK, MarkArgs, StatusArgs};
pub use self::record::{Missing, RecordArgs};
pub use self::recover::RecoverArgs;
pub use self::replay::ReplayArgs;
pub use self::retime::RetimeArgs;
use crate::recording::writer::Layout;
use crate::text::parse_duration;

/// A flight recorder for field buses.
///
/// Captures CAN and serial traffic into MCAP files that any MCAP reader and Foxglove open, and
/// says what it lost.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const EXIT_CODES: &str = "\
Results go to stdout, everything else to stderr.
Exit status: 0 ok, 1 failed, 2 wrong usage, 3 finished but something was lost or skipped,
4 refused to transmit.";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Record buses into MCAP files
    Record(Box<RecordArgs>),
    /// Show what is in a recording
    Info(InfoArgs),
    /// Print the frames of a recording
    Cat(CatArgs),
    /// Rewrite a recording: other layout, several segments into one, an unfinished file into a
    /// finished one
    Convert(ConvertArgs),
    /// Play a recording onto buses, or answer like the device in it
    Replay(Box<ReplayArgs>),
    /// Make a sound recording of a damaged or unfinished one
    Recover(RecoverArgs),
    /// Put the times of a recording right, where the wall clock was set late
    Retime(RetimeArgs),
    /// Mark segments that a recorder must not delete
    Keep(KeepArgs),
    /// Make tables of signals, or logs for other tools
    Export(Box<ExportArgs>),
    /// Make a recording of logs of other tools
    Import(Box<ImportArgs>),
    /// Put an event into the running recording
    Mark(MarkArgs),
    /// Show what the recorders of this machine are doing
    Status(StatusArgs),
    /// Add decoded channels to a recording
    Decode(DecodeArgs),
    /// List the CAN interfaces and serial ports of this machine
    Ports(PortsArgs),
    /// Record a simulated power station, without any hardware
    Demo(DemoArgs),
    /// Decode frames of the command line or of stdin
    Explain(ExplainArgs),
    /// Look at the files that decoding goes by
    Protocols(ProtocolsArgs),
    /// Print a completion script for a shell
    #[command(hide = true)]
    Completions(CompletionsArgs),
    /// Write the manual pages
    #[command(hide = true)]
    Man(ManArgs),
    /// Simulate a device for other programs to talk to
    Simulate(simulate::SimulateArgs),
}

/// Options of `bustape info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Files, or a folder; several segments are shown as one recording
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// How `bustape cat` prints times, as candump does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum TimeStyle {
    /// Seconds since 1970 (UTC)
    #[default]
    #[value(name = "a")]
    Absolute,
    /// Seconds since the line before
    #[value(name = "d")]
    Delta,
    /// Seconds since the first line
    #[value(name = "z")]
    Zero,
    /// Date and time of day (UTC)
    #[value(name = "A")]
    Date,
}

/// Options of `bustape cat`.
#[derive(Debug, Args)]
#[command(after_help = "\
CAN frames are printed as candump -L does, serial bytes as hex and ASCII:
  (1782097200.123456) can0 123#DEADBEEF
  (1782097200.130112) rect rx  7E 00 01 85 02 00 13 5B 1C          |~........|")]
pub struct CatArgs {
    /// Files, or a folder; several segments are printed as one recording
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Style of the times
    #[arg(short, value_name = "STYLE", value_enum, default_value_t)]
    pub time: TimeStyle,

    /// Times to the nanosecond instead of the microsecond
    #[arg(short = 'N', long)]
    pub nanoseconds: bool,

    /// Append R or T: received, or sent by the recording host
    #[arg(short = 'x', long)]
    pub direction: bool,

    /// Print one JSON object a line
    #[arg(long)]
    pub json: bool,

    /// Only these topics; * stands for any text. Topics other than raw ones are printed as JSON
    #[arg(long, value_name = "TOPIC", value_delimiter = ',')]
    pub topics: Vec<String>,

    /// From this time on: RFC 3339, seconds since 1970, or +1m30s after the start
    #[arg(long, value_name = "TIME")]
    pub start: Option<String>,

    /// Up to this time
    #[arg(long, value_name = "TIME")]
    pub end: Option<String>,

    /// Only this bus, and of it only CAN frames that pass candump filters: can0,123:7FF,~400:700
    #[arg(short, long = "filter", value_name = "BUS[,FILTER]...")]
    pub filters: Vec<String>,
}

/// Options of `bustape convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Files, or a folder; several segments become one file
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// The new file; an existing file is never overwritten
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// How CAN frames stand in the new file [default: as in the first FILE]
    #[arg(long, value_enum)]
    pub layout: Option<Layout>,

    /// zstd level, 1 to 19
    #[arg(long, value_name = "LEVEL", default_value_t = 3,
          value_parser = clap::value_parser!(i32).range(1..=19))]
    pub compression: i32,
}

/// Options of `bustape ports`.
#[derive(Debug, Args)]
pub struct PortsArgs {
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Options of `bustape demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Record into this folder
    #[arg(short, long, value_name = "DIR", default_value = "bustape-demo")]
    pub dir: PathBuf,

    /// Record for this long; a day of the station passes in a minute
    #[arg(long, value_name = "TIME", default_value = "15s", value_parser = parse_nonzero_duration)]
    pub duration: Duration,

    /// How CAN frames stand in the file
    #[arg(long, value_enum, default_value_t)]
    pub layout: Layout,
}

/// Options of `bustape explain`.
#[derive(Debug, Args)]
#[command(after_help = "\
PROTOCOL is hmi-can (built in), a DBC file, FILE.dbc:j1939 to recognise 29-bit identifiers by their
J1939 parameter group number, or a TOML file that names its DBC file (docs/protocols.md). FRAME is written as candump does, and so are the lines of stdin:
  123#DEADBEEF                       11-bit identifier
  00030002#35DBA94107530AC3          29-bit identifier
  123##1DEADBEEF, 123#R              CAN FD, remote frame
  (1782097200.123456) can0 123#DEADBEEF
Signals that are not in a frame (multiplexed away, or beyond its end) are absent, never 0. Messages of
several frames follow the frame that ends them.")]
pub struct ExplainArgs {
    /// Decode with this protocol: hmi-can, FILE.dbc, FILE.dbc:j1939 or FILE.toml for CAN;
    /// zhongheng-09 or FILE.toml for serial lines, settings behind a colon
    /// (zhongheng-09:byte_order=little)
    #[arg(long, value_name = "PROTOCOL")]
    pub decode: String,

    /// Read this file, or stdin for "-": lines of candump, or the raw bytes of a serial line
    #[arg(long, value_name = "FILE", conflicts_with = "frames")]
    pub input: Option<PathBuf>,

    /// Print one JSON object a line
    #[arg(long)]
    pub json: bool,

    /// CAN frames as candump prints them, or hex digits of a serial line [default: read from stdin]
    #[arg(value_name = "FRAME|HEX")]
    pub frames: Vec<String>,
}

/// Options of `bustape protocols`.
#[derive(Debug, Args)]
pub struct ProtocolsArgs {
    /// What to do
    #[command(subcommand)]
    pub command: ProtocolsCommand,
}

/// What `bustape protocols` does.
#[derive(Debug, Subcommand)]
pub enum ProtocolsCommand {
    /// Say what a protocol file defines and what in it is odd
    #[command(after_help = "\
Exit status: 0 all of the file was loaded (oddities may have been read in a way that is said), 1 it
cannot be used, 3 something in it could not be loaded.")]
    Check(CheckArgs),
    /// List what is built in
    List(protocols::ListArgs),
    /// Show messages and signals, or commands and fields
    Show(protocols::ShowArgs),
    /// Print a layout for Foxglove or Lichtblick
    Layout(protocols::LayoutArgs),
}

/// Options of `bustape protocols check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// A DBC file, a definition in TOML, or a built-in name (hmi-can, zhongheng-09)
    #[arg(value_name = "PROTOCOL")]
    pub protocol: String,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

fn parse_nonzero_duration(text: &str) -> Result<Duration, String> {
    let duration = parse_duration(text)?;
    if duration < Duration::from_millis(1) {
        return Err(format!("{text} is too short; the least is 1ms"));
    }
    Ok(duration)
}
