//! The real binary, as a child process.

use std::ffi::{OsStr, OsString};
use std::io::Read;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::until;

/// The binary under test.
pub const BUSTAPE: &str = env!("CARGO_BIN_EXE_bustape");

/// How a command ended, and what it said.
#[derive(Debug)]
pub struct Ran {
    pub status: ExitStatus,
    pub out: String,
    pub err: String,
}

impl Ran {
    /// Panics with everything that was said unless the exit status is `code`.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.status.code(), Some(code), "{}\n{}{}", self.status, self.out, self.err);
        self
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}", self.out))
    }
}

/// Runs `bustape` to its end.
pub fn bustape<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Ran {
    start(args).wait()
}

/// Starts `bustape`.
pub fn start<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Running {
    let mut command = Command::new(BUSTAPE);
    command.args(args);
    spawn(command)
}

/// Starts `bustape` under strace, which does to its system calls what `options` say. Only calls
/// that concern one of `paths` are touched (all if there are none), and each thread counts its own.
pub fn start_injected<S: AsRef<OsStr>>(
    options: &[&str],
    paths: &[&Path],
    args: impl IntoIterator<Item = S>,
) -> Running {
    let mut command = Command::new("strace");
    // As a grandchild, so that the process that is started is the recorder itself.
    command.args(["-D", "-f", "-qqq", "-o", "/dev/null"]);
    for option in options {
        command.args(["-e", option]);
    }
    for path in paths {
        command.arg("-P").arg(path);
    }
    command.arg(BUSTAPE).args(args);
    super::peers::peers();
    spawn(command)
}

/// Starts any command in a process group of its own.
pub fn spawn(mut command: Command) -> Running {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
    // Nothing of the person who runs the tests: help is wrapped and coloured by these.
    for name in ["COLUMNS", "CLICOLOR", "CLICOLOR_FORCE", "NO_COLOR"] {
        command.env_remove(name);
    }
    let mut child = command.spawn().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let out = collect(child.stdout.take().expect("piped"));
    let err = collect(child.stderr.take().expect("piped"));
    Running { child, said: Some((out, err)) }
}

fn collect(mut from: impl Read + Send + 'static) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut all = Vec::new();
        from.read_to_end(&mut all).expect("a pipe");
        String::from_utf8(all).expect("UTF-8")
    })
}

/// A command that is running; killed when dropped.
pub struct Running {
    child: Child,
    said: Option<(JoinHandle<String>, JoinHandle<String>)>,
}

impl Running {
    #[allow(dead_code, reason = "the soak program looks at it")]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it is ours");
    }

    /// Ends every process of its group with SIGTERM; for shells that wait for what they started.
    pub fn stop_group(&self) {
        kill(Pid::from_raw(-(self.child.id() as i32)), Signal::SIGTERM).expect("it is ours");
    }

    /// Waits for its end.
    pub fn wait(mut self) -> Ran {
        let status = until("a command to end", || self.child.try_wait().expect("it is ours"));
        let (out, err) = self.said.take().expect("waited for once");
        let (out, err) = (out.join().expect("read"), err.join().expect("read"));
        Ran { status, out, err }
    }

    /// Ends it with SIGTERM.
    pub fn stop(self) -> Ran {
        self.signal(Signal::SIGTERM);
        self.wait()
    }

    /// Ends it as a power failure would, as far as it can tell.
    pub fn kill(self) -> Ran {
        // The group: a thread whose call strace delays ends only when strace does.
        kill(Pid::from_raw(-(self.child.id() as i32)), Signal::SIGKILL).expect("it is ours");
        let ran = self.wait();
        assert_eq!(ran.status.signal(), Some(Signal::SIGKILL as i32), "{ran:?}");
        ran
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if self.said.is_some() {
            // The group: strace's child must not outlive it.
            kill(Pid::from_raw(-(self.child.id() as i32)), Signal::SIGKILL).ok();
            self.child.wait().ok();
        }
    }
}

/// Arguments of mixed kinds.
pub fn args(parts: &[&dyn AsRef<OsStr>]) -> Vec<OsString> {
    parts.iter().map(|part| part.as_ref().to_owned()).collect()
}
