//! Where frames begin and end, and what stands where in them.

use super::crc::Checksum;
use super::definition::ByteOrder;
use super::deframer::Cut;
use super::word::{Block, Quantity, unsigned};

/// How frames are cut out of the bytes, compiled.
#[derive(Clone, Debug)]
pub struct Framing {
    /// What tells frames apart.
    pub kind: Kind,
    /// What is in a frame.
    pub layout: Layout,
}

/// What tells frames apart.
#[derive(Clone, Debug)]
pub enum Kind {
    /// They begin with `start`, and their length is known when the header is.
    Counted {
        /// 1 to 8 bytes.
        start: Vec<u8>,
        /// With an escape, the start byte appears nowhere else.
        escape: Option<Escape>,
    },
    /// They end with `end`.
    Delimited {
        /// What they begin with, if they do.
        start: Option<u8>,
        /// 1 to 8 bytes.
        end: Vec<u8>,
        /// With an escape, the last byte appears nowhere else.
        escape: Option<Escape>,
        /// The bytes between the zeros are COBS.
        cobs: bool,
    },
    /// Between them the line is quiet for at least this long, in ns.
    Silence(u64),
}

/// How bytes that mean something to the framing are sent inside a frame.
#[derive(Clone, Debug)]
pub struct Escape {
    /// Announces an escaped byte.
    pub byte: u8,
    /// What stands for what; `None` for a byte that must not follow.
    pub table: Box<[Option<u8>; 256]>,
}

/// How long a frame is, with everything that is in it.
#[derive(Clone, Debug)]
pub enum Total {
    /// Always the same.
    Size(usize),
    /// A number in the header plus `add`.
    Length {
        /// The number.
        quantity: std::sync::Arc<Quantity>,
        /// Bytes that it does not count.
        add: i64,
    },
}

/// The check at the end of a frame.
#[derive(Clone, Debug)]
pub struct FrameCheck {
    /// How it is computed.
    pub sum: Checksum,
    /// The order in which its bytes are sent.
    pub order: ByteOrder,
    /// First byte that it covers; it covers all up to itself.
    pub from: usize,
}

/// What stands where in a frame.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The header; `header.end` counts from the first byte of the frame.
    pub header: Block,
    /// How long a frame is, when it says so.
    pub total: Option<Total>,
    /// The check at the end.
    pub check: Option<FrameCheck>,
    /// Longest frame in bytes.
    pub max: usize,
}

impl Layout {
    /// Bytes of a frame without data.
    pub fn overhead(&self) -> usize {
        self.header.end + self.trailer()
    }

    /// Bytes of the check.
    pub fn trailer(&self) -> usize {
        self.check.as_ref().map_or(0, |check| check.sum.bytes())
    }

    /// Length of the frame that begins with `bytes`: `None` until it can be known.
    pub fn total_of(&self, bytes: &[u8]) -> Option<Result<usize, ()>> {
        match self.total.as_ref()? {
            Total::Size(size) => Some(Ok(*size)),
            Total::Length { quantity, .. } if bytes.len() < quantity.end() => None,
            Total::Length { quantity, add } => {
                let total =
                    i64::try_from(quantity.read(bytes)).ok().map(|n| n.saturating_add(*add));
                let total = total.and_then(|total| usize::try_from(total).ok());
                let fits = |total: &usize| (self.overhead()..=self.max).contains(total);
                Some(total.filter(fits).ok_or(()))
            }
        }
    }

    /// The data of a whole frame.
    pub fn data<'a>(&self, frame: &'a [u8]) -> &'a [u8] {
        let end = frame.len().saturating_sub(self.trailer());
        frame.get(self.header.end..end).unwrap_or_default()
    }

    /// Judges a frame that has ended.
    pub fn close(&self, frame: Vec<u8>) -> Cut {
        let wrong_length = match self.total_of(&frame) {
            Some(total) => total != Ok(frame.len()),
            None => frame.len() < self.overhead(),
        };
        if wrong_length {
            return Cut::BadLength { bytes: frame.len() };
        }
        if let Some(check) = &self.check {
            let (covered, sent) = frame.split_at(frame.len() - self.trailer());
            let received = unsigned(sent, check.order);
            let computed = check.sum.of(covered.get(check.from..).unwrap_or_default());
            if received != computed {
                return Cut::CrcError { received, computed, width: check.sum.width };
            }
        }
        Cut::Frame(frame)
    }
}
