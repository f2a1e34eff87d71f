//! The station's frames on a CAN interface, as a controller would send them.

use std::io;
use std::time::Duration;

use socketcan::{CanDataFrame, CanFrame as SocketFrame, CanRemoteFrame, EmbeddedFrame as _};
use socketcan::{ExtendedId, Socket as _};
use tokio::time::{Instant, sleep, sleep_until};

use super::HmiCan;
use crate::frame::{CanFlags, CanFrame};

/// Sends the frames of `bus` on `socket` at their times until the interface is gone.
pub async fn send(bus: HmiCan, socket: socketcan::CanSocket) {
    let start = Instant::now();
    for (offset, frame) in bus {
        sleep_until(start + Duration::from_nanos(offset)).await;
        let Some(frame) = to_socket(&frame) else { continue };
        while let Err(error) = socket.write_frame(&frame) {
            match error.kind() {
                // A full transmit queue empties by itself.
                io::ErrorKind::WouldBlock => sleep(Duration::from_millis(1)).await,
                _ => return,
            }
        }
    }
}

/// The station sends extended classic frames only (HMI CAN protocol, section 2).
fn to_socket(frame: &CanFrame) -> Option<SocketFrame> {
    let id = ExtendedId::new(frame.id)?;
    if frame.flags.has(CanFlags::REMOTE) {
        return CanRemoteFrame::new_remote(id, usize::from(frame.dlc)).map(SocketFrame::Remote);
    }
    CanDataFrame::new(id, frame.data()).map(SocketFrame::Data)
}
