//! One end of a serial line on which a simulated device speaks.

use std::io;
use std::os::fd::{AsFd as _, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::termios::{self, FlushArg};
use tokio::io::Interest;
use tokio::time::{Instant, sleep_until, timeout};

use crate::capture::CaptureError;
use crate::capture::serial::{Link, PortSpec, SerialSettings, Use, linked};
use crate::permit::Permit;
use crate::sys::Waiting;
use crate::sys::pty::Pty;
use crate::sys::tty::Tty;

/// A UART hands over what it has received in pieces of about this size.
const PIECE: usize = 8;
/// When nobody reads for so long, what is said is lost, as on a wire.
const PATIENCE: Duration = Duration::from_secs(1);

/// One end of a line, raw and non-blocking.
pub struct Line {
    fd: Waiting<OwnedFd>,
    /// How long a byte takes, ns; 0 where a UART looks after that.
    nanos_per_byte: u64,
    kept: Kept,
}

/// What must live as long as the descriptor, and goes with it.
enum Kept {
    Nothing,
    Pty(Pty, #[allow(dead_code, reason = "kept for its drop")] Link),
    Port(Tty),
}

impl Line {
    fn new(fd: OwnedFd, baud: u32, kept: Kept) -> io::Result<Self> {
        let flags = OFlag::from_bits_truncate(fcntl(&fd, FcntlArg::F_GETFL)?);
        fcntl(&fd, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
        let fd = Waiting::new(fd, Interest::READABLE | Interest::WRITABLE)?;
        // Ten bits a byte: 8N1.
        let nanos_per_byte = 10_000_000_000_u64.checked_div(u64::from(baud)).unwrap_or(0);
        Ok(Self { fd, nanos_per_byte, kept })
    }

    /// Two ends of one line with `baud` bit/s. Needs a tokio runtime, as all of these.
    ///
    /// # Errors
    /// Where there are no pseudo-terminals.
    pub fn pair(baud: u32) -> io::Result<(Self, Self)> {
        let pty = nix::pty::openpty(None, None)?;
        let mut settings = termios::tcgetattr(&pty.slave)?;
        termios::cfmakeraw(&mut settings);
        termios::tcsetattr(&pty.slave, termios::SetArg::TCSANOW, &settings)?;
        let end = |fd| Self::new(fd, baud, Kept::Nothing);
        Ok((end(pty.slave)?, end(pty.master)?))
    }

    /// A pseudo-terminal that an application finds at `path`, as slow as a line with `baud` bit/s.
    ///
    /// # Errors
    /// Where something is at `path` already, or no pseudo-terminal can be made.
    pub fn linked(path: &Path, baud: u32) -> Result<Self, CaptureError> {
        let (pty, link) = linked(path)?;
        let fd = pty.as_fd().try_clone_to_owned();
        fd.and_then(|fd| Self::new(fd, baud, Kept::Pty(pty, link)))
            .map_err(|error| cannot(path, &error))
    }

    /// A serial port that may be spoken on.
    ///
    /// # Errors
    /// Where it cannot be opened or has no such settings.
    pub fn port(
        path: PathBuf,
        settings: SerialSettings,
        _permit: &Permit,
    ) -> Result<Self, CaptureError> {
        let (spec, opened) = PortSpec::open_first(path, settings, Use::Adapter)?;
        let tty = opened.tty;
        let baud = if tty.is_pseudo() { spec.settings.baud } else { 0 };
        let fd = tty.as_fd().try_clone_to_owned();
        fd.and_then(|fd| Self::new(fd, baud, Kept::Port(tty)))
            .map_err(|error| cannot(&spec.path, &error))
    }

    /// What one read returns; empty when the other end is closed.
    pub(super) async fn read(&self) -> io::Result<Vec<u8>> {
        let mut bytes = [0; 512];
        loop {
            let read = |fd: &OwnedFd| Ok(nix::unistd::read(fd, &mut bytes)?);
            match self.fd.act(Interest::READABLE, read).await {
                Ok(count) => return Ok(bytes[..count].to_vec()),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // A pseudo-terminal says so when nobody has the other end open any more.
                Err(error) if error.raw_os_error() == Some(Errno::EIO as i32) => {
                    return Ok(Vec::new());
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Writes all of `bytes`, or loses what nobody takes.
    async fn write_all(&self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let write = |fd: &OwnedFd| Ok(nix::unistd::write(fd, bytes)?);
            match timeout(PATIENCE, self.fd.act(Interest::WRITABLE, write)).await {
                Ok(Ok(count)) => bytes = &bytes[count..],
                Ok(Err(error)) if error.kind() == io::ErrorKind::WouldBlock => {}
                Ok(Err(error)) => return Err(error),
                Err(_) => return self.forget_unread(),
            }
        }
        Ok(())
    }

    /// Writes what fits of `bytes`; the rest is lost.
    pub fn write_now(&self, bytes: &[u8]) {
        // Whoever listens in later wants what is said then.
        let _ = match &self.kept {
            Kept::Pty(pty, _) => pty.write(bytes),
            Kept::Port(tty) => tty.write(bytes),
            Kept::Nothing => Ok(0),
        };
    }

    /// Throws away what was said and nobody has read: an application that opens the terminal
    /// later would take it for new.
    pub(super) fn forget_unread(&self) -> io::Result<()> {
        match &self.kept {
            Kept::Pty(pty, _) => pty.discard_unread(),
            Kept::Port(tty) => Ok(termios::tcflush(tty, FlushArg::TCOFLUSH)?),
            Kept::Nothing => Ok(()),
        }
    }

    /// Sends `bytes` as fast as the line would carry them, in pieces as a UART hands them over.
    pub(super) async fn send(&self, bytes: &[u8]) -> io::Result<()> {
        let start = Instant::now();
        let mut sent = 0;
        for piece in bytes.chunks(PIECE) {
            sent += piece.len() as u64;
            // A piece is there when its last byte is.
            sleep_until(start + Duration::from_nanos(sent * self.nanos_per_byte)).await;
            self.write_all(piece).await?;
        }
        Ok(())
    }
}

fn cannot(path: &Path, error: &io::Error) -> CaptureError {
    CaptureError(format!("cannot wait for {}: {error}", path.display()))
}
