//! Errors as controllers report them, in the words of `linux/can/error.h`.

use crate::frame::{CanFlags, CanFrame};

/// `CAN_ERR_BUSERROR`: something was wrong on the bus.
pub(super) const BUS_ERROR: u32 = 0x80;
/// `CAN_ERR_PROT`: a frame was not as the protocol wants it; details in bytes 2 and 3.
const PROTOCOL: u32 = 0x08;
/// All classes there are (`CAN_ERR_TX_TIMEOUT` to `CAN_ERR_CNT`).
const CLASSES: u32 = 0x3FF;

/// True when `id` can be an error class of the kernel.
pub(super) fn is_class(id: u32) -> bool {
    id & !CLASSES == 0
}

/// An error frame from the error code capture register of an SJA1000, if it is known to be one:
/// bits 7..6 bit, form, stuff or other error; bit 5 while receiving; bits 4..0 where in the frame
/// (data sheet SJA1000, section 6.4.9; the kernel passes the place on unchanged).
pub(super) fn frame(known: bool, code: u8) -> CanFrame {
    let mut details = [0; 8];
    if !known {
        return CanFrame::new(BUS_ERROR, CanFlags::ERROR, &details);
    }
    // CAN_ERR_PROT_BIT, _FORM, _STUFF; others are unspecified. CAN_ERR_PROT_TX when sending.
    details[2] = [0x01, 0x02, 0x04, 0x00][usize::from(code >> 6)];
    if code & 0x20 == 0 {
        details[2] |= 0x80;
    }
    details[3] = code & 0x1F;
    CanFrame::new(BUS_ERROR | PROTOCOL, CanFlags::ERROR, &details)
}
