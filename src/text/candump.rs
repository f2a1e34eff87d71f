//! A CAN frame as candump's log format has it (can-utils, `lib.c`, `sprint_canframe`).

use crate::frame::{CanFlags, CanFrame};

const HEX: &[u8; 16] = b"0123456789ABCDEF";

/// `CAN_ERR_FLAG` of `linux/can.h`, which candump shows in the identifier of an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// `CANFD_FDF` of `linux/can.h`: kernels since 6.1 set it in every CAN FD frame they deliver, and
/// candump prints it.
const FDF: u8 = 0x04;

/// Appends a frame: `123#DEADBEEF`, `12345678#R`, `123##5AABB`, `20000004#0001...`.
pub fn put(out: &mut Vec<u8>, frame: &CanFrame) {
    if frame.flags.has(CanFlags::ERROR) {
        put_digits(out, frame.id | ERROR_FLAG, 8);
    } else if frame.flags.has(CanFlags::EXTENDED) {
        put_digits(out, frame.id, 8);
    } else {
        put_digits(out, frame.id, 3);
    }
    out.push(b'#');
    if frame.flags.has(CanFlags::REMOTE) {
        out.push(b'R');
        if frame.dlc > 0 {
            out.push(digit(frame.dlc.min(8)));
        }
    } else if frame.flags.has(CanFlags::FD) {
        let brs = u8::from(frame.flags.has(CanFlags::BRS));
        let esi = u8::from(frame.flags.has(CanFlags::ESI)) << 1;
        out.extend_from_slice(&[b'#', digit(FDF | esi | brs)]);
    }
    if !frame.flags.has(CanFlags::REMOTE) {
        for byte in frame.data() {
            out.extend_from_slice(&[digit(byte >> 4), digit(*byte)]);
        }
    }
    // Behind eight bytes, or behind the wish for them.
    if frame.dlc > 8 {
        out.extend_from_slice(&[b'_', digit(frame.dlc)]);
    }
}

/// Appends ` T` for a frame the recording host sent, ` R` for one it received.
pub fn put_direction(out: &mut Vec<u8>, frame: &CanFrame) {
    let sent = frame.flags.has(CanFlags::TX);
    out.extend_from_slice(if sent { b" T" } else { b" R" });
}

fn put_digits(out: &mut Vec<u8>, value: u32, count: u32) {
    for place in (0..count).rev() {
        out.push(digit((value >> (4 * place)).to_le_bytes()[0]));
    }
}

fn digit(value: u8) -> u8 {
    HEX[usize::from(value & 15)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(frame: &CanFrame) -> String {
        let mut out = Vec::new();
        put(&mut out, frame);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn frames_look_as_candump_prints_them() {
        let frame = |id, flags, data: &[u8]| CanFrame::new(id, flags, data);
        let none = CanFlags::default();
        assert_eq!(text(&frame(0x123, none, &[0xDE, 0xAD])), "123#DEAD");
        assert_eq!(text(&frame(0x1, CanFlags::EXTENDED, &[])), "00000001#");
        assert_eq!(text(&frame(0x7FF, CanFlags::REMOTE, &[]).with_dlc(4)), "7FF#R4");
        assert_eq!(text(&frame(0x7FF, CanFlags::REMOTE, &[])), "7FF#R");
        assert_eq!(text(&frame(0x7FF, CanFlags::REMOTE, &[]).with_dlc(12)), "7FF#R8_C");
        assert_eq!(text(&frame(4, CanFlags::ERROR, &[0; 8])), "20000004#0000000000000000");
        assert_eq!(text(&frame(0x123, none, &[1; 8]).with_dlc(12)), "123#0101010101010101_C");
        assert_eq!(text(&frame(0x123, CanFlags::FD | CanFlags::BRS, &[7])), "123##507");
    }
}
