//! How many times a device file is open, through inotify(7).

use std::ffi::CString;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Counts the openings of one file from now on. What was open before is not counted.
///
/// The kernel joins equal events that nobody has read yet, so of two openings within one turn of
/// the event loop only one may be counted: 0 is worth a second look, more than 0 is certain.
#[derive(Debug)]
pub struct Opens {
    inotify: OwnedFd,
    open: u64,
    news: bool,
}

impl Opens {
    /// Starts to watch `path`.
    pub fn watch(path: &Path) -> io::Result<Self> {
        // SAFETY: takes no pointers.
        let fd = unsafe { libc::inotify_init1(libc::IN_NONBLOCK | libc::IN_CLOEXEC) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: a new descriptor that nothing else owns.
        let inotify = unsafe { OwnedFd::from_raw_fd(fd) };
        let path = CString::new(path.as_os_str().as_bytes())?;
        let mask = libc::IN_OPEN | libc::IN_CLOSE;
        // SAFETY: the descriptor is open and the string ends with a zero byte and outlives the call.
        if unsafe { libc::inotify_add_watch(inotify.as_raw_fd(), path.as_ptr(), mask) } < 0 {
            return Err(io::Error::last_os_error());
        }
        Ok(Self { inotify, open: 0, news: false })
    }

    /// How often the file is open now.
    pub fn count(&mut self) -> u64 {
        let mut buffer = [0_u8; 4096];
        while let Ok(length @ 1..) = nix::unistd::read(&self.inotify, &mut buffer) {
            self.take(&buffer[..length]);
            self.news = true;
        }
        self.open
    }

    /// True if anything was opened or closed since the last call, as far as [`Opens::count`] has seen.
    pub fn take_news(&mut self) -> bool {
        std::mem::take(&mut self.news)
    }

    /// Puts the count right after a second look.
    pub fn correct(&mut self, open: u64) {
        self.open = open;
    }

    /// Events are `struct inotify_event`: wd, mask, cookie, len (4 bytes each), then `len` bytes.
    fn take(&mut self, mut events: &[u8]) {
        while let Some((head, rest)) = events.split_first_chunk::<16>() {
            let word =
                |i: usize| u32::from_ne_bytes([head[i], head[i + 1], head[i + 2], head[i + 3]]);
            let mask = word(4);
            if mask & libc::IN_OPEN != 0 {
                self.open += 1;
            } else if mask & libc::IN_CLOSE != 0 {
                self.open = self.open.saturating_sub(1);
            }
            events = rest.get(word(12) as usize..).unwrap_or_default();
        }
    }
}

impl AsRawFd for Opens {
    fn as_raw_fd(&self) -> RawFd {
        self.inotify.as_raw_fd()
    }
}
