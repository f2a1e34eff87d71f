//! `bustape completions` and `bustape man`: for those who make packages.

use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;

/// Options of `bustape completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// For this shell; the script goes to stdout
    #[arg(value_enum, value_name = "SHELL")]
    pub shell: Shell,
}

/// Options of `bustape man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Write bustape.1 and a page for each command into this folder, in the place of older ones
    #[arg(value_name = "DIR")]
    pub dir: PathBuf,
}
