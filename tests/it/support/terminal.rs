//! Serial lines without hardware.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::os::fd::AsFd as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};

use super::until;

/// A serial port and the device behind it: a pseudo-terminal. Unplugged when dropped.
pub struct Device {
    device: PtyMaster,
    port: PathBuf,
}

impl Device {
    pub fn new() -> Self {
        // Closed in the children of other tests: while one of them had it, it would stay plugged in.
        let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC;
        let device = posix_openpt(flags).expect("a pseudo-terminal");
        grantpt(&device).expect("a pseudo-terminal");
        unlockpt(&device).expect("a pseudo-terminal");
        let port = ptsname_r(&device).expect("a name").into();
        Self { device, port }
    }

    /// What a program opens.
    pub fn port(&self) -> &Path {
        &self.port
    }

    /// Takes what a program has said; an error if nothing, or if nobody has it open.
    pub fn hear(&self, buffer: &mut [u8]) -> nix::Result<usize> {
        let mut ready = [PollFd::new(self.device.as_fd(), PollFlags::POLLIN)];
        if poll(&mut ready, PollTimeout::ZERO)? == 0 {
            return Err(nix::errno::Errno::EAGAIN);
        }
        nix::unistd::read(&self.device, buffer)
    }

    /// Says something to whoever listens, which must be somebody: else it is echoed.
    pub fn say(&mut self, bytes: &[u8]) {
        self.device.write_all(bytes).expect("the port takes it");
    }
}

/// Waits until a program has said something to one of `devices`, but not for longer than `most`.
pub fn wait<const N: usize>(devices: [&Device; N], most: Duration) {
    let mut ready = devices.map(|device| PollFd::new(device.device.as_fd(), PollFlags::POLLIN));
    poll(&mut ready, PollTimeout::try_from(most).expect("some milliseconds")).ok();
    // A device that nobody has open says so at once, again and again.
    let hung_up = |fd: &PollFd<'_>| fd.revents().is_some_and(|e| e.contains(PollFlags::POLLHUP));
    if ready.iter().any(hung_up) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Opens a terminal as a program does, once it is there.
pub fn open(path: &Path) -> File {
    until("a terminal to appear", || {
        OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY).open(path).ok()
    })
}
