//! `bustape keep`.

use std::path::PathBuf;

use clap::Args;

/// Options of `bustape keep`.
#[derive(Debug, Args)]
#[command(after_help = "\
A recorder with --keep-size, --keep-time or --when-full ring does not delete FILE, nor the segment
before it. The mark is a file FILE.keep beside it; it works on every file system, also while FILE is
being recorded, and goes along when both are copied.")]
pub struct KeepArgs {
    /// Segments that shall not be deleted
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,

    /// Take the marks away
    #[arg(long)]
    pub undo: bool,
}
