//! An open port on the event loop: reads become frames, loss counters become gaps.

use std::cell::RefCell;
use std::io;

use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::marks::Unmarker;
use super::open::{Opened, PortSpec, Use};
use super::settings::Parity;
use crate::frame::{Direction, Frame, GapReason, SerialBytes, Timestamp};
use crate::queue::Inlet;
use crate::sys::tty::{Counts, Tty};
use crate::sys::wait::register;

/// Room for one read. The kernel's own buffer for a tty is 4 KiB, a pseudo-terminal's master may
/// hand over more at once.
pub(crate) const READ_BYTES: usize = 64 << 10;

/// After a read of fewer bytes nothing is left: half the kernel's buffer for a line. When that
/// buffer is full, more bytes wait behind it, and reading on is the sure way to get them.
const FEW: usize = 2 << 10;

/// An open port.
pub(crate) struct Port {
    tty: AsyncFd<Tty>,
    unmarker: Option<Unmarker>,
    direction: Direction,
    counts: Option<Counts>,
    /// Lost bytes are what the bus counts. Otherwise nobody knows how many frames they were.
    counts_bytes: bool,
    /// The last moment at which the port was seen to be there.
    alive: Timestamp,
}

impl Port {
    /// Puts an opened port on the event loop. Call it on the runtime.
    pub fn new(
        opened: Opened,
        spec: &PortSpec,
        direction: Direction,
        inlet: &RefCell<Inlet>,
    ) -> io::Result<Self> {
        let mut inlet = inlet.borrow_mut();
        for (level, text) in opened.notes {
            inlet.notice(level, text);
        }
        let parity = spec.settings.parity != Parity::None;
        // Whoever never writes need not be woken for room.
        let interest = match spec.purpose {
            Use::Listen => Interest::READABLE,
            Use::Talk | Use::Adapter => Interest::READABLE | Interest::WRITABLE,
        };
        Ok(Self {
            counts: opened.tty.counts(),
            unmarker: opened.marked.then(|| Unmarker::new(parity)),
            tty: register(opened.tty, interest)?,
            direction,
            counts_bytes: spec.purpose != Use::Adapter,
            alive: inlet.timeline().now(),
        })
    }

    /// Waits for bytes. Safe to cancel. An error means that the device is gone.
    pub async fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let mut ready = self.tty.ready(Interest::READABLE).await?;
            let Ok(read) = ready.try_io(|tty| tty.get_ref().read(buffer)) else { continue };
            let length = read?;
            if length < FEW {
                // That was all, and what comes now is signalled anew: saves a read that finds
                // nothing after each that finds something.
                ready.clear_ready();
            }
            return if length == 0 { Err(hung_up()) } else { Ok(length) };
        }
    }

    /// Reads what is there now; `Ok(0)` if nothing.
    pub fn read_now(&self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.tty.get_ref().read(buffer) {
            Ok(0) => Err(hung_up()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(0),
            other => other,
        }
    }

    /// Waits for room and writes what fits. Safe to cancel.
    pub async fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        self.tty.async_io(Interest::WRITABLE, |tty| tty.write(bytes)).await
    }

    /// Writes what fits now.
    pub fn write_now(&self, bytes: &[u8]) -> io::Result<usize> {
        or_nothing(self.tty.get_ref().write(bytes))
    }

    /// Bytes written but not sent yet.
    pub fn unsent(&self) -> usize {
        self.tty.get_ref().unsent()
    }

    /// The last moment at which the port was seen to be there.
    pub fn alive(&self) -> Timestamp {
        self.alive
    }

    /// What one read returned, as a frame's content. `None` if it was only half an error mark.
    pub fn unmark(&mut self, time: Timestamp, read: &[u8]) -> Option<SerialBytes> {
        self.alive = time;
        let (mut data, mut errors) = (Vec::with_capacity(read.len()), Vec::new());
        match &mut self.unmarker {
            Some(unmarker) => unmarker.feed(read, &mut data, &mut errors),
            None => data.extend_from_slice(read),
        }
        (!data.is_empty()).then_some(SerialBytes { direction: self.direction, data, errors })
    }

    /// Notes that something was read at `time`.
    pub fn heard(&mut self, time: Timestamp) {
        self.alive = time;
    }

    /// Records what one read returned.
    pub fn record(&mut self, inlet: &RefCell<Inlet>, read: &[u8]) {
        let mut inlet = inlet.borrow_mut();
        let time = inlet.timeline().now();
        if let Some(bytes) = self.unmark(time, read) {
            inlet.push_one(time, Frame::Serial(bytes));
        }
    }

    /// Looks whether the driver counted lost bytes since the last look (once a second and at the
    /// end). Each overrun stands for at least one byte. Where in the stream they are missing is
    /// not known, only between which times; so they are a gap and not line errors.
    pub fn check_overruns(&mut self, inlet: &RefCell<Inlet>) {
        let mut inlet = inlet.borrow_mut();
        let time = inlet.timeline().now();
        let Some(now) = self.tty.get_ref().counts() else {
            // A driver without counters: whether the port is there can be asked otherwise.
            if self.counts.is_none() && self.tty.get_ref().format_flags().is_ok() {
                self.alive = time;
            }
            return;
        };
        if let Some(lost) = self.counts.replace(now).map(|before| lost_between(before, now))
            && lost > 0
        {
            let count = if self.counts_bytes { lost } else { 0 };
            inlet.gap(GapReason::Overrun, count, self.alive, time);
        }
        self.alive = time;
    }
}

/// The counters are the kernel's `int`s, which wrap. A driver that starts anew (counting from 0)
/// must not look like billions of lost bytes, so a step back counts what is there since.
fn lost_between(before: Counts, now: Counts) -> u64 {
    let step = |before: u32, now: u32| {
        let step = now.wrapping_sub(before);
        u64::from(if step < 1 << 31 { step } else { now })
    };
    step(before.overrun, now.overrun) + step(before.buffer_overrun, now.buffer_overrun)
}

fn hung_up() -> io::Error {
    io::Error::other("the device hung up")
}

/// A write that found no room wrote nothing.
pub(crate) fn or_nothing(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(0),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overruns_are_counted_across_wrapping_and_a_driver_that_starts_anew() {
        let counts = |overrun, buffer_overrun| Counts { overrun, buffer_overrun };
        assert_eq!(lost_between(counts(3, 4), counts(3, 4)), 0);
        assert_eq!(lost_between(counts(3, 4), counts(5, 10)), 8);
        assert_eq!(lost_between(counts(u32::MAX, 0), counts(1, 0)), 2);
        assert_eq!(lost_between(counts(900, 0), counts(2, 0)), 2);
    }
}
