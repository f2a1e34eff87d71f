//! Frames on the line (Zhongheng 09-series RS232 protocol, section 3): start flag, address,
//! control byte, count of data bytes, data, CRC; escaped behind the start flag.

use crc::{CRC_16_XMODEM, Crc};

/// Starts a frame, and appears nowhere else on the line.
pub const START: u8 = 0x7E;
const ESCAPE: u8 = 0x7D;
const FLIP: u8 = 0x20;
/// Bytes around the data: start flag, address, control byte, count, CRC.
const OVERHEAD: usize = 7;
/// Most data bytes in one frame.
pub const MAX_DATA: usize = 255;

static CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_XMODEM);

/// Data link commands, bits 3..0 of the control byte (section 3.5).
pub mod link {
    #![allow(missing_docs, reason = "the names are the document's")]
    pub const CONNECT: u8 = 0;
    pub const DISCONNECT: u8 = 1;
    pub const SINGLE: u8 = 5;
    pub const ACKNOWLEDGE: u8 = 6;
    pub const BUFFER_OVERFLOW: u8 = 7;
    pub const ERROR: u8 = 8;
    pub const ADDRESS_ESTABLISH: u8 = 11;
    pub const ADDRESS_ACKNOWLEDGE: u8 = 12;
}

/// The control byte (section 3.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control(pub u8);

impl Control {
    /// Set in answers of a slave.
    pub const SLAVE: u8 = 0x80;
    /// The master expects an answer.
    pub const ACK: u8 = 0x40;
    /// Sequence bit.
    pub const SEQUENCE: u8 = 0x20;

    /// True for an answer of a slave.
    pub fn from_slave(self) -> bool {
        self.0 & Self::SLAVE != 0
    }

    /// True when an answer is expected.
    pub fn wants_answer(self) -> bool {
        self.0 & Self::ACK != 0
    }

    /// The sequence bit, where it stands in the byte.
    pub fn sequence(self) -> u8 {
        self.0 & Self::SEQUENCE
    }

    /// The data link command.
    pub fn link(self) -> u8 {
        self.0 & 0x0F
    }

    /// The control byte of the answer `link` to this one: same sequence bit.
    #[must_use]
    pub fn answer(self, link: u8) -> Self {
        Self(Self::SLAVE | self.sequence() | link)
    }
}

/// One frame, unescaped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Slave address, 0..=65535 (section 3.3).
    pub address: u16,
    /// Control byte.
    pub control: Control,
    /// At most 255 bytes.
    pub data: Vec<u8>,
}

/// Which bytes are escaped (section 3.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Escaping {
    /// 7E and 7D.
    Minimal,
    /// 7E, 7D and everything below 20: as the connect frame is printed.
    Full,
}

impl Frame {
    /// The bytes on the line. Data beyond 255 bytes are cut off, since no frame can carry them.
    pub fn encode(&self, escaping: Escaping) -> Vec<u8> {
        escape(&self.plain(self.count()), escaping)
    }

    /// The count of data bytes.
    pub fn count(&self) -> u8 {
        u8::try_from(self.data.len()).unwrap_or(u8::MAX)
    }

    /// The whole frame before it is escaped, with this count of data bytes, right or wrong.
    pub(super) fn plain(&self, count: u8) -> Vec<u8> {
        let data = &self.data[..self.data.len().min(MAX_DATA)];
        let mut plain = vec![START];
        plain.extend(self.address.to_be_bytes());
        plain.extend([self.control.0, count]);
        plain.extend(data);
        plain.extend(CRC.checksum(&plain).to_be_bytes());
        plain
    }
}

/// A whole frame as it goes onto the line.
pub(super) fn escape(plain: &[u8], escaping: Escaping) -> Vec<u8> {
    let mut line = vec![START];
    for byte in plain.iter().skip(1) {
        let control = escaping == Escaping::Full && *byte < 0x20;
        if control || *byte == START || *byte == ESCAPE {
            line.extend([ESCAPE, byte ^ FLIP]);
        } else {
            line.push(*byte);
        }
    }
    line
}

/// Finds frames in a stream of bytes, by the rules of section 10.1. Frames that are damaged are
/// dropped silently, as both ends of the line do.
#[derive(Clone, Debug, Default)]
pub struct Deframer {
    /// Unescaped bytes of the open frame with its start flag; empty outside of a frame.
    open: Vec<u8>,
    escaped: bool,
}

impl Deframer {
    /// Takes one byte and returns the frame that it completes.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if byte == START {
            self.open = vec![START];
            self.escaped = false;
            return None;
        }
        if self.open.is_empty() {
            return None;
        }
        if self.escaped {
            self.escaped = false;
            if !matches!(byte, 0x20..=0x3F | 0x5D | 0x5E) {
                self.open.clear();
                return None;
            }
            self.open.push(byte ^ FLIP);
        } else if byte == ESCAPE {
            self.escaped = true;
            return None;
        } else {
            self.open.push(byte);
        }
        self.complete()
    }

    fn complete(&mut self) -> Option<Frame> {
        let count = usize::from(*self.open.get(4)?);
        if self.open.len() < OVERHEAD + count {
            return None;
        }
        let bytes = std::mem::take(&mut self.open);
        // Over a frame with its own CRC the remainder is 0.
        if CRC.checksum(&bytes) != 0 {
            return None;
        }
        Some(Frame {
            address: u16::from_be_bytes([bytes[1], bytes[2]]),
            control: Control(bytes[3]),
            data: bytes[5..5 + count].to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(address: u16, control: u8, data: &[u8]) -> Frame {
        Frame { address, control: Control(control), data: data.to_vec() }
    }

    fn deframe(bytes: &[u8]) -> Vec<Frame> {
        let mut deframer = Deframer::default();
        bytes.iter().filter_map(|byte| deframer.push(*byte)).collect()
    }

    #[test]
    fn the_four_printed_frames_come_out_byte_for_byte() {
        // Section 3.6; the connect frame is printed fully escaped, the others minimally.
        let printed: [(Frame, Escaping, &[u8]); 4] = [
            (
                frame(0, 0x40, &[0]),
                Escaping::Full,
                &[0x7E, 0x7D, 0x20, 0x7D, 0x20, 0x40, 0x7D, 0x21, 0x7D, 0x20, 0xEB, 0xA3],
            ),
            (
                frame(1, 0x86, &[0xFF]),
                Escaping::Minimal,
                &[0x7E, 0x00, 0x01, 0x86, 0x01, 0xFF, 0x17, 0xB0],
            ),
            (
                frame(0, 0x65, &[0, 1]),
                Escaping::Minimal,
                &[0x7E, 0x00, 0x00, 0x65, 0x02, 0x00, 0x01, 0x2D, 0x3F],
            ),
            (
                frame(0, 0x45, &[0, 2]),
                Escaping::Minimal,
                &[0x7E, 0x00, 0x00, 0x45, 0x02, 0x00, 0x02, 0x2A, 0x12],
            ),
        ];
        for (frame, escaping, bytes) in printed {
            assert_eq!(frame.encode(escaping), bytes);
            assert_eq!(deframe(bytes), [frame]);
        }
    }

    #[test]
    fn the_check_value_of_the_crc_is_the_documented_one() {
        assert_eq!(CRC.checksum(b"123456789"), 0x31C3);
    }

    #[test]
    fn any_data_come_back_however_they_are_escaped() {
        let all: Vec<u8> = (0..=254).collect();
        let frame = frame(0x7E7D, 0x45, &all);
        for escaping in [Escaping::Minimal, Escaping::Full] {
            let line = frame.encode(escaping);
            assert_eq!(line.iter().filter(|byte| **byte == START).count(), 1);
            assert_eq!(deframe(&line), std::slice::from_ref(&frame));
        }
    }

    #[test]
    fn damage_costs_one_frame_and_not_the_next() {
        let good = frame(1, 0x45, &[0x40, 0x7E]).encode(Escaping::Minimal);
        let found = |before: &[u8]| deframe(&[before, &good].concat()).len();
        assert_eq!(found(b"garbage"), 1);
        assert_eq!(found(&good[..5]), 1, "cut off");
        assert_eq!(found(&[START, START, 0x00, 0x01, ESCAPE, 0x00]), 1, "wrong escape");
        assert_eq!(found(&[START, 0x00, ESCAPE]), 1, "cut inside an escape");
        // 40 sent as 7D 60, which no byte is: the frame is lost although its CRC would fit.
        let mut odd = good.clone();
        odd.splice(5..6, [ESCAPE, 0x60]);
        assert_eq!(deframe(&odd), [], "needless escape");
        for at in 1..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x01;
            assert_eq!(deframe(&bad), [], "byte {at} damaged");
            assert_eq!(found(&bad), 1, "byte {at} damaged");
        }
    }
}
