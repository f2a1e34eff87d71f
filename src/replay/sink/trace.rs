//! Onto stdout, as text: CAN frames as `candump -L` prints them, serial bytes as hex and ASCII.
//!
//! The times are the recorded ones, so that the same recording always gives the same text.

use std::io;
use std::os::fd::{AsFd as _, BorrowedFd};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

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
    out: io::Stdout,
    /// Never blocks: a file.
    is_file: bool,
    text: Vec<u8>,
    /// Text at the start that is gone already.
    gone: usize,
    names: Vec<String>,
    clock: Clock,
}

impl TraceSink {
    /// Text in which the buses have these names, by number.
    pub fn new(names: &[String]) -> Self {
        let out = io::stdout();
        let is_file = nix::sys::stat::fstat(&out)
            .is_ok_and(|stat| stat.st_mode & libc::S_IFMT == libc::S_IFREG);
        let names = names.iter().map(|name| printable(name)).collect();
        Self { out, is_file, text: Vec::new(), gone: 0, names, clock: Clock::default() }
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
            let rest = &self.text[self.gone..];
            let rest = if self.is_file { rest } else { &rest[..rest.len().min(PIPE_PIECE)] };
            if !self.is_file {
                let mut ready = [PollFd::new(self.out.as_fd(), PollFlags::POLLOUT)];
                if poll(&mut ready, PollTimeout::ZERO).unwrap_or(0) == 0 {
                    break;
                }
            }
            match nix::unistd::write(&self.out, rest) {
                Ok(written) => self.gone += written,
                Err(nix::errno::Errno::EAGAIN | nix::errno::Errno::EINTR) => break,
                Err(nix::errno::Errno::EPIPE) => {
                    return Err(ReplayError(READER_GONE.to_owned()));
                }
                Err(error) => {
                    return Err(ReplayError(format!("cannot write to stdout: {error}")));
                }
            }
        }
        if self.gone == self.text.len() {
            self.text.clear();
            self.gone = 0;
        }
        Ok(())
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
            if self.text.len() >= PIECE {
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
