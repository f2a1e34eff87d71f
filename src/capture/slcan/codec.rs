//! The Lawicel ASCII protocol: one line, one frame.
//!
//! Sources: the CANUSB manual of Lawicel AB for `t T r R`, the answer to `F` and the millisecond
//! stamp; the Linux driver `drivers/net/can/slcan` for `s` and `e`; the CANable 2 firmware for the
//! CAN FD letters `d D b B` (there is no standard for these).

use crate::frame::{CanFlags, CanFrame, FD_LENGTHS, fd_dlc};

/// What an adapter says in one line (without the CR or BELL that ends it).
#[derive(Clone, Debug, PartialEq)]
pub enum Line {
    /// A frame from the bus, and the adapter's stamp: milliseconds, 0 to 59,999, then from 0.
    Frame(CanFrame, Option<u16>),
    /// Status flags, the answer to `F`.
    Status(u8),
    /// An acknowledgement: an empty line, or `z` or `Z` for a transmitted frame.
    Acknowledged,
    /// Something that needs no attention, such as a version or serial number.
    Information,
    /// Nothing this protocol has.
    Garbage,
}

/// Flags in the answer to `F`.
pub mod status {
    /// The adapter's receive buffer is full.
    pub const RX_FULL: u8 = 0x01;
    /// The controller lost a frame (data overrun).
    pub const OVERRUN: u8 = 0x08;
}

const LAST_MILLISECOND: u16 = 59_999;

/// Reads one line.
pub fn decode(line: &[u8]) -> Line {
    let Some((&letter, rest)) = line.split_first() else { return Line::Acknowledged };
    let line = match letter {
        b't' | b'T' | b'r' | b'R' | b'd' | b'D' | b'b' | b'B' => frame(letter, rest),
        b'F' => hex(rest, 2).and_then(|v| u8::try_from(v).ok()).map(Line::Status),
        b's' => state(rest),
        b'e' => errors(rest),
        b'z' | b'Z' if rest.is_empty() => Some(Line::Acknowledged),
        b'V' | b'v' | b'N' => Some(Line::Information),
        _ => None,
    };
    line.unwrap_or(Line::Garbage)
}

/// All of `digits` as a hexadecimal number, if there are exactly `count` of them.
fn hex(digits: &[u8], count: usize) -> Option<u32> {
    if digits.len() != count {
        return None;
    }
    digits.iter().try_fold(0, |value, &d| Some(value << 4 | (d as char).to_digit(16)?))
}

fn frame(letter: u8, rest: &[u8]) -> Option<Line> {
    let mut flags = CanFlags::default();
    for (letters, flag) in [
        (b"TRDB", CanFlags::EXTENDED),
        (b"rRrR", CanFlags::REMOTE),
        (b"dDbB", CanFlags::FD),
        (b"bBbB", CanFlags::BRS),
    ] {
        if letters.contains(&letter) {
            flags |= flag;
        }
    }
    let digits = if flags.has(CanFlags::EXTENDED) { 8 } else { 3 };
    let (id, rest) = rest.split_at_checked(digits)?;
    let id = hex(id, digits)?;
    if id > if digits == 8 { 0x1FFF_FFFF } else { 0x7FF } {
        return None;
    }
    let (dlc, rest) = rest.split_at_checked(1)?;
    let dlc = u8::try_from(hex(dlc, 1)?).ok()?;
    let length = match flags {
        _ if flags.has(CanFlags::REMOTE) => 0,
        _ if flags.has(CanFlags::FD) => usize::from(FD_LENGTHS[usize::from(dlc)]),
        // A classic frame may say 9 to 15 on the bus and still carries 8 bytes.
        _ => usize::from(dlc.min(8)),
    };
    let (digits, stamp) = rest.split_at_checked(length * 2)?;
    let mut data = [0; 64];
    for (byte, pair) in data.iter_mut().zip(digits.chunks(2)) {
        *byte = u8::try_from(hex(pair, 2)?).ok()?;
    }
    let frame = CanFrame::new(id, flags, &data[..length]);
    let beyond = flags.has(CanFlags::REMOTE) || (!flags.has(CanFlags::FD) && dlc > 8);
    Some(Line::Frame(frame.with_dlc(if beyond { dlc } else { 0 }), milliseconds(stamp)?))
}

/// The stamp behind a frame: none, or four digits. `None` if it is something else.
fn milliseconds(stamp: &[u8]) -> Option<Option<u16>> {
    match stamp.len() {
        0 => Some(None),
        4 => u16::try_from(hex(stamp, 4)?).ok().filter(|&ms| ms <= LAST_MILLISECOND).map(Some),
        // Some firmware sends microseconds in eight digits. They are not used.
        8 => hex(stamp, 8).map(|_| None),
        _ => None,
    }
}

/// Bits and bytes of error frames as in `linux/can/error.h`.
mod error {
    pub const CONTROLLER: u32 = 0x004;
    pub const PROTOCOL: u32 = 0x008;
    pub const NO_ACK: u32 = 0x020;
    pub const BUS_OFF: u32 = 0x040;
    pub const BUS_ERROR: u32 = 0x080;
    pub const COUNTERS: u32 = 0x200;
    pub const RX_OVERFLOW: u8 = 0x01;
    pub const TX_OVERFLOW: u8 = 0x02;
    pub const FORM: u8 = 0x02;
    pub const STUFF: u8 = 0x04;
    pub const BIT0: u8 = 0x08;
    pub const BIT1: u8 = 0x10;
    pub const AT_CRC: u8 = 0x08;
    pub const AT_ACK: u8 = 0x19;
}

/// `sa057033`: state (a active, w warning, p passive, b bus-off), then the receive and transmit
/// error counters in three decimal digits each. Becomes an error frame, as in the kernel.
fn state(rest: &[u8]) -> Option<Line> {
    let (&state, counters) = rest.split_first()?;
    let counters = std::str::from_utf8(counters).ok().filter(|c| c.len() == 6 && c.is_ascii())?;
    let counter = |text: &str| text.parse::<u16>().ok().map(|n| n.to_le_bytes()[0]);
    let (rx, tx) = (counter(&counters[..3])?, counter(&counters[3..])?);
    // CAN_ERR_CRTL_*: warning and passive for receiving (low bit) and transmitting, active again.
    let (class, detail) = match state {
        b'a' => (error::CONTROLLER | error::COUNTERS, 0x40),
        b'w' => (error::CONTROLLER | error::COUNTERS, if tx > rx { 0x08 } else { 0x04 }),
        b'p' => (error::CONTROLLER | error::COUNTERS, if tx > rx { 0x20 } else { 0x10 }),
        b'b' => (error::BUS_OFF | error::COUNTERS, 0),
        _ => return None,
    };
    let frame = CanFrame::new(class, CanFlags::ERROR, &[0, detail, 0, 0, 0, 0, tx, rx]);
    Some(Line::Frame(frame, None))
}

/// `e3bcO`: how many, then one letter an error. Becomes one error frame, as in the kernel.
fn errors(rest: &[u8]) -> Option<Line> {
    let (count, letters) = rest.split_at_checked(1)?;
    if usize::try_from(hex(count, 1)?).ok()? != letters.len() || letters.is_empty() {
        return None;
    }
    let (mut class, mut data) = (error::PROTOCOL | error::BUS_ERROR, [0; 8]);
    for letter in letters {
        match letter {
            b'a' => {
                class |= error::NO_ACK;
                data[3] = error::AT_ACK;
            }
            b'b' => data[2] |= error::BIT0,
            b'B' => data[2] |= error::BIT1,
            b'c' => data[3] = error::AT_CRC,
            b'f' => data[2] |= error::FORM,
            b's' => data[2] |= error::STUFF,
            b'o' => {
                class |= error::CONTROLLER;
                data[1] |= error::RX_OVERFLOW;
            }
            b'O' => {
                class |= error::CONTROLLER;
                data[1] |= error::TX_OVERFLOW;
            }
            _ => return None,
        }
    }
    Some(Line::Frame(CanFrame::new(class, CanFlags::ERROR, &data), None))
}

/// True for an error frame that says that the adapter lost received frames.
pub fn is_overflow(frame: &CanFrame) -> bool {
    frame.flags.has(CanFlags::ERROR)
        && frame.id & error::CONTROLLER != 0
        && frame.data().get(1).is_some_and(|d| d & error::RX_OVERFLOW != 0)
}

/// Writes a frame as a line, with its CR. `None` for an error frame, which has no line.
pub fn encode(frame: &CanFrame) -> Option<String> {
    use std::fmt::Write;
    let flags = frame.flags;
    if flags.has(CanFlags::ERROR) {
        return None;
    }
    let letter = match () {
        () if flags.has(CanFlags::FD | CanFlags::BRS) => 'b',
        () if flags.has(CanFlags::FD) => 'd',
        () if flags.has(CanFlags::REMOTE) => 'r',
        () => 't',
    };
    let mut line = String::with_capacity(11 + 2 * frame.data().len());
    // Writing to a String cannot fail.
    let _ = if flags.has(CanFlags::EXTENDED) {
        write!(line, "{}{:08X}", letter.to_ascii_uppercase(), frame.id)
    } else {
        write!(line, "{letter}{:03X}", frame.id)
    };
    let length = frame.data().len();
    let dlc = match frame.dlc {
        0 if flags.has(CanFlags::REMOTE) => 0,
        0 => usize::from(fd_dlc(length)),
        dlc => usize::from(dlc),
    };
    let _ = write!(line, "{dlc:X}");
    for byte in frame.data() {
        let _ = write!(line, "{byte:02X}");
    }
    // A length between two DLCs is filled up, as a CAN FD controller does.
    let fd = flags.has(CanFlags::FD);
    let padded = if fd { usize::from(FD_LENGTHS[dlc & 15]) } else { length };
    for _ in length..padded {
        line.push_str("00");
    }
    line.push('\r');
    Some(line)
}

#[cfg(test)]
#[path = "codec_tests.rs"]
mod tests;
