//! How long a frame or a byte occupies the wire, for the bus load.
//!
//! Sources: ISO 11898-1:2015, frame formats. Counted without stuff bits, whose number depends on
//! the data: real frames are 0 to 20 % longer.

use crate::frame::{CanFlags, CanFrame, Frame};

/// Start of frame to the third bit of the interframe space, without data: classic, 11-bit id.
const CLASSIC: u64 = 47;
/// The same with a 29-bit identifier.
const CLASSIC_EXTENDED: u64 = 67;
/// CAN FD at the nominal rate: start, identifier, control bits up to BRS (17), and from the CRC
/// delimiter on (13).
const FD_NOMINAL: u64 = 17 + 13;
/// What a 29-bit identifier adds to that.
const FD_EXTENDED: u64 = 19;
/// CAN FD at the data rate, without data: ESI, DLC, stuff count, CRC of 17 bits, 6 fixed stuff
/// bits.
const FD_DATA: u64 = 1 + 4 + 4 + 17 + 6;
/// A serial character: 8N1 with its start bit. Other formats are within two bits of that.
const CHARACTER: u64 = 10;
/// What the 21-bit CRC of frames with more than 16 bytes adds: 4 bits and a fixed stuff bit.
const FD_LONG_CRC: u64 = 5;

/// Counts bits at one bus's rates.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wire {
    /// Nominal and data bit rate, bit/s, where both are known.
    pub rates: Option<(u32, u32)>,
}

impl Wire {
    /// Bit times that `frame` occupies.
    pub fn bits(self, frame: &Frame) -> u64 {
        match frame {
            Frame::Can(frame) => self.can_bits(frame),
            Frame::Serial(bytes) => CHARACTER * bytes.data.len() as u64,
            Frame::Gap(_) | Frame::Notice(_) => 0,
        }
    }

    /// Nominal bit times that `frame` occupies, interframe space included. With a bit rate switch
    /// the bits at the data rate count for as much as they last, or fully where the rates are not
    /// known. Error frames count 0: the kernel reports events with them, not what was on the wire.
    fn can_bits(self, frame: &CanFrame) -> u64 {
        let extended = frame.flags.has(CanFlags::EXTENDED);
        let data = 8 * frame.data().len() as u64;
        if frame.flags.has(CanFlags::ERROR) {
            return 0;
        }
        if !frame.flags.has(CanFlags::FD) {
            return data + if extended { CLASSIC_EXTENDED } else { CLASSIC };
        }
        let fast = FD_DATA + data + if data > 16 * 8 { FD_LONG_CRC } else { 0 };
        let slow = FD_NOMINAL + if extended { FD_EXTENDED } else { 0 };
        match self.rates {
            Some((nominal, rate)) if frame.flags.has(CanFlags::BRS) && rate > 0 => {
                slow + (fast * u64::from(nominal)).div_ceil(rate.into())
            }
            _ => slow + fast,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classic_frames() {
        let bits = |flags, data: &[u8]| Wire::default().can_bits(&CanFrame::new(1, flags, data));
        assert_eq!(bits(CanFlags::default(), &[0; 8]), 111);
        assert_eq!(bits(CanFlags::EXTENDED, &[0; 8]), 131);
        assert_eq!(bits(CanFlags::REMOTE, &[]), 47);
        assert_eq!(bits(CanFlags::ERROR, &[0; 8]), 0);
    }

    #[test]
    fn the_data_phase_of_fd_frames_counts_as_long_as_it_lasts() {
        let frame = CanFrame::new(1, CanFlags::FD | CanFlags::BRS, &[0; 64]);
        let wire = Wire { rates: Some((500_000, 2_000_000)) };
        assert_eq!(wire.can_bits(&frame), 30 + (549_u64).div_ceil(4));
        assert_eq!(Wire::default().can_bits(&frame), 30 + 549);
        let slow = CanFrame::new(1, CanFlags::FD | CanFlags::EXTENDED, &[0; 8]);
        assert_eq!(wire.can_bits(&slow), 49 + 96);
    }
}
