//! Prepares an adapter: channel closed, bit rates set. Blocks, so not for the event loop.

use std::io;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::address::SlcanAddress;
use super::lines::{Cut, Lines};
use crate::capture::CaptureError;
use crate::sys::tty::Tty;

/// An adapter that has said nothing for this long says nothing at all.
const PATIENCE: Duration = Duration::from_secs(1);

/// What an adapter that answers has said is complete after this much silence.
const SILENCE: Duration = Duration::from_millis(50);

/// How an adapter takes a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Answer {
    Done,
    Refused,
    None,
}

/// Sets up the adapter behind `tty` as `address` says. Returns whether it answers at all: some
/// adapters never acknowledge, and are taken at their silence.
///
/// An error is a command that the adapter refused (BELL), by its name.
pub(crate) fn set_up(tty: &Tty, address: &SlcanAddress) -> Result<bool, CaptureError> {
    let port = address.path.display();
    let failed = |e: io::Error| CaptureError(format!("cannot talk to the adapter at {port}: {e}"));
    let answers = close(tty).map_err(failed)?;
    let patience = if answers { PATIENCE } else { SILENCE };
    for command in address.set_up_commands() {
        let refused = || {
            Err(CaptureError(format!(
                "the adapter at {port} refused {command} ({}); choose another, or check that the \
                 adapter has it",
                meaning(&command, address)
            )))
        };
        if ask(tty, &command, patience).map_err(failed)? == Answer::Refused {
            return refused();
        }
    }
    Ok(answers)
}

fn meaning(command: &str, address: &SlcanAddress) -> String {
    match command.as_bytes().first() {
        Some(b'S') => format!("bit rate {} bit/s", address.bitrate),
        Some(b'Y') => format!("CAN FD data bit rate {} bit/s", address.data_bitrate.unwrap_or(0)),
        _ => "time stamps".to_owned(),
    }
}

/// Ends whatever half a command is left in the adapter, closes the channel, and takes everything
/// it still has to say. Returns whether it said anything.
fn close(tty: &Tty) -> io::Result<bool> {
    send(tty, b"\rC\r")?;
    let (mut heard, mut buffer) = (false, [0; 4096]);
    // An adapter that cannot be closed and talks on must not keep us here.
    let end = Instant::now() + 2 * PATIENCE;
    while Instant::now() < end {
        let patience = if heard { SILENCE } else { PATIENCE };
        if receive(tty, &mut buffer, patience)? == 0 {
            break;
        }
        heard = true;
    }
    Ok(heard)
}

fn ask(tty: &Tty, command: &str, patience: Duration) -> io::Result<Answer> {
    send(tty, format!("{command}\r").as_bytes())?;
    let (mut lines, mut answer, mut buffer) = (Lines::default(), Answer::None, [0; 4096]);
    let end = Instant::now() + patience;
    while answer == Answer::None {
        let left = end.saturating_duration_since(Instant::now());
        let count = receive(tty, &mut buffer, left)?;
        if count == 0 {
            break;
        }
        lines.feed(&buffer[..count], |cut| match cut {
            Cut::Line(_) => answer = Answer::Done,
            Cut::Refused => answer = Answer::Refused,
            Cut::TooLong => {}
        });
    }
    Ok(answer)
}

fn send(tty: &Tty, bytes: &[u8]) -> io::Result<()> {
    // A few bytes after an open always fit the kernel's buffer.
    if tty.write(bytes)? == bytes.len() { Ok(()) } else { Err(io::ErrorKind::WriteZero.into()) }
}

/// What arrives within `patience`; 0 if nothing.
fn receive(tty: &Tty, buffer: &mut [u8], patience: Duration) -> io::Result<usize> {
    let timeout = PollTimeout::try_from(patience).unwrap_or(PollTimeout::MAX);
    if poll(&mut [PollFd::new(tty.as_fd(), PollFlags::POLLIN)], timeout)? == 0 {
        return Ok(0);
    }
    match tty.read(buffer) {
        Ok(0) => Err(io::Error::other("it hung up")),
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(0),
        other => other,
    }
}
