//! Pseudo-terminals, seen from the side that made them.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::termios::{FlushArg, tcflush};

use super::tty::{make_raw, set_nonblocking};

/// The system call of ioctl_tty(2) that nix has no safe form of.
mod ioctl {
    #![allow(missing_docs, reason = "the macro takes no comments; see ioctl_tty(2)")]

    nix::ioctl_read_bad!(fionread, libc::FIONREAD, libc::c_int);
}
use ioctl::fionread;

/// A new pseudo-terminal: we hold its master side, an application opens [`Pty::path`].
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// Kept open so that the master never sees a hang-up (EIO) while no application is there, and
    /// so that the raw mode stays.
    kept: File,
    path: PathBuf,
}

impl Pty {
    /// Makes a pseudo-terminal in raw mode, before anybody can write the first byte.
    pub fn new() -> io::Result<Self> {
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = PathBuf::from(ptsname_r(&master)?);
        let kept =
            OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY).open(&path)?;
        make_raw(&kept)?;
        set_nonblocking(&master)?;
        Ok(Self { master: master.into(), kept, path })
    }

    /// What an application opens: `/dev/pts/N`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads what the application wrote; `WouldBlock` if nothing.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        Ok(nix::unistd::read(&self.master, buffer)?)
    }

    /// Hands as much of `bytes` to the application as the kernel takes now; `WouldBlock` if
    /// nothing.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        Ok(nix::unistd::write(&self.master, bytes)?)
    }

    /// Bytes handed over that the application has not read yet.
    pub fn unread(&self) -> usize {
        let mut count = 0;
        // SAFETY: the descriptor is open, and the kernel writes one int.
        let answer = unsafe { fionread(self.kept.as_raw_fd(), &raw mut count) };
        answer.map_or(0, |_| usize::try_from(count).unwrap_or(0))
    }

    /// Throws away what was handed over but never read, as closing a real port does.
    pub fn discard_unread(&self) -> io::Result<()> {
        Ok(tcflush(&self.kept, FlushArg::TCIFLUSH)?)
    }
}

impl AsFd for Pty {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}

impl AsRawFd for Pty {
    fn as_raw_fd(&self) -> RawFd {
        self.master.as_raw_fd()
    }
}
