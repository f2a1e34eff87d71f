//! The recorders that run on this machine: where they say what they do, and listen for marks.
//!
//! Each has two files in a folder of the memory: `PID.json`, replaced once a second, and the socket
//! `PID.sock` (mode 0600). Nothing listens on a network.

use std::os::unix::fs::DirBuilderExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, Result};
use serde_json::Value;

/// Where systemd units and root put them.
const OF_SYSTEM: &str = "/run/bustape";
/// A status file is some KiB.
const MAX_FILE: u64 = 1 << 20;

/// A recorder's status, as it was written last.
pub struct Running {
    /// What it is called.
    pub name: String,
    /// Its process.
    pub pid: u64,
    /// The whole status.
    pub status: Value,
    /// How long ago it was written.
    pub age: Duration,
    /// Where it takes marks.
    pub socket: PathBuf,
}

/// Makes the folder of this user's recorders.
pub fn own_folder() -> Result<PathBuf> {
    let folder = given("RUNTIME_DIRECTORY").or_else(|| {
        let root = nix::unistd::geteuid().is_root();
        if root { Some(OF_SYSTEM.into()) } else { of_user() }
    });
    let folder = folder.context("neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set")?;
    let made = std::fs::DirBuilder::new().recursive(true).mode(0o755).create(&folder);
    made.with_context(|| format!("cannot create the folder {}", folder.display()))?;
    Ok(folder)
}

/// Status file and socket of process `pid`.
pub fn files(folder: &Path, pid: u32) -> (PathBuf, PathBuf) {
    (folder.join(format!("{pid}.json")), folder.join(format!("{pid}.sock")))
}

/// All that run, by name.
pub fn all() -> Vec<Running> {
    let folders: Vec<PathBuf> = match given("RUNTIME_DIRECTORY") {
        Some(folder) => vec![folder],
        None => [Some(OF_SYSTEM.into()), of_user()].into_iter().flatten().collect(),
    };
    let entries = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten();
    let mut all: Vec<_> = entries.flatten().filter_map(|entry| one(&entry.path())).collect();
    all.sort_by(|a, b| (&a.name, a.pid).cmp(&(&b.name, b.pid)));
    all
}

/// The sentence for a recorder (with this name) that is not there.
pub fn nobody(name: Option<&str>) -> String {
    match name {
        Some(name) => format!("no recorder with the name {name} is running for this user"),
        None => "no recorder is running, or none that this user can see".to_owned(),
    }
}

fn given(name: &str) -> Option<PathBuf> {
    // systemd separates several by colons.
    let folders = std::env::var(name).ok()?;
    folders.split(':').next().filter(|folder| !folder.is_empty()).map(PathBuf::from)
}

fn of_user() -> Option<PathBuf> {
    given("XDG_RUNTIME_DIR").map(|folder| folder.join("bustape"))
}

/// The recorder of a status file, if it still runs.
fn one(path: &Path) -> Option<Running> {
    let pid = path.file_name()?.to_str()?.strip_suffix(".json")?.parse().ok()?;
    let about = path.metadata().ok().filter(|about| about.is_file() && about.len() <= MAX_FILE)?;
    let status: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let socket = path.with_extension("sock");
    // One that was killed leaves its files, but nobody behind the socket.
    if let Err(error) = UnixStream::connect(&socket)
        && error.kind() != std::io::ErrorKind::PermissionDenied
    {
        return None;
    }
    let name = status["name"].as_str()?.to_owned();
    let age = about.modified().ok()?.elapsed().unwrap_or_default();
    Some(Running { name, pid, status, age, socket })
}
