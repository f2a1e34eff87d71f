//! Frames that end with a delimiter: lines, SLIP, COBS, HDLC flags.

use super::super::framing::{Escape, Layout};
use super::{Cut, Run, Take, cobs};
use crate::frame::Timestamp;

/// What does not change from byte to byte.
pub struct Rules<'a> {
    pub start: Option<u8>,
    pub end: &'a [u8],
    pub escape: Option<&'a Escape>,
    pub cobs: bool,
    pub layout: &'a Layout,
}

#[derive(Debug, Default)]
pub struct Delimited {
    garbage: Run,
    /// Unescaped bytes of the open frame, its end included as far as it came.
    bytes: Vec<u8>,
    time: Timestamp,
    escaped: bool,
    /// After a bad escape the bytes up to the next end belong to nothing.
    lost: bool,
    /// Bytes dropped from the open frame because it is longer than any can be.
    dropped: u64,
}

impl Delimited {
    pub fn byte(&mut self, rules: &Rules<'_>, time: Timestamp, byte: u8, take: &mut Take<'_>) {
        let apart = rules.escape.is_some();
        if rules.start == Some(byte) && (apart || !self.is_open()) && rules.end != [byte] {
            return self.start(time, byte, take);
        }
        if apart && rules.end == [byte] {
            return self.end(rules, take);
        }
        if self.lost || (rules.start.is_some_and(|_| !self.is_open()) && !self.escaped) {
            return self.garbage.add(time, 1);
        }
        if !self.is_open() && !self.escaped {
            self.time = time;
        }
        let Some(byte) = self.unescape(rules, byte, take) else { return };
        self.bytes.push(byte);
        if !apart && self.bytes.ends_with(rules.end) {
            return self.end(rules, take);
        }
        // What may be the beginning of the end is kept.
        let keep = rules.end.len() - 1;
        if self.bytes.len() > rules.layout.max + keep || self.dropped > 0 && self.bytes.len() > keep
        {
            let drop = self.bytes.len() - keep;
            self.dropped += self.bytes.drain(..drop).len() as u64;
        }
    }

    /// Memory for the open frame, in bytes.
    #[cfg(test)]
    pub fn held(&self) -> usize {
        self.bytes.capacity()
    }

    fn is_open(&self) -> bool {
        !self.bytes.is_empty() || self.dropped > 0
    }

    fn start(&mut self, time: Timestamp, byte: u8, take: &mut Take<'_>) {
        self.garbage.tell(take);
        if self.bytes.len() > 1 || self.dropped > 0 || self.escaped {
            take(self.time, Cut::Truncated);
        }
        self.reset();
        self.time = time;
        self.bytes.push(byte);
    }

    fn unescape(&mut self, rules: &Rules<'_>, byte: u8, take: &mut Take<'_>) -> Option<u8> {
        let Some(escape) = rules.escape else { return Some(byte) };
        if !std::mem::take(&mut self.escaped) {
            self.escaped = byte == escape.byte;
            return (!self.escaped).then_some(byte);
        }
        let meant = escape.table[usize::from(byte)];
        if meant.is_none() {
            take(self.time, Cut::BadEscape { byte });
            self.reset();
            self.lost = true;
        }
        meant
    }

    fn end(&mut self, rules: &Rules<'_>, take: &mut Take<'_>) {
        self.garbage.tell(take);
        let mut frame = std::mem::take(&mut self.bytes);
        if rules.escape.is_none() {
            frame.truncate(frame.len() - rules.end.len());
        }
        let cut = if self.dropped > 0 {
            Cut::TooLong { bytes: self.dropped + frame.len() as u64 }
        } else if self.escaped {
            Cut::BadEscape { byte: rules.end.first().copied().unwrap_or_default() }
        } else if frame.is_empty() {
            // Delimiters in a row are fill.
            return self.reset();
        } else if rules.cobs {
            cobs::decode(&frame)
                .map_or(Cut::BadEncoding { bytes: frame.len() }, |frame| rules.layout.close(frame))
        } else {
            rules.layout.close(frame)
        };
        take(self.time, cut);
        self.reset();
    }

    fn reset(&mut self) {
        self.bytes.clear();
        (self.escaped, self.lost, self.dropped) = (false, false, 0);
    }

    pub fn finish(&mut self, take: &mut Take<'_>) {
        self.garbage.tell(take);
        if self.is_open() || self.escaped {
            take(self.time, Cut::Incomplete);
        }
        self.reset();
    }
}
