//! The application's side of a bridge: a pseudo-terminal that it opens, leaves and opens again.

use std::cell::RefCell;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::time::Instant;

use super::identity::holders;
use super::link::Link;
use super::relay::Relay;
use crate::frame::Level;
use crate::queue::Inlet;
use crate::sys::opens::Opens;
use crate::sys::pty::Pty;
use crate::sys::wait::register;

/// An application that takes nothing for this long, on a line without flow control, no longer
/// holds up the recording: a real port would have lost its bytes by now, too.
const STALLED: Duration = Duration::from_secs(5);

/// The pseudo-terminal, and what waits for the application.
pub(crate) struct Application {
    pty: AsyncFd<Pty>,
    path: PathBuf,
    opens: AsyncFd<Opens>,
    present: bool,
    waiting: Relay,
    /// When the application last took something, while something waits.
    progress: Instant,
    /// With flow control the application may hold the line as long as it likes.
    may_hold: bool,
    /// Bytes recorded but not passed on since the application stopped taking them.
    skipped: u64,
    _link: Link,
}

impl Application {
    /// Puts a linked pseudo-terminal on the event loop.
    pub fn new(pty: Pty, link: Link, opens: Opens, may_hold: bool) -> io::Result<Self> {
        Ok(Self {
            path: pty.path().to_owned(),
            pty: register(pty, Interest::READABLE | Interest::WRITABLE)?,
            opens: register(opens, Interest::READABLE)?,
            present: false,
            waiting: Relay::default(),
            progress: Instant::now(),
            may_hold,
            skipped: 0,
            _link: link,
        })
    }

    /// Waits for bytes from the application. Safe to cancel.
    pub async fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        self.pty.async_io(Interest::READABLE, |pty| pty.read(buffer)).await
    }

    /// Reads what the application wrote and we have not read; `WouldBlock` if nothing.
    pub fn read_now(&self, buffer: &mut [u8]) -> io::Result<usize> {
        self.pty.get_ref().read(buffer)
    }

    /// Waits until the application opens or closes the pseudo-terminal. Safe to cancel.
    pub async fn opened_or_closed(&self) -> io::Result<()> {
        // `look` takes all events, so the next one is news again.
        self.opens.readable().await?.clear_ready();
        Ok(())
    }

    /// Looks whether an application is there. When the last one leaves, what it did not read goes
    /// with it: the next one must not find a stranger's bytes.
    pub fn look(&mut self) {
        let opens = self.opens.get_mut();
        let mut count = opens.count();
        if count == 0 && self.present {
            // 0 may be one opening too few; more than 0 is certain.
            count = holders(&self.path).len() as u64;
            opens.correct(count);
        }
        if self.present && count == 0 {
            self.waiting.clear();
            self.skipped = 0;
            // Only the next reader's comfort; nothing of the recording depends on it.
            let _ = self.pty.get_ref().discard_unread();
        }
        self.present = count > 0;
    }

    /// Bytes that may be passed on now; 0 while the application must catch up.
    pub fn room(&self) -> usize {
        if self.is_stalled() { usize::MAX } else { self.waiting.room() }
    }

    /// Hands `bytes` from the device over, or only drops them if no application is there.
    pub fn pass(&mut self, bytes: &[u8], inlet: &RefCell<Inlet>) -> io::Result<()> {
        self.look();
        if !self.present {
            return Ok(());
        }
        if self.is_stalled() {
            if self.skipped == 0 {
                let text = format!(
                    "the application at {} has read nothing for {} s; what the device says is \
                     recorded, but not passed on until it reads again",
                    self.path.display(),
                    STALLED.as_secs()
                );
                inlet.borrow_mut().notice(Level::Warning, text);
            }
            self.skipped += bytes.len() as u64;
            return Ok(());
        }
        if self.waiting.is_empty() {
            self.progress = Instant::now();
        }
        self.waiting.pass(bytes, |bytes| self.pty.get_ref().write(bytes))
    }

    /// Waits until the application takes some of what waits for it. Safe to cancel.
    pub async fn flush(&self) -> io::Result<usize> {
        if self.waiting.is_empty() {
            return std::future::pending().await;
        }
        self.pty.async_io(Interest::WRITABLE, |pty| pty.write(self.waiting.front())).await
    }

    /// The application took `count` bytes.
    pub fn flushed(&mut self, count: usize, inlet: &RefCell<Inlet>) {
        self.waiting.advance(count);
        self.progress = Instant::now();
        if self.waiting.is_empty() && self.skipped > 0 {
            let text = format!(
                "the application at {} reads again; {} bytes were recorded but not passed on to it",
                self.path.display(),
                std::mem::take(&mut self.skipped)
            );
            inlet.borrow_mut().notice(Level::Warning, text);
        }
    }

    /// True if the application is there but has taken nothing for so long that bytes are recorded
    /// without being passed on, until everything that waits is taken.
    fn is_stalled(&self) -> bool {
        self.skipped > 0
            || (!self.may_hold && self.waiting.room() == 0 && self.progress.elapsed() >= STALLED)
    }

    /// The path of the pseudo-terminal itself.
    pub fn path(&self) -> &Path {
        &self.path
    }
}
