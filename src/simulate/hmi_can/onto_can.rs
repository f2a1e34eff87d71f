//! The station's controllers on a CAN interface.

use std::io;
use std::os::fd::{AsFd as _, OwnedFd};
use std::time::Duration;

use nix::errno::Errno;
use socketcan::{CanDataFrame, CanErrorFrame, CanFrame as SocketFrame, CanRemoteFrame};
use socketcan::{CanSocket, EmbeddedFrame as _, ExtendedId, Frame as _, Socket as _};
use tokio::io::Interest;
use tokio::time::{Instant, sleep, sleep_until};

use super::HmiCan;
use crate::frame::{CanFlags, CanFrame};
use crate::permit::Permit;
use crate::sys::Waiting;
use crate::sys::link::Link;

/// An interface on which frames are sent. Capture has nothing of the kind.
pub struct Transmitter {
    socket: CanSocket,
    waiting: Waiting<OwnedFd>,
}

impl Transmitter {
    /// Opens the interface that was judged to be `link`, whatever has that name by now. Needs a
    /// tokio runtime.
    ///
    /// # Errors
    /// Where there is no such interface any more, or no CAN.
    pub fn open(link: &Link, _permit: &Permit) -> io::Result<Self> {
        let socket = CanSocket::open_iface(link.index)?;
        socket.set_nonblocking(true)?;
        let waiting = Waiting::new(socket.as_fd().try_clone_to_owned()?, Interest::READABLE)?;
        Ok(Self { socket, waiting })
    }

    async fn send(&self, frame: &CanFrame) -> io::Result<()> {
        let Some(frame) = to_socket(frame) else { return Ok(()) };
        while let Err(error) = self.socket.write_frame(&frame) {
            // A full transmit queue empties by itself.
            let full = error.kind() == io::ErrorKind::WouldBlock
                || error.raw_os_error() == Some(Errno::ENOBUFS as i32);
            if !full {
                return Err(error);
            }
            sleep(Duration::from_millis(1)).await;
        }
        Ok(())
    }

    /// Waits for a frame that somebody else sends.
    async fn receive(&self) -> io::Result<CanFrame> {
        loop {
            match self.waiting.act(Interest::READABLE, |_| self.socket.read_frame()).await {
                Ok(frame) => return Ok(from_socket(&frame)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// Sends the frames of `bus` at their times, and lets it hear what others send.
///
/// # Errors
/// When the interface goes down or away.
pub async fn play(mut bus: HmiCan, interface: &Transmitter) -> io::Result<()> {
    let start = Instant::now();
    loop {
        let (offset, frames) = bus.step();
        let due = start + Duration::from_nanos(offset);
        loop {
            tokio::select! {
                () = sleep_until(due) => break,
                frame = interface.receive() => {
                    let now = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
                    bus.hear(now, &frame?);
                }
            }
        }
        for frame in &frames {
            interface.send(frame).await?;
        }
    }
}

/// The station sends extended classic frames only (HMI CAN protocol, section 2).
fn to_socket(frame: &CanFrame) -> Option<SocketFrame> {
    if frame.flags.has(CanFlags::ERROR) {
        return CanErrorFrame::new_error(frame.id, frame.data()).ok().map(SocketFrame::Error);
    }
    let id = ExtendedId::new(frame.id)?;
    if frame.flags.has(CanFlags::REMOTE) {
        return CanRemoteFrame::new_remote(id, usize::from(frame.dlc)).map(SocketFrame::Remote);
    }
    CanDataFrame::new(id, frame.data()).map(SocketFrame::Data)
}

fn from_socket(frame: &SocketFrame) -> CanFrame {
    let mut flags = CanFlags::default();
    for (is_set, flag) in [
        (frame.is_extended(), CanFlags::EXTENDED),
        (frame.is_remote_frame(), CanFlags::REMOTE),
        (frame.is_error_frame(), CanFlags::ERROR),
    ] {
        if is_set {
            flags |= flag;
        }
    }
    let data = if frame.is_remote_frame() { &[] } else { frame.data() };
    CanFrame::new(frame.raw_id(), flags, data)
}
