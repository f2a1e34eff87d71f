//! Options of `bustape export`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::parse_nonzero_duration;

/// What a file of `bustape export` is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Apache Parquet: a folder that DuckDB, pandas, polars, Spark and pyarrow read as one dataset
    Parquet,
    /// Comma-separated values (RFC 4180)
    Csv,
    /// One JSON object a line
    Jsonl,
    /// InfluxDB line protocol
    Influx,
    /// Frames: the log of `candump -l`, which canplayer replays
    Candump,
    /// Frames: Vector ASC
    Asc,
    /// Frames: Vector BLF
    Blf,
    /// Frames: PEAK TRC 2.1
    Trc,
    /// Frames: ASAM MDF 4 with bus logging
    Mf4,
    /// Frames and serial bytes: pcapng for Wireshark
    Pcapng,
    /// Frames: CSV with a column for each property
    FramesCsv,
    /// Frames: CSV with the columns of python-can
    PythonCanCsv,
    /// Serial bytes: hexadecimal text with times
    Hex,
    /// Serial bytes as they are: OUT becomes NAME.BUS.rx.END and NAME.BUS.tx.END
    Raw,
}

/// What stands in a row of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Shape {
    /// A table for each message, a row for each time it was seen, a column for each signal
    #[default]
    Message,
    /// One table, a row for each value: time, bus, message, signal, value, label, unit
    Long,
    /// One table, a row for each step of --every, a column for each signal of all messages
    Wide,
    /// One table, a row for each raw frame: time, bus, id, flags, dlc, data
    Frames,
}

/// What `--shape wide` writes for a signal that was not seen in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Fill {
    /// The value before, once there is one
    #[default]
    Hold,
    /// Nothing, and the mean of its values in a step where there are several
    Mean,
    /// Nothing
    None,
}

/// When an export begins its next files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SplitBy {
    /// At midnight, UTC
    Day,
    /// At each full hour
    Hour,
}

/// How times stand in text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum TimeText {
    /// RFC 3339 with nanoseconds, UTC: 2026-11-22T03:15:00.123456789Z
    #[default]
    Iso,
    /// Seconds since 1970, nine decimals
    Epoch,
}

/// The decimal mark of text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Decimal {
    /// 1.5
    #[default]
    Point,
    /// 1,5
    Comma,
}

/// Options of `bustape export`.
#[derive(Debug, Args)]
#[command(after_help = "\
FILE is a recording (several segments, or a folder, are one recording) or a log of another tool.
PROTOCOL is hmi-can or zhongheng-09 (built in), a .dbc file, FILE.dbc:j1939, or a .toml file;
without BUS= it is for every CAN bus, or every serial line.
Examples:
  bustape export trip.mcap --decode can0=car.dbc --format parquet -o trip
  bustape export can.log --decode car.dbc --format csv --shape wide --every 100ms -o trip.csv
  bustape export trip.mcap --decode car.dbc --format influx -o - --message 'Engine*'
Exit status: 3 when something of the input could not be read, or frames of a decoded bus not
expressed; frames that the protocol does not know are counted and said.")]
pub struct ExportArgs {
    /// Recordings, a folder of them, or logs of other tools
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// What to write
    #[arg(long, value_enum)]
    pub format: Format,

    /// The new file, or the new folder where there are several files (NAME.part until it is
    /// finished); - is stdout
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,

    /// Replace OUT if it is there
    #[arg(long)]
    pub force: bool,

    /// Decode the raw frames or bytes of this bus [default: take the decoded channels of the
    /// recording]
    #[arg(long, value_name = "[BUS=]PROTOCOL")]
    pub decode: Vec<String>,

    /// What a row is
    #[arg(long, value_enum, default_value_t)]
    pub shape: Shape,

    /// --shape wide: time from row to row, e.g. 100ms, 1s
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = parse_nonzero_duration)]
    pub every: Duration,

    /// --shape wide: what stands where nothing was seen
    #[arg(long, value_enum, default_value_t)]
    pub fill: Fill,

    /// Only these buses; * stands for any text
    #[arg(long = "bus", value_name = "NAME", value_delimiter = ',')]
    pub buses: Vec<String>,

    /// Frames: only this bus, and of it only CAN frames that pass candump filters:
    /// can0,123:7FF,~400:700
    #[arg(short, long = "filter", value_name = "BUS[,FILTER]...")]
    pub filters: Vec<String>,

    /// Only these messages; * stands for any text
    #[arg(long = "message", value_name = "NAME", value_delimiter = ',')]
    pub messages: Vec<String>,

    /// Only these signals; * stands for any text
    #[arg(long = "signal", value_name = "NAME", value_delimiter = ',')]
    pub signals: Vec<String>,

    /// From this time on: RFC 3339, seconds since 1970, or +1m30s after the start
    #[arg(long, value_name = "TIME")]
    pub start: Option<String>,

    /// Up to this time
    #[arg(long, value_name = "TIME")]
    pub end: Option<String>,

    /// Begin new files at each day or hour (UTC) [default: never]
    #[arg(long, value_enum, value_name = "PERIOD")]
    pub split: Option<SplitBy>,

    /// csv, jsonl: how times are written
    #[arg(long, value_enum, default_value_t)]
    pub time: TimeText,

    /// csv: units in the names of columns, as "Speed [km/h]"
    #[arg(long)]
    pub units: bool,

    /// csv: what separates the columns: one character, or tab [default: , or ; with --decimal
    /// comma]
    #[arg(long, value_name = "CHARACTER", value_parser = parse_separator)]
    pub separator: Option<char>,

    /// csv: the decimal mark of numbers
    #[arg(long, value_enum, default_value_t)]
    pub decimal: Decimal,

    /// parquet: zstd level, 1 to 19
    #[arg(long, value_name = "LEVEL", default_value_t = 3,
          value_parser = clap::value_parser!(i32).range(1..=19))]
    pub compression: i32,

    /// Print the totals as one JSON object on stdout (on stderr with -o -)
    #[arg(long)]
    pub json: bool,
}

fn parse_separator(text: &str) -> Result<char, String> {
    let mut characters = text.chars();
    match (text, characters.next(), characters.next()) {
        ("tab" | "\\t", ..) => Ok('\t'),
        (_, Some(c), None) if c.is_ascii_punctuation() && !"\"+-.'@=".contains(c) => Ok(c),
        (_, Some('\t'), None) => Ok('\t'),
        _ => Err("give one of , ; | or another mark that no number has, or tab".to_owned()),
    }
}
