//! The reference readers of `tests/lab`, in Python and TypeScript.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use serde_json::Value;

use super::process::{Ran, spawn};

/// The first line, which describes the file, and one line for each message.
pub struct Read {
    pub file: Value,
    pub messages: Vec<Value>,
}

impl Read {
    /// Messages of a topic.
    pub fn count(&self, topic: &str) -> u64 {
        self.file["counts"][topic].as_u64().unwrap_or(0)
    }
}

fn lab(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/lab").join(name)
}

/// The folder with the Python environment and the node packages. Afterwards can-utils and strace are
/// there, too.
pub fn peers() -> &'static Path {
    static PEERS: OnceLock<PathBuf> = OnceLock::new();
    PEERS.get_or_init(|| {
        let ran = spawn(Command::new(lab("peers"))).wait().expect(0);
        PathBuf::from(ran.out.trim())
    })
}

/// A Python with mcap, python-can and pyserial, to run `script` of this folder.
pub fn python(script: &str) -> Command {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/support");
    let mut command = Command::new(peers().join("venv/bin/python"));
    command.arg(here.join(script));
    command
}

/// Reads a finished file through its index with the Python library; any warning is an error.
pub fn python_reads(path: &Path) -> Read {
    read(Command::new(lab("read_mcap.py")).arg(path))
}

/// Reads a file from its start with the Python library, as far as it goes.
pub fn python_streams(path: &Path) -> Read {
    read(Command::new(lab("read_mcap.py")).arg("--stream").arg(path))
}

/// Reads a finished file through its index with the TypeScript library.
pub fn node_reads(path: &Path) -> Read {
    read(Command::new(lab("read_mcap.mjs")).arg(path))
}

fn read(command: &mut Command) -> Read {
    command.env("BUSTAPE_PEERS", peers());
    let mut owned = Command::new(command.get_program());
    owned.args(command.get_args()).env("BUSTAPE_PEERS", peers());
    let Ran { out, err, .. } = spawn(owned).wait().expect(0);
    assert_eq!(err, "", "a reader complains");
    let mut lines = out.lines().map(|line| serde_json::from_str(line).expect("JSON"));
    Read { file: lines.next().expect("a first line"), messages: lines.collect() }
}
