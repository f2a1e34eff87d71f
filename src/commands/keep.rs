//! `bustape keep`: marks segments that a recorder must not delete.

use std::fs::OpenOptions;
use std::io::ErrorKind;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use anyhow::{Context as _, Result, bail};

use super::{Ended, output};
use crate::cli::KeepArgs;
use crate::record::keep_mark;

/// Runs the command.
pub fn run(args: &KeepArgs) -> Result<Ended> {
    for file in &args.files {
        let mark = keep_mark(file);
        // A mark that has outlived its file can still be taken away.
        let is_known = file.is_file() || (args.undo && mark.exists());
        if !is_known {
            let shall = if args.undo { "need not be kept any more" } else { "shall be kept" };
            bail!("there is no file {}; name the segments that {shall}", file.display());
        }
        if args.undo {
            unmark(&mark)?;
        } else {
            set(&mark)?;
        }
        let kept = if args.undo { "may be deleted again" } else { "is kept" };
        output::note(&format!("{} {kept}", file.display()));
    }
    Ok(Ended::Well)
}

fn set(mark: &Path) -> Result<()> {
    match OpenOptions::new().write(true).create_new(true).mode(0o640).open(mark) {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            Err(error).with_context(|| format!("cannot create {}", mark.display()))
        }
        _ => Ok(()),
    }
}

fn unmark(mark: &Path) -> Result<()> {
    match std::fs::remove_file(mark) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", mark.display()))
        }
        _ => Ok(()),
    }
}
