//! What can go wrong with an answer of the monitor.

use super::frame::{Control, Escaping, Frame, START, escape};
use crate::simulate::faults::Rates;
use crate::simulate::random::Random;

/// A fault of one answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A bit of the CRC is wrong.
    BadCrc,
    /// The answer is not sent; what was asked is done all the same.
    NoAnswer,
    /// The count of data bytes is one too high or too low; the CRC fits what is sent.
    WrongLength,
    /// One to twelve bytes that belong to nothing stand in front of the answer.
    Garbage,
    /// The answer comes one to two seconds late.
    Late,
    /// `DL_ERROR` instead of the answer; nothing is done.
    LinkError,
    /// The sequence bit is not that of the request.
    WrongSequence,
    /// The answer comes from the next address.
    WrongAddress,
    /// Status `SLAVE_BUSY_R`; nothing is done.
    Busy,
}

/// All faults by name.
pub const FAULTS: &[(&str, Fault)] = &[
    ("bad-crc", Fault::BadCrc),
    ("no-answer", Fault::NoAnswer),
    ("wrong-length", Fault::WrongLength),
    ("garbage", Fault::Garbage),
    ("late", Fault::Late),
    ("link-error", Fault::LinkError),
    ("wrong-sequence", Fault::WrongSequence),
    ("wrong-address", Fault::WrongAddress),
    ("busy", Fault::Busy),
];

/// How often each happens.
pub type LineFaults = Rates<Fault>;

/// The bytes that are sent instead of `answer`.
pub fn damage(
    mut answer: Frame,
    fault: Option<Fault>,
    escaping: Escaping,
    random: &mut Random,
) -> Vec<u8> {
    match fault {
        Some(Fault::NoAnswer) => return Vec::new(),
        Some(Fault::WrongSequence) => answer.control.0 ^= Control::SEQUENCE,
        // Behind the last settable address the first one follows.
        Some(Fault::WrongAddress) => answer.address = answer.address % 0xFEFF + 1,
        Some(Fault::WrongLength) => {
            let count = answer.count();
            let more = count < u8::MAX && (count == 0 || random.chance(0.5));
            let wrong = if more { count + 1 } else { count - 1 };
            return escape(&answer.plain(wrong), escaping);
        }
        Some(Fault::BadCrc) => {
            let mut plain = answer.plain(answer.count());
            if let Some(last) = plain.last_mut() {
                *last ^= 1 << random.index(8);
            }
            return escape(&plain, escaping);
        }
        Some(Fault::Garbage) => {
            let count = 1 + random.index(12);
            // A start flag would begin a frame.
            let mut bytes: Vec<u8> =
                (0..count).map(|_| random.index(256) as u8).filter(|b| *b != START).collect();
            bytes.push(0x55);
            bytes.extend(answer.encode(escaping));
            return bytes;
        }
        Some(Fault::Late | Fault::LinkError | Fault::Busy) | None => {}
    }
    answer.encode(escaping)
}
