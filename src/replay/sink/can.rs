//! Onto a SocketCAN interface.

use std::io;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::time::Duration;

use super::{Blocked, Due, Heard, Sink, Took};
use crate::capture::socketcan::{decode_frame, encode};
use crate::frame::Frame;
use crate::permit::Permit;
use crate::replay::ReplayError;
use crate::replay::tally::NotSent;
use crate::sys::link::Link;
use crate::sys::{CanBatch, CanSender, SEND_BATCH, WireFrame};

/// `CANFD_MTU` of `linux/can.h`: an interface with this MTU takes CAN FD frames.
pub const FD_MTU: u32 = 72;

/// How long to wait for room in a transmit queue: a frame takes 50 µs at 1 Mbit/s at the least.
const SHORTEST_WAIT: Duration = Duration::from_micros(100);
const LONGEST_WAIT: Duration = Duration::from_millis(2);

/// A CAN interface.
pub struct CanSink {
    interface: String,
    sender: CanSender,
    wires: Vec<WireFrame>,
    wait: Duration,
    listening: Option<CanBatch>,
}

impl CanSink {
    /// Opens the interface that was judged to be `link`.
    pub fn open(link: &Link, listen: bool, _permit: &Permit) -> Result<Self, ReplayError> {
        let failed = |error: io::Error| {
            ReplayError(format!("cannot open {} for sending: {error}", link.name))
        };
        let sender = CanSender::open(link.index, link.mtu >= FD_MTU).map_err(failed)?;
        if listen {
            sender.listen().map_err(failed)?;
        }
        let wires = Vec::with_capacity(SEND_BATCH);
        let listening = listen.then(CanBatch::new);
        Ok(Self { interface: link.name.clone(), sender, wires, wait: SHORTEST_WAIT, listening })
    }

    fn trouble(&self, error: &io::Error) -> ReplayError {
        let name = &self.interface;
        ReplayError(match error.raw_os_error() {
            Some(libc::ENETDOWN) => format!("{name} went down while it was played to"),
            Some(libc::ENXIO | libc::ENODEV) => {
                format!("{name} went away while it was played to")
            }
            _ => format!("sending to {name} failed: {error}"),
        })
    }
}

impl Sink for CanSink {
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
        self.wires.clear();
        for due in front.iter().take(SEND_BATCH) {
            let Frame::Can(frame) = &due.item.frame else { break };
            let Some(wire) = encode(frame) else { break };
            self.wires.push(wire);
        }
        if self.wires.is_empty() {
            return Ok(Took::omitted(1, NotSent::ErrorFrame));
        }
        match self.sender.send(&self.wires) {
            Ok(count) => {
                self.wait = SHORTEST_WAIT;
                Ok(Took::sent(count))
            }
            Err(error) => match error.raw_os_error() {
                // The queue below the socket is full, for which there is no event to wait for.
                Some(libc::ENOBUFS) => {
                    let wait = self.wait;
                    self.wait = (wait * 2).min(LONGEST_WAIT);
                    Ok(Took::blocked(0, Blocked::For(wait)))
                }
                Some(libc::EAGAIN) => Ok(Took::blocked(0, Blocked::Writable)),
                Some(libc::EINTR) => Ok(Took::sent(0)),
                _ => Err(self.trouble(&error)),
            },
        }
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.sender.as_fd())
    }

    fn is_can(&self) -> bool {
        true
    }

    fn listens(&self) -> bool {
        self.listening.is_some()
    }

    fn hear(&mut self, take: &mut dyn FnMut(Heard<'_>)) -> Result<(), ReplayError> {
        let Some(batch) = &mut self.listening else { return Ok(()) };
        let received = self.sender.receive(batch);
        match received {
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
            Err(error) => return Err(self.trouble(&error)),
        }
        batch.messages().filter_map(decode_frame).for_each(|frame| take(Heard::Can(frame)));
        Ok(())
    }
}
