//! Onto a CAN adapter that speaks the Lawicel ASCII protocol.
//!
//! Sources: the CANUSB manual of Lawicel AB: a transmitted frame is acknowledged by `z` or `Z` and
//! CR, or refused by BELL while the adapter's queue is full.

use std::io;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::time::{Duration, Instant};

use super::{Blocked, Due, Heard, Sink, Took};
use crate::capture::serial::{PortSpec, SerialSettings, Use};
use crate::capture::slcan::codec::{self, Line};
use crate::capture::slcan::{Cut, Lines, SlcanAddress, set_up};
use crate::frame::Frame;
use crate::permit::Permit;
use crate::replay::ReplayError;
use crate::replay::tally::NotSent;
use crate::sys::tty::Tty;

/// An adapter that has not acknowledged a frame for this long does not acknowledge frames at all,
/// as some firmwares do not.
const PATIENCE: Duration = Duration::from_millis(500);
/// The answer to a frame wakes whoever waits for it; this is for adapters that do not answer.
const LOOK: Duration = Duration::from_millis(5);
/// How long a refused frame waits before it is offered again.
const AGAIN: Duration = Duration::from_millis(2);
/// A frame refused for so long is given up.
const GIVE_UP: Duration = Duration::from_secs(2);

/// An adapter with its channel open.
pub struct SlcanSink {
    address: SlcanAddress,
    tty: Tty,
    lines: Lines,
    /// What the adapter still has to say to the frame that was written last.
    awaiting: Option<Instant>,
    /// It was taken: the frame may be counted.
    taken: bool,
    /// Since when the first frame is refused.
    refused: Option<Instant>,
    /// When it was refused last.
    bell: Option<Instant>,
    acknowledges: bool,
    /// Of the line being written.
    rest: Vec<u8>,
    heard: Vec<crate::frame::CanFrame>,
    notes: Vec<String>,
    closing: bool,
}

impl SlcanSink {
    /// Opens the port, sets the adapter up and opens its channel.
    pub fn open(address: SlcanAddress, _permit: &Permit) -> Result<Self, ReplayError> {
        let say = |error: crate::capture::CaptureError| ReplayError(error.0);
        let settings = SerialSettings::new(address.baud);
        let (_, opened) =
            PortSpec::open_first(address.path.clone(), settings, Use::Adapter).map_err(say)?;
        let acknowledges = set_up(&opened.tty, &address).map_err(say)?;
        let sink = Self {
            address,
            tty: opened.tty,
            lines: Lines::default(),
            // The answer to O comes like that to a frame.
            awaiting: acknowledges.then(Instant::now),
            taken: false,
            refused: None,
            bell: None,
            acknowledges,
            rest: Vec::new(),
            heard: Vec::new(),
            notes: opened.notes.into_iter().map(|(_, text)| text).collect(),
            closing: false,
        };
        sink.tty.write(b"O\r").map_err(|error| sink.trouble(&error))?;
        sink.opened()
    }

    /// Waits for the answer to `O`.
    fn opened(mut self) -> Result<Self, ReplayError> {
        while let Some(since) = self.awaiting {
            self.listen()?;
            if self.refused.take().is_some() {
                return Err(ReplayError(format!(
                    "the adapter at {} refused O (open the channel); unplug it and try again",
                    self.address.path.display()
                )));
            }
            if since.elapsed() >= PATIENCE {
                self.awaiting = None;
            } else {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        self.taken = false;
        Ok(self)
    }

    fn trouble(&self, error: &io::Error) -> ReplayError {
        let path = self.address.path.display();
        ReplayError(format!("the adapter at {path} went away: {error}"))
    }

    /// Takes what the adapter said.
    fn listen(&mut self) -> Result<(), ReplayError> {
        let mut buffer = [0; 4096];
        loop {
            let length = match self.tty.read(&mut buffer) {
                Ok(0) => return Err(self.trouble(&io::Error::other("it hung up"))),
                Ok(length) => length,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(self.trouble(&error)),
            };
            let mut lines = std::mem::take(&mut self.lines);
            lines.feed(&buffer[..length], |cut| match cut {
                Cut::Line(line) => match codec::decode(line) {
                    Line::Frame(frame, _) => self.heard.push(frame),
                    Line::Acknowledged if self.awaiting.take().is_some() => self.taken = true,
                    _ => {}
                },
                Cut::Refused if self.awaiting.take().is_some() => {
                    let now = *self.bell.insert(Instant::now());
                    self.refused.get_or_insert(now);
                }
                Cut::Refused | Cut::TooLong => {}
            });
            self.lines = lines;
        }
    }

    /// Writes what fits of the line; false if some of it is left.
    fn write(&mut self) -> Result<bool, ReplayError> {
        while !self.rest.is_empty() {
            match self.tty.write(&self.rest) {
                Ok(written) => drop(self.rest.drain(..written)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
                Err(error) => return Err(self.trouble(&error)),
            }
        }
        Ok(true)
    }

    /// What to do about a frame that was written and not answered yet; `None` if it was.
    fn waiting(&mut self) -> Option<Took> {
        let since = self.awaiting?;
        if since.elapsed() < PATIENCE {
            return Some(Took::blocked(0, Blocked::For(LOOK)));
        }
        self.awaiting = None;
        if self.acknowledges {
            self.acknowledges = false;
            let path = self.address.path.display();
            self.notes.push(format!(
                "the adapter at {path} does not acknowledge frames; whether it sent them is not \
                 known"
            ));
        }
        Some(Took::sent(1))
    }
}

impl Sink for SlcanSink {
    /// One frame at a time: only so their order stays when the adapter refuses one.
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
        self.listen()?;
        if !self.write()? {
            return Ok(Took::blocked(0, Blocked::Writable));
        }
        if let Some(took) = self.waiting() {
            return Ok(took);
        }
        if std::mem::take(&mut self.taken) {
            self.refused = None;
            return Ok(Took::sent(1));
        }
        if self.refused.is_some_and(|since| since.elapsed() >= GIVE_UP) {
            self.refused = None;
            return Ok(Took::omitted(1, NotSent::Refused));
        }
        if let Some(left) = self.bell.and_then(|bell| AGAIN.checked_sub(bell.elapsed())) {
            return Ok(Took::blocked(0, Blocked::For(left)));
        }
        let Some(Frame::Can(frame)) = front.first().map(|due| &due.item.frame) else {
            // Something else than a frame would be offered again and again.
            return Ok(Took::omitted(1, NotSent::ErrorFrame));
        };
        let Some(line) = codec::encode(frame) else {
            return Ok(Took::omitted(1, NotSent::ErrorFrame));
        };
        self.rest = line.into_bytes();
        let written = self.write()?;
        if self.acknowledges {
            self.awaiting = Some(Instant::now());
            return Ok(Took::blocked(0, Blocked::For(LOOK)));
        }
        Ok(if written { Took::sent(1) } else { Took::blocked(1, Blocked::Writable) })
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.tty.as_fd())
    }

    fn is_can(&self) -> bool {
        true
    }

    fn listens(&self) -> bool {
        true
    }

    fn hear(&mut self, take: &mut dyn FnMut(Heard<'_>)) -> Result<(), ReplayError> {
        self.listen()?;
        self.heard.drain(..).for_each(|frame| take(Heard::Can(frame)));
        Ok(())
    }

    fn finish(&mut self) -> Result<bool, ReplayError> {
        if self.tty.unsent() > 0 || !self.write()? {
            return Ok(false);
        }
        if !self.closing {
            self.closing = true;
            self.rest = b"C\r".to_vec();
            return Ok(self.write()? && self.tty.unsent() == 0);
        }
        Ok(true)
    }

    fn notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }
}

impl Drop for SlcanSink {
    /// However a replay ends, its adapter must not go on acknowledging frames on the bus.
    fn drop(&mut self) {
        if !std::mem::replace(&mut self.closing, true) && self.write().is_ok_and(|all| all) {
            // An adapter that is gone needs no closing.
            let _ = self.tty.write(b"C\r");
        }
    }
}
