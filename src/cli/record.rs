//! `bustape record`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::parse_nonzero_duration;
use crate::record::{Align, WhenFull};
use crate::recording::writer::Layout;
use crate::text::{parse_duration, parse_size};

/// Addresses, for the help of every command that takes them.
const ADDRESSES: &str = "\
Addresses ([NAME=]ADDRESS; without a name the last part of the address is the name):
  can0, vcan0                      SocketCAN interface
  can0@500000, can0@500000/2000000 set to this bit rate (CAN FD: /data bit rate) when permitted,
                                   else checked
  can0,123:7FF,~400:700            only what passes these filters, in candump's syntax: ID:MASK,
                                   ~ID:MASK not these, #ERRORMASK, j to join them; in the kernel
  /dev/ttyUSB0,19200,8N1           serial port, receive only; then rtscts, xonxoff, lowlatency
  tap:/dev/ttyUSB0+/dev/ttyUSB1,19200,8N1
                                   two ports on the two lines of a link: the first hears the
                                   device (rx), the second the host (tx)
  bridge:/dev/ttyUSB0,19200,8N1@PATH
                                   a pty at PATH for the application, the real port behind it
  pty:PATH                         a new pseudo-terminal linked at PATH
  slcan:/dev/ttyACM0@500000        CAN adapter with the Lawicel ASCII protocol
  sim:hmi-can, sim:zhongheng-09    simulated devices; options with commas: seed=N, time-scale=X, and
                                   the faults that \"bustape simulate\" has, as in
                                   sim:zhongheng-09,seed=7,bad-crc=0.01

PROTOCOL:
  hmi-can, zhongheng-09            built in
  FILE.dbc                         messages of a CAN bus; FILE.dbc:j1939 to recognise 29-bit
                                   identifiers by their J1939 parameter group number
  FILE.toml                        a protocol of docs/protocols.md or docs/protocols-serial.md;
                                   settings behind a colon: zhongheng-09:byte_order=little";

/// What `bustape record` does about buses that are not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Missing {
    /// End with an error, before anything is recorded
    #[default]
    Fail,
    /// Record the others, and this one as soon as it is there; until then it has a gap
    Wait,
}

/// Options of `bustape record`.
#[allow(clippy::struct_excessive_bools, reason = "each is a switch of the command line")]
#[derive(Debug, Args)]
#[command(after_help = ADDRESSES)]
#[command(group(clap::ArgGroup::new("target").args(["output", "dir"])))]
pub struct RecordArgs {
    /// What to record, see below [default: as configured]
    #[arg(value_name = "BUS")]
    pub buses: Vec<String>,

    /// Write what the frames of this bus mean as decoded channels, too; once for each bus
    /// [default: not decoded]
    #[arg(long, value_name = "BUS=PROTOCOL")]
    pub decode: Vec<String>,

    /// Record into this file (FILE.part until it is finished); an existing file is never
    /// overwritten. For days use --dir: the index of one long file takes some 40 MiB of memory a
    /// day
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,

    /// Record into this folder, as NAME_s0001_0001_20261122T031500Z.mcap: number of the recording,
    /// number of the segment, time of its start in UTC
    #[arg(short, long, value_name = "DIR")]
    pub dir: Option<PathBuf>,

    /// First part of the file names in DIR
    #[arg(long, default_value = "bustape", value_parser = file_name_part)]
    pub name: String,

    /// How CAN frames stand in the file
    #[arg(long, value_enum, default_value_t)]
    pub layout: Layout,

    /// Stop after this time, e.g. 90s, 10m, 8h [default: record until stopped]
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    pub duration: Option<Duration>,

    /// Stop after this many frames of all buses together (a serial read counts as one) [default:
    /// record until stopped]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub count: Option<u64>,

    /// Begin a new file when this one has about this size, e.g. 512MiB [default: 1GiB with --dir,
    /// none with --output]
    #[arg(long, value_name = "SIZE", value_parser = parse_split_size)]
    pub split_size: Option<u64>,

    /// Begin a new file after this time, e.g. 1h [default: 1h with --dir, none with --output]
    #[arg(long, value_name = "TIME", value_parser = parse_nonzero_duration)]
    pub split_time: Option<Duration>,

    /// Begin a new file at each full hour or day of UTC, instead of --split-time [default: none].
    /// SIGUSR1 begins one at once
    #[arg(long, value_name = "WHEN", value_enum, conflicts_with = "split_time")]
    pub split_at: Option<Align>,

    /// With --dir: delete the oldest segments of NAME beyond this size together, e.g. 20GiB; at
    /// least 4MiB and three times --split-size [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse_keep_size, conflicts_with = "output")]
    pub keep_size: Option<u64>,

    /// With --dir: delete segments of NAME that ended longer ago than this, e.g. 90s, 720h
    /// [default: no limit]
    #[arg(long, value_name = "TIME", value_parser = parse_nonzero_duration,
          conflicts_with = "output")]
    pub keep_time: Option<Duration>,

    /// With --dir: what stays free on the disk, at least 1MiB
    #[arg(long, value_name = "SIZE", default_value = "8MiB", value_parser = parse_min_free)]
    pub min_free: u64,

    /// With --dir: what to do when less than --min-free is free
    #[arg(long, value_name = "POLICY", value_enum, default_value_t, conflicts_with = "output")]
    pub when_full: WhenFull,

    /// Longest time until a frame is written to the file: what a kill of the recorder can cost
    #[arg(long, value_name = "TIME", default_value = "200ms", value_parser = parse_nonzero_duration)]
    pub chunk_time: Duration,

    /// Write a chunk when it has this size before compression, 4KiB to 16MiB
    #[arg(long, value_name = "SIZE", default_value = "1MiB", value_parser = parse_chunk_size)]
    pub chunk_size: usize,

    /// Time between syncs to the disk: what a power cut can cost
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = parse_duration)]
    pub sync: Duration,

    /// zstd level, 1 to 19; above 3 it costs much and saves little
    #[arg(long, value_name = "LEVEL", default_value_t = 3,
          value_parser = clap::value_parser!(i32).range(1..=19))]
    pub compression: i32,

    /// Memory for frames that wait for the disk; what does not fit is dropped and counted
    #[arg(long, value_name = "SIZE", default_value = "16MiB", value_parser = parse_queue)]
    pub queue: u64,

    /// Keep nothing but the windows that triggers with "before" or "after" ask for, in the folder
    /// windows of DIR (docs/triggers.md)
    #[arg(long, conflicts_with = "output")]
    pub windows_only: bool,

    /// Memory for what has to be there before a trigger fires, 256KiB to 4GiB; a CAN frame takes some
    /// 25 bytes, and what does not fit is missing in the window, which says so
    #[arg(long, value_name = "SIZE", default_value = "32MiB", value_parser = parse_window_memory)]
    pub window_memory: u64,

    /// What to do when a bus cannot be opened at the start
    #[arg(long, value_name = "WHAT", value_enum, default_value_t)]
    pub missing: Missing,

    /// CAN: receive buffer of each socket in the kernel
    #[arg(long, value_name = "SIZE", default_value = "4MiB", value_parser = parse_receive_buffer)]
    pub receive_buffer: u64,

    /// CAN: use the time stamps of the CAN hardware where its driver gives them
    #[arg(long)]
    pub hardware_timestamps: bool,

    /// Take what is not on the command line from this file in TOML, whose keys are called as these
    /// options [default: /etc/bustape/bustape.toml, then $XDG_CONFIG_HOME/bustape/bustape.toml]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Print what would be recorded and how, as a configuration file, and end
    #[arg(long)]
    pub print_config: bool,

    /// Print the totals as one JSON object
    #[arg(long)]
    pub json: bool,
}

fn parse_chunk_size(text: &str) -> Result<usize, String> {
    let size = parse_size(text)?;
    let range = 4 << 10..=16 << 20;
    match usize::try_from(size) {
        Ok(size) if range.contains(&size) => Ok(size),
        _ => Err(format!("{text} is not between 4KiB and 16MiB")),
    }
}

fn parse_split_size(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if size < 64 << 10 {
        return Err(format!("{text} is too small; the least is 64KiB"));
    }
    Ok(size)
}

fn parse_keep_size(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if size < 4 << 20 {
        return Err(format!("{text} is too small; the least is 4MiB"));
    }
    Ok(size)
}

fn parse_min_free(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if size < 1 << 20 {
        return Err(format!(
            "{text} is too small; the least is 1MiB, for the end of the open file"
        ));
    }
    Ok(size)
}

fn parse_queue(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if size < 1 << 10 {
        return Err(format!("{text} is too small; the least is 1KiB"));
    }
    Ok(size)
}

fn parse_window_memory(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if !(256 << 10..=4 << 30).contains(&size) {
        return Err(format!("{text} is not between 256KiB and 4GiB"));
    }
    Ok(size)
}

fn parse_receive_buffer(text: &str) -> Result<u64, String> {
    let size = parse_size(text)?;
    if size > 1 << 30 {
        return Err(format!("{text} is too large; the most is 1GiB"));
    }
    Ok(size)
}

fn file_name_part(text: &str) -> Result<String, String> {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if text.is_empty() || text.len() > 100 || text.starts_with('.') || !text.chars().all(fits) {
        return Err("use up to 100 letters, digits, '-', '_' and '.', no '.' in front".to_owned());
    }
    Ok(text.to_owned())
}
