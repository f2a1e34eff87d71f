//! Onto a pseudo-terminal that somebody opens, leaves and opens again, or never opens at all.

use std::io;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::path::Path;
use std::time::{Duration, Instant};

use super::{Blocked, Due, Heard, Sink, Took};
use crate::capture::serial::{Link, holders, linked};
use crate::frame::Frame;
use crate::replay::ReplayError;
use crate::replay::tally::NotSent;
use crate::sys::opens::Opens;
use crate::sys::pty::Pty;

/// A reader that takes nothing for this long no longer holds up the replay: a real port would have
/// lost its bytes long before.
const STALLED: Duration = Duration::from_secs(1);

/// How long to wait for room at a time.
const LOOK: Duration = Duration::from_millis(2);

/// At the end everything is read when nothing was left for so long. The kernel moves bytes into the
/// reader's buffer, the only one that can be asked, a moment after that has room.
const READ_OUT: Duration = Duration::from_millis(50);

/// A pseudo-terminal and its link.
pub struct PtySink {
    pty: Pty,
    _link: Link,
    opens: Opens,
    present: bool,
    /// Bytes of the first piece that are gone already.
    offset: usize,
    /// Since when nothing was taken.
    stuck: Option<Instant>,
    /// At the end: since when everything seems to be read.
    read_out: Option<Instant>,
}

impl PtySink {
    /// Makes a pseudo-terminal, raw from the start, and links it at `path`.
    pub fn open(path: &Path) -> Result<Self, ReplayError> {
        let (pty, link) = linked(path).map_err(|error| ReplayError(error.0))?;
        let opens = Opens::watch(pty.path())
            .map_err(|e| ReplayError(format!("cannot watch {}: {e}", pty.path().display())))?;
        Ok(Self { pty, _link: link, opens, present: false, offset: 0, stuck: None, read_out: None })
    }

    /// Looks whether anybody is there. What the last one did not read goes with it: the next one
    /// must not find a stranger's bytes.
    fn look(&mut self) {
        let mut count = self.opens.count();
        if self.opens.take_news() && count == 0 {
            // 0 may be one opening too few; more than 0 is certain.
            count = holders(self.pty.path()).len() as u64;
            self.opens.correct(count);
        }
        if self.present && count == 0 {
            // Only the next reader's comfort; nothing of the replay depends on it.
            let _ = self.pty.discard_unread();
            self.offset = 0;
            self.stuck = None;
        }
        self.present = count > 0;
    }

    /// Nothing is taken now: waits, or after too long goes on without the reader.
    fn stall(&mut self, done: usize, offered: usize) -> Took {
        if done > 0 {
            self.stuck = None;
        }
        if self.stuck.get_or_insert_with(Instant::now).elapsed() < STALLED {
            // Looks again by itself, since neither a reader that leaves nor one that reads no more
            // makes room.
            return Took::blocked(done, Blocked::For(LOOK));
        }
        self.offset = 0;
        Took::omitted(offered, NotSent::NotRead)
    }
}

impl Sink for PtySink {
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
        self.look();
        if !self.present {
            return Ok(Took::omitted(front.len(), NotSent::NobodyThere));
        }
        for (done, due) in front.iter().enumerate() {
            let Frame::Serial(bytes) = &due.item.frame else { continue };
            while let Some(rest) = bytes.data.get(self.offset..).filter(|rest| !rest.is_empty()) {
                match self.pty.write(rest) {
                    Ok(written) => {
                        self.offset += written;
                        self.stuck = None;
                    }
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                        return Ok(self.stall(done, front.len()));
                    }
                    Err(error) => {
                        let path = self.pty.path().display();
                        return Err(ReplayError(format!("writing to {path} failed: {error}")));
                    }
                }
            }
            self.offset = 0;
        }
        Ok(Took::sent(front.len()))
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.pty.as_fd())
    }

    fn listens(&self) -> bool {
        true
    }

    fn hear(&mut self, take: &mut dyn FnMut(Heard<'_>)) -> Result<(), ReplayError> {
        let mut buffer = [0; 4096];
        loop {
            match self.pty.read(&mut buffer) {
                Ok(0) => return Ok(()),
                Ok(length) => take(Heard::Serial(&buffer[..length])),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) => {
                    let path = self.pty.path().display();
                    return Err(ReplayError(format!("reading from {path} failed: {error}")));
                }
            }
        }
    }

    fn finish(&mut self) -> Result<bool, ReplayError> {
        // With the pseudo-terminal goes what was not read.
        self.look();
        if !self.present {
            return Ok(true);
        }
        if self.pty.unread() > 0 {
            self.read_out = None;
            return Ok(false);
        }
        // More may be on its way in the kernel, where it is not counted.
        Ok(self.read_out.get_or_insert_with(Instant::now).elapsed() >= READ_OUT)
    }
}
