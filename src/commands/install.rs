//! `bustape completions` and `bustape man`, from the definitions of the command line.

use std::io::Write as _;

use anyhow::{Context as _, Result};
use clap::CommandFactory as _;

use super::{Ended, output};
use crate::cli::{Cli, CompletionsArgs, ManArgs};

/// Prints a completion script.
pub fn completions(args: &CompletionsArgs) -> Result<Ended> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "bustape", &mut script);
    let mut out = output::stdout();
    out.write_all(&script)?;
    out.flush()?;
    Ok(Ended::Well)
}

/// Writes the manual pages.
pub fn man(args: &ManArgs) -> Result<Ended> {
    let dir = args.dir.display();
    std::fs::create_dir_all(&args.dir)
        .with_context(|| format!("cannot create the folder {dir}"))?;
    clap_mangen::generate_to(Cli::command(), &args.dir)
        .with_context(|| format!("cannot write the manual pages into {dir}"))?;
    Ok(Ended::Well)
}
