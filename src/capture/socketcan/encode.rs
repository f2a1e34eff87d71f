//! From a CAN frame to the kernel's bytes: the way back of `message.rs`. Sends nothing.
//!
//! Source: `linux/can.h` (struct can_frame, struct canfd_frame).

use crate::frame::{CanFlags, CanFrame};
use crate::sys::WireFrame;

/// `CANFD_FDF` of `linux/can.h`, which marks a CAN FD frame since kernel 6.1; older ones ignore it.
const FDF: i32 = 0x04;

/// The kernel's form of a frame. `None` for an error frame: a host reports these, it does not send
/// them.
pub fn encode(frame: &CanFrame) -> Option<WireFrame> {
    let has = |flag| frame.flags.has(flag);
    if has(CanFlags::ERROR) {
        return None;
    }
    let mut id = frame.id;
    if has(CanFlags::EXTENDED) {
        id = id & libc::CAN_EFF_MASK | libc::CAN_EFF_FLAG;
    } else {
        id &= libc::CAN_SFF_MASK;
    }
    let length = frame.data().len().to_le_bytes()[0];
    if has(CanFlags::FD) {
        let bit = |flag, bit: i32| if has(flag) { bit } else { 0 };
        let flags = FDF | bit(CanFlags::BRS, libc::CANFD_BRS) | bit(CanFlags::ESI, libc::CANFD_ESI);
        let mut bytes = [0; libc::CANFD_MTU];
        bytes[..4].copy_from_slice(&id.to_ne_bytes());
        bytes[4] = length;
        bytes[5] = flags.to_le_bytes()[0];
        bytes[8..8 + frame.data().len()].copy_from_slice(frame.data());
        return Some(WireFrame::fd(bytes));
    }
    let mut bytes = [0; libc::CAN_MTU];
    let data = &frame.data()[..frame.data().len().min(8)];
    if has(CanFlags::REMOTE) {
        id |= libc::CAN_RTR_FLAG;
        bytes[4] = frame.dlc.min(8);
    } else {
        bytes[4] = length.min(8);
        bytes[8..8 + data.len()].copy_from_slice(data);
    }
    bytes[..4].copy_from_slice(&id.to_ne_bytes());
    // The raw length code counts only where the length is 8.
    bytes[7] = if bytes[4] == 8 && (9..=15).contains(&frame.dlc) { frame.dlc } else { 0 };
    Some(WireFrame::classic(bytes))
}

#[cfg(test)]
mod tests {
    use super::super::message::decode;
    use super::*;
    use crate::sys::RawMessage;

    #[test]
    fn what_is_encoded_is_read_back_as_it_was() {
        let none = CanFlags::default();
        let (fd, ext) = (CanFlags::FD, CanFlags::EXTENDED);
        for frame in [
            CanFrame::new(0x7FF, none, &[]),
            CanFrame::new(0x123, none, &[1, 2, 3]),
            CanFrame::new(0x1FFF_FFFF, ext, &[9; 8]),
            CanFrame::new(0x123, none, &[7; 8]).with_dlc(12),
            CanFrame::new(0x123, CanFlags::REMOTE, &[]).with_dlc(5),
            CanFrame::new(0x0123_4567, ext | CanFlags::REMOTE, &[]),
            CanFrame::new(0x1, fd | CanFlags::BRS, &[5; 64]),
            CanFrame::new(0x1, fd | ext | CanFlags::ESI, &[5; 12]),
            CanFrame::new(0x1, fd, &[]),
        ] {
            let wire = encode(&frame).unwrap();
            let read = decode(RawMessage { payload: wire.bytes(), control: &[], flags: 0 });
            assert_eq!(read.unwrap().frame, frame);
        }
    }

    #[test]
    fn error_frames_have_no_form_that_could_be_sent() {
        assert_eq!(encode(&CanFrame::new(4, CanFlags::ERROR, &[0; 8])), None);
    }
}
