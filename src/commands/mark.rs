//! `bustape mark`: an event for the running recording.

use std::io::{Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};

use super::running::{self, Running};
use super::{Ended, UsageError, output};
use crate::cli::MarkArgs;

/// A recorder answers at once.
const PATIENCE: Duration = Duration::from_secs(5);

/// Runs the command.
pub fn run(args: &MarkArgs) -> Result<Ended> {
    let recorder = chosen(running::all(), args.name.as_deref())?;
    let about =
        || format!("cannot reach the recorder {} (process {})", recorder.name, recorder.pid);
    let mut socket = UnixStream::connect(&recorder.socket).with_context(about)?;
    socket.set_read_timeout(Some(PATIENCE)).with_context(about)?;
    socket.write_all(args.text.as_bytes()).with_context(about)?;
    socket.shutdown(Shutdown::Write).with_context(about)?;
    let mut answer = String::new();
    socket.take(4096).read_to_string(&mut answer).with_context(about)?;
    if answer != TAKEN {
        bail!("{} has not taken the mark: {answer}", recorder.name);
    }
    output::note(&format!("marked in the recording {}", recorder.name));
    Ok(Ended::Well)
}

/// What the recorder answers.
pub const TAKEN: &str = "taken\n";

fn chosen(mut all: Vec<Running>, name: Option<&str>) -> Result<Running> {
    all.retain(|recorder| name.is_none_or(|name| recorder.name == name));
    let names = all.iter().map(|r| format!("{} (process {})", r.name, r.pid));
    let names = names.collect::<Vec<_>>().join(", ");
    match (all.pop(), all.is_empty(), name) {
        (Some(recorder), true, _) => Ok(recorder),
        (Some(_), false, _) => bail!(UsageError(format!(
            "several recorders are running: {names}; choose one with --name"
        ))),
        (None, ..) => bail!(running::nobody(name)),
    }
}
