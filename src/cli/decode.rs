//! Options of `bustape decode`.

use std::path::PathBuf;

use clap::Args;

/// How PROTOCOL is written, for the help.
const PROTOCOLS: &str = "\
PROTOCOL:
  hmi-can, zhongheng-09            built in
  FILE.dbc                         messages of a CAN bus; FILE.dbc:j1939 to recognise 29-bit
                                   identifiers by their J1939 parameter group number
  FILE.toml                        a protocol of docs/protocols.md or docs/protocols-serial.md;
                                   settings behind a colon: zhongheng-09:byte_order=little";

/// Options of `bustape decode`.
#[derive(Debug, Args)]
#[command(after_help = PROTOCOLS)]
pub struct DecodeArgs {
    /// Files, or a folder; several segments become one file
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Decode this bus of the recording with this protocol; once for each bus. Decoded channels
    /// that the bus has already are replaced
    #[arg(long, required = true, value_name = "BUS=PROTOCOL")]
    pub decode: Vec<String>,

    /// The new file, with everything of the original in it; an existing file is never overwritten
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// zstd level, 1 to 19
    #[arg(long, value_name = "LEVEL", default_value_t = 3,
          value_parser = clap::value_parser!(i32).range(1..=19))]
    pub compression: i32,

    /// Print what was decoded as one JSON object
    #[arg(long)]
    pub json: bool,
}
