//! A person at a terminal: sees what a program says there, and presses keys.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::pty::{OpenptyResult, openpty};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{Termios, tcgetattr};
use nix::unistd::Pid;

use super::process::BUSTAPE;
use super::{PATIENCE, until};

/// Somebody who has started `bustape` on a terminal of its own.
pub struct Person {
    child: Child,
    keys: File,
    terminal: File,
    said: Receiver<String>,
    /// What was said and not looked for yet.
    seen: String,
    /// The terminal's mode before the program.
    pub before: Termios,
}

impl Person {
    /// Starts `bustape` with its stdin and stderr on the terminal, which is its controlling one.
    pub fn start<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Self {
        let OpenptyResult { master, slave } = openpty(None, None).expect("a terminal");
        for descriptor in [&master, &slave] {
            fcntl(descriptor, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).expect("it is open");
        }
        let (keys, terminal) = (File::from(master), File::from(slave));
        let before = tcgetattr(&terminal).expect("it is a terminal");
        let end = |terminal: &File| Stdio::from(terminal.try_clone().expect("a descriptor"));
        let child = Command::new("setsid")
            .args(["--ctty", BUSTAPE])
            .args(args)
            .stdin(end(&terminal))
            .stderr(end(&terminal))
            .stdout(Stdio::piped())
            .spawn()
            .expect("setsid runs");
        let (say, said) = channel();
        let mut screen = keys.try_clone().expect("a descriptor");
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(length @ 1..) = screen.read(&mut buffer) {
                let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
                if say.send(text).is_err() {
                    return;
                }
            }
        });
        Self { child, keys, terminal, said, seen: String::new(), before }
    }

    /// Presses keys.
    pub fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("the terminal takes it");
    }

    /// Waits until the screen shows `part`, after what was looked for before.
    #[track_caller]
    pub fn sees(&mut self, part: &str) {
        let mut all = std::mem::take(&mut self.seen);
        loop {
            if let Some(at) = all.find(part) {
                self.seen = all.split_off(at + part.len());
                return;
            }
            match self.said.recv_timeout(PATIENCE) {
                Ok(more) => all.push_str(&more),
                Err(why) => panic!("waited for {part:?} and saw {all:?}: {why}"),
            }
        }
    }

    /// The mode of the terminal.
    pub fn mode(&self) -> Termios {
        tcgetattr(&self.terminal).expect("it is a terminal")
    }

    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it is ours");
    }

    /// Waits for the end: the exit status, and what was printed on stdout.
    pub fn wait(&mut self) -> (Option<i32>, String) {
        let status = until("a command to end", || self.child.try_wait().expect("it is ours"));
        let mut out = String::new();
        let stdout = self.child.stdout.as_mut().expect("piped");
        stdout.read_to_string(&mut out).expect("text");
        (status.code(), out)
    }
}

impl Drop for Person {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
