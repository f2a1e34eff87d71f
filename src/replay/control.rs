//! What a person or a script may ask of a running replay.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};

use super::ReplayError;
use super::keys::Keys;
use super::schedule::Rate;
use crate::text::parse_duration;

/// Something asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Let time stand still.
    Pause,
    /// Let it pass.
    Resume,
    /// The one or the other.
    Toggle,
    /// Send the next so many frames; time stands still.
    Step(u64),
    /// Go to a recorded time, written as for `--start`.
    Seek(String),
    /// Go forward (or back) by this much recorded time.
    Skip(Duration, bool),
    /// Let time pass at this rate.
    Rate(Rate),
    /// Twice as fast, or half as fast.
    Faster(bool),
    /// Say where we are, with this text.
    Mark(String),
    /// Say where we are.
    Status,
    /// End.
    Quit,
}

/// The commands, for messages.
pub const COMMANDS: &str = "pause, resume, toggle, step [N], seek TIME, forward TIME, back TIME, \
                            rate X|max, mark [TEXT], status, quit";

impl Request {
    /// Reads a command; `Ok(None)` for an empty line.
    pub fn parse(line: &str) -> Result<Option<Self>, String> {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        let bare = |request| match rest {
            "" => Ok(Some(request)),
            _ => Err(format!("\"{line}\": nothing may follow {word}")),
        };
        match word {
            "" => Ok(None),
            "pause" => bare(Self::Pause),
            "resume" | "play" => bare(Self::Resume),
            "toggle" => bare(Self::Toggle),
            "step" if rest.is_empty() => Ok(Some(Self::Step(1))),
            "step" => match rest.parse() {
                Ok(count @ 1..) => Ok(Some(Self::Step(count))),
                _ => Err(format!("\"{line}\": step takes a number of frames")),
            },
            "seek" if !rest.is_empty() => Ok(Some(Self::Seek(rest.to_owned()))),
            "forward" | "back" => {
                let time = parse_duration(rest).map_err(|error| format!("\"{line}\": {error}"))?;
                Ok(Some(Self::Skip(time, word == "forward")))
            }
            "rate" => Ok(Some(Self::Rate(Rate::parse(rest)?))),
            "mark" => Ok(Some(Self::Mark(rest.to_owned()))),
            "status" => bare(Self::Status),
            "quit" => bare(Self::Quit),
            _ => Err(format!("\"{line}\" is no command; there are {COMMANDS}")),
        }
    }
}

/// Commands as lines of text, from a FIFO or stdin.
pub struct Script {
    from: File,
    line: Vec<u8>,
}

/// Longest command.
const LONGEST: usize = 1024;

impl Script {
    /// Reads from stdin.
    ///
    /// # Errors
    /// Where stdin is closed.
    pub fn stdin() -> io::Result<Self> {
        let from = io::stdin().as_fd().try_clone_to_owned()?.into();
        Ok(Self { from, line: Vec::new() })
    }

    /// Reads from a FIFO, whoever opens it for writing, one after the other.
    ///
    /// # Errors
    /// A sentence: there is none, or it is something else.
    pub fn fifo(path: &Path) -> Result<Self, ReplayError> {
        use std::os::unix::fs::FileTypeExt as _;
        let shown = path.display();
        let about = std::fs::metadata(path).map_err(|error| {
            ReplayError(format!("cannot read {shown}: {error}; make it with: mkfifo {shown}"))
        })?;
        if !about.file_type().is_fifo() {
            return Err(ReplayError(format!("{shown} is not a FIFO; make one with mkfifo")));
        }
        // Open for writing too, so that it does not end when the last writer leaves.
        let from = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(path)
            .map_err(|error| ReplayError(format!("cannot open {shown}: {error}")))?;
        Ok(Self { from, line: Vec::new() })
    }

    /// Takes the commands that have arrived. False when there will be no more.
    fn read(&mut self, take: &mut dyn FnMut(Result<Request, String>)) -> bool {
        let mut buffer = [0; 1024];
        let length = match self.from.read(&mut buffer) {
            Ok(0) => {
                // The last line needs no end of its own.
                self.end_line(take);
                return false;
            }
            Ok(length) => length,
            Err(error) => {
                return matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                );
            }
        };
        for &byte in &buffer[..length] {
            if byte != b'\n' {
                // The rest of a line that is too long is dropped, and the line is not understood.
                if self.line.len() <= LONGEST {
                    self.line.push(byte);
                }
                continue;
            }
            self.end_line(take);
        }
        true
    }

    /// Understands the line that was read.
    fn end_line(&mut self, take: &mut dyn FnMut(Result<Request, String>)) {
        let line = std::mem::take(&mut self.line);
        match Request::parse(&String::from_utf8_lossy(&line)) {
            Ok(Some(request)) => take(Ok(request)),
            Ok(None) => {}
            Err(error) => take(Err(error)),
        }
    }
}

/// Everything that is listened to: signals, and keys or a script.
pub struct Controls {
    signals: SignalFd,
    script: Option<Script>,
    keys: Option<Keys>,
}

/// What was heard.
#[derive(Clone, Debug, PartialEq)]
pub enum Said {
    /// Something was asked for.
    Request(Request),
    /// Something that makes no sense.
    Nonsense(String),
    /// A signal that means the end, by its name.
    Signal(&'static str),
}

impl Controls {
    /// From here on SIGINT, SIGTERM and SIGHUP do not end the process but are heard here, in
    /// threads that are started later, too.
    ///
    /// # Errors
    /// Where a sandbox forbids it.
    pub fn new(script: Option<Script>, keys: Option<Keys>) -> io::Result<Self> {
        let mut set = SigSet::empty();
        for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
            set.add(signal);
        }
        set.thread_block()?;
        let signals = SignalFd::with_flags(&set, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC)?;
        Ok(Self { signals, script, keys })
    }

    /// The descriptors to wait for.
    pub fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        let script = self.script.as_ref().map(|script| script.from.as_fd());
        let keys = self.keys.as_ref().and_then(Keys::descriptor);
        [Some(self.signals.as_fd()), script, keys].into_iter().flatten()
    }

    /// Takes what was said since the last call. Does not wait.
    pub fn take(&mut self, take: &mut dyn FnMut(Said)) {
        while let Ok(Some(signal)) = self.signals.read_signal() {
            take(Said::Signal(match signal.ssi_signo.cast_signed() {
                libc::SIGINT => "SIGINT",
                libc::SIGTERM => "SIGTERM",
                _ => "SIGHUP",
            }));
        }
        if let Some(script) = &mut self.script
            && is_readable(script.from.as_fd())
        {
            let more = script.read(&mut |said| {
                take(match said {
                    Ok(request) => Said::Request(request),
                    Err(nonsense) => Said::Nonsense(nonsense),
                });
            });
            if !more {
                self.script = None;
            }
        }
        if let Some(keys) = &mut self.keys
            && keys.descriptor().is_some_and(is_readable)
        {
            keys.read(&mut |request| take(Said::Request(request)));
        }
    }
}

fn is_readable(descriptor: BorrowedFd<'_>) -> bool {
    let mut ready = [PollFd::new(descriptor, PollFlags::POLLIN)];
    poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_and_nonsense_is_named() {
        let read = |text| Request::parse(text);
        assert_eq!(read("  pause "), Ok(Some(Request::Pause)));
        assert_eq!(read("step"), Ok(Some(Request::Step(1))));
        assert_eq!(read("step 12"), Ok(Some(Request::Step(12))));
        assert_eq!(read("seek +1m30s"), Ok(Some(Request::Seek("+1m30s".to_owned()))));
        assert_eq!(read("back 5s"), Ok(Some(Request::Skip(Duration::from_secs(5), false))));
        assert_eq!(read("rate max"), Ok(Some(Request::Rate(Rate::Max))));
        assert_eq!(read("mark here it is"), Ok(Some(Request::Mark("here it is".to_owned()))));
        assert_eq!(read(""), Ok(None));
        for text in ["stop", "pause now", "step 0", "step x", "rate 0", "forward", "seek"] {
            assert!(read(text).is_err(), "{text}");
        }
    }
}
