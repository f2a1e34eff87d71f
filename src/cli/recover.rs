//! `bustape recover`.

use std::path::PathBuf;

use clap::Args;

/// Options of `bustape recover`.
#[derive(Debug, Args)]
#[command(after_help = "\
Every intact message is kept, in its order; damage is passed over and told: which bytes, between which
times, how many messages where an index tells. Files of any MCAP writer are taken (chunks with zstd,
lz4 or no compression, or none at all). The original is never changed. The same file always gives the
same result, and a sound one comes out as it went in.
Exit status: 0 nothing was lost, 1 failed, 3 something was lost.")]
#[command(group(clap::ArgGroup::new("target").required(true).args(["output", "dir", "in_place"])))]
pub struct RecoverArgs {
    /// Files, or a folder with recordings
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// The sound copy of one FILE; an existing file is never overwritten
    #[arg(short, long, value_name = "OUT")]
    pub output: Option<PathBuf>,

    /// Put the sound copy of each FILE into this folder, under its name
    #[arg(short, long, value_name = "DIR")]
    pub dir: Option<PathBuf>,

    /// Give the sound copy the name of FILE (without .part), and set FILE aside as NAME.damaged; a
    /// sound file stays as it is
    #[arg(long)]
    pub in_place: bool,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}
