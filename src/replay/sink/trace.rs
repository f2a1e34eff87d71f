//! Onto stdout, as text: CAN frames as `candump -L` prints them, serial bytes as hex and ASCII.
//!
//! The times are the recorded ones, so that the same recording always gives the same text.

use std::fs::OpenOptions;
use std::io;
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt as _;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::fstat;
use nix::unistd::write;

use super::{Blocked, Due, Sink, Took};
use crate::frame::{Frame, Timestamp};
use crate::replay::ReplayError;
use crate::text::{candump, hex, printable};

/// Text that may wait for a slow reader.
const MOST: usize = 128 << 10;
/// Text that is collected before it goes out when more is due already.
const PIECE: usize = 32 << 10;
/// A pipe that is writable takes so much without waiting (`PIPE_BUF`, pipe(7)).
const PIPE_PIECE: usize = 4096;

/// Text on stdout.
pub struct TraceSink {
    out: Out,
    text: Vec<u8>,
    /// Text at the start that is gone already.
    gone: usize,
    names: Vec<String>,
    clock: Clock,
}

impl TraceSink {
    /// Text in which the buses have these names, by number.
    pub fn new(names: &[String]) -> Self {
        let out = Out::new();
        let names = names.iter().map(|name| printable(name)).collect();
        Self { out, text: Vec::new(), gone: 0, names, clock: Clock::default() }
    }

    /// Appends one line.
    fn put(&mut self, time: Timestamp, bus: usize, frame: &Frame) {
        let name = self.names.get(bus).map_or("", String::as_str);
        match frame {
            Frame::Can(frame) => {
                self.text.extend_from_slice(self.clock.column(time));
                self.text.extend_from_slice(name.as_bytes());
                self.text.push(b' ');
                candump::put(&mut self.text, frame);
                self.text.push(b'\n');
            }
            Frame::Serial(bytes) => {
                hex::put(&mut self.text, self.clock.column(time), name, bytes);
            }
            Frame::Gap(_) | Frame::Notice(_) => {}
        }
    }

    /// Writes what can be written without waiting.
    fn write(&mut self) -> Result<(), ReplayError> {
        while self.gone < self.text.len() {
            match self.out.write(&self.text[self.gone..]) {
                Ok(written) => self.gone += written,
                Err(Errno::EAGAIN | Errno::EINTR) => break,
                Err(Errno::EPIPE) => return Err(ReplayError(READER_GONE.to_owned())),
                Err(error) => {
                    return Err(ReplayError(format!("cannot write to stdout: {error}")));
                }
            }
        }
        if self.gone == self.text.len() {
            self.text.clear();
            self.gone = 0;
        } else if self.gone > MOST {
            // A reader that is always a little behind never lets it become empty.
            self.text.drain(..self.gone);
            self.gone = 0;
        }
        Ok(())
    }
}

/// Stdout, as far as it can be written to without waiting.
enum Out {
    /// A file, or a pipe of our own making to the same reader: never waits.
    Free(OwnedFd),
    /// Anything else: stdout itself, whose other users must not find it changed.
    Shared(io::Stdout),
}

impl Out {
    fn new() -> Self {
        let stdout = io::stdout();
        let kind = fstat(&stdout).map_or(0, |stat| stat.st_mode & libc::S_IFMT);
        let own = match kind {
            libc::S_IFREG => stdout.as_fd().try_clone_to_owned().ok(),
            // Opened anew it has flags of its own (proc(5)).
            libc::S_IFIFO => OpenOptions::new()
                .write(true)
                .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
                .open("/proc/self/fd/1")
                .ok()
                .map(OwnedFd::from),
            _ => None,
        };
        own.map_or(Self::Shared(stdout), Self::Free)
    }

    /// Writes what fits; `EAGAIN` if nothing does.
    fn write(&self, text: &[u8]) -> nix::Result<usize> {
        let Self::Shared(stdout) = self else { return write(self.as_fd(), text) };
        let mut ready = [PollFd::new(stdout.as_fd(), PollFlags::POLLOUT)];
        match poll(&mut ready, PollTimeout::ZERO)? {
            0 => Err(Errno::EAGAIN),
            _ => write(stdout, &text[..text.len().min(PIPE_PIECE)]),
        }
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Free(own) => own.as_fd(),
            Self::Shared(stdout) => stdout.as_fd(),
        }
    }
}

/// Whoever read our text has gone away, which ends the replay without being a failure.
pub const READER_GONE: &str = "the reader of stdout has gone away";

impl Sink for TraceSink {
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
        if self.text.len() - self.gone >= MOST {
            self.write()?;
            if self.text.len() - self.gone >= MOST {
                return Ok(Took::blocked(0, Blocked::Writable));
            }
        }
        for due in front {
            self.put(due.item.time, due.item.bus, &due.item.frame);
            if self.text.len() - self.gone >= PIECE {
                self.write()?;
            }
        }
        Ok(Took::sent(front.len()))
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.out.as_fd())
    }

    fn rest(&mut self) -> Result<bool, ReplayError> {
        self.write()?;
        Ok(self.text.is_empty())
    }

    fn finish(&mut self) -> Result<bool, ReplayError> {
        self.rest()
    }
}

/// Writes times; the digits of the second are kept from line to line.
#[derive(Default)]
struct Clock {
    second: u64,
    column: Vec<u8>,
}

impl Clock {
    /// `(1782097200.123456) `.
    fn column(&mut self, time: Timestamp) -> &[u8] {
        let (second, nanos) = (time.nanos() / 1_000_000_000, time.nanos() % 1_000_000_000);
        if self.column.is_empty() || second != self.second {
            self.second = second;
            self.column = format!("({second:010}.000000) ").into_bytes();
        }
        let mut micros = nanos / 1000;
        let digits = self.column.len() - 8..self.column.len() - 2;
        for digit in self.column[digits].iter_mut().rev() {
            *digit = b'0' + (micros % 10).to_le_bytes()[0];
            micros /= 10;
        }
        &self.column
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_candumps() {
        let mut clock = Clock::default();
        for (nanos, text) in [
            (1_782_097_200_123_456_789, "(1782097200.123456) "),
            (1_782_097_200_000_000_999, "(1782097200.000000) "),
            (5_999_999_999, "(0000000005.999999) "),
        ] {
            assert_eq!(clock.column(Timestamp(nanos)), text.as_bytes());
        }
    }
}
