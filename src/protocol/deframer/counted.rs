//! Frames with a start flag whose length is known from their header.

use super::super::framing::{Escape, Layout};
use super::{Cut, Run, Take};
use crate::frame::Timestamp;

/// What does not change from byte to byte.
pub struct Rules<'a> {
    pub start: &'a [u8],
    pub escape: Option<&'a Escape>,
    pub layout: &'a Layout,
}

#[derive(Debug, Default)]
pub struct Counted {
    garbage: Run,
    /// When the bytes came that look like a start flag of which more must follow.
    begun: Vec<Timestamp>,
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    time: Timestamp,
    bytes: Vec<u8>,
    /// Known once the length is.
    total: Option<usize>,
    /// Some byte followed the start flag, be it the escape byte.
    followed: bool,
    escaped: bool,
}

impl Counted {
    pub fn byte(&mut self, rules: &Rules<'_>, time: Timestamp, byte: u8, take: &mut Take<'_>) {
        // With an escape the start flag stands nowhere else, so it always starts a frame.
        let restart = rules.escape.is_some() && rules.start == [byte];
        match &mut self.open {
            Some(open) if restart => {
                if open.followed {
                    take(open.time, Cut::Truncated);
                }
                self.open(rules, time, take);
            }
            Some(open) => {
                if let Some(cut) = open.byte(rules, byte) {
                    take(open.time, cut);
                    self.open = None;
                }
            }
            None => self.outside(rules, time, byte, take),
        }
    }

    /// Looks for the start flag.
    fn outside(&mut self, rules: &Rules<'_>, time: Timestamp, byte: u8, take: &mut Take<'_>) {
        loop {
            let matched = self.begun.len();
            if rules.start.get(matched) == Some(&byte) {
                self.begun.push(time);
                if self.begun.len() == rules.start.len() {
                    let time = self.begun.first().copied().unwrap_or(time);
                    self.begun.clear();
                    self.open(rules, time, take);
                }
                return;
            }
            if matched == 0 {
                self.garbage.add(time, 1);
                return;
            }
            // The flag may begin again inside what looked like one.
            let seen = rules.start.get(..matched).unwrap_or_default();
            let skip = (1..matched).find(|skip| rules.start.starts_with(&seen[*skip..]));
            for time in self.begun.drain(..skip.unwrap_or(matched)) {
                self.garbage.add(time, 1);
            }
        }
    }

    fn open(&mut self, rules: &Rules<'_>, time: Timestamp, take: &mut Take<'_>) {
        self.garbage.tell(take);
        let total = rules.layout.total_of(&[]).and_then(Result::ok);
        let bytes = rules.start.to_vec();
        self.open = Some(Open { time, bytes, total, followed: false, escaped: false });
    }

    pub fn finish(&mut self, take: &mut Take<'_>) {
        for time in self.begun.drain(..) {
            self.garbage.add(time, 1);
        }
        self.garbage.tell(take);
        if let Some(open) = self.open.take() {
            take(open.time, Cut::Incomplete);
        }
    }
}

impl Open {
    /// Adds a byte; what it ended, if it ended the frame.
    fn byte(&mut self, rules: &Rules<'_>, byte: u8) -> Option<Cut> {
        self.followed = true;
        let byte = match rules.escape {
            Some(escape) if self.escaped => {
                self.escaped = false;
                match escape.table[usize::from(byte)] {
                    Some(meant) => meant,
                    None => return Some(Cut::BadEscape { byte }),
                }
            }
            Some(escape) if escape.byte == byte => {
                self.escaped = true;
                return None;
            }
            _ => byte,
        };
        self.bytes.push(byte);
        if self.total.is_none() {
            match rules.layout.total_of(&self.bytes) {
                Some(Ok(total)) => self.total = Some(total),
                Some(Err(())) => return Some(Cut::BadLength { bytes: self.bytes.len() }),
                None => {}
            }
        }
        let whole = self.total.is_some_and(|total| self.bytes.len() >= total);
        whole.then(|| rules.layout.close(std::mem::take(&mut self.bytes)))
    }
}
