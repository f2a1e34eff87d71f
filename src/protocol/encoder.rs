//! The way back: from a frame that was heard to the bytes of one that fits another request.
//!
//! Nothing here makes up what a device might say; it only puts header numbers, length and check
//! right in a frame that is there.

use super::Protocol;
use super::deframer::cobs;
use super::framing::{Escape, Framing, Kind, Layout, Total};
use super::item::FrameItem;
use super::word::Quantity;

/// How the protocol says "I do not know that", compiled.
#[derive(Clone, Debug)]
pub struct ErrorAnswer {
    /// Header numbers that differ from the request's: their places and values.
    pub set: Vec<(usize, u64)>,
    /// What stands in the place of the request's data.
    pub data: Vec<u8>,
}

impl Protocol {
    /// What a frame asks for, whatever its number in the dialogue: its header with such numbers
    /// zero, and its data. Two requests with the same meaning have the same answers.
    pub fn meaning(&self, frame: &FrameItem) -> Vec<u8> {
        let header = &self.framing.layout.header;
        let mut meaning = frame.bytes.get(..header.end).unwrap_or_default().to_vec();
        for quantity in self.sequence().filter_map(|index| header.quantities.get(index)) {
            quantity.write(0, &mut meaning);
        }
        meaning.extend_from_slice(&frame.data);
        meaning
    }

    /// True if `answer` may belong to `request`: in the same slot and of the same number.
    pub fn pairs(&self, request: &FrameItem, answer: &FrameItem) -> bool {
        let values = |frame: &FrameItem| frame.header.iter().map(|r| r.value).collect::<Vec<_>>();
        let Some(rules) = &self.pairing else { return true };
        rules.fits(&values(request), &values(answer))
    }

    /// The bytes on the line of the recorded frame `answer`, made to fit `request`: the numbers
    /// that tell which request it answers, and the check, are set anew.
    pub fn refit(&self, answer: &[u8], request: &FrameItem) -> Vec<u8> {
        let mut frame = answer.to_vec();
        for index in self.sequence() {
            if let Some(reading) = request.header.get(index) {
                reading.quantity.write(reading.value, &mut frame);
            }
        }
        self.framing.layout.seal(&mut frame);
        self.framing.to_line(&frame)
    }

    /// The protocol's error answer to `request`, if it has one.
    pub fn error_answer(&self, request: &FrameItem) -> Option<Vec<u8>> {
        let rules = self.error_answer.as_ref()?;
        let layout = &self.framing.layout;
        let mut frame = request.bytes.get(..layout.header.end)?.to_vec();
        frame.extend_from_slice(&rules.data);
        frame.resize(frame.len() + layout.trailer(), 0);
        for (index, value) in &rules.set {
            layout.header.quantities.get(*index)?.write(*value, &mut frame);
        }
        if let Some(Total::Length { quantity, add }) = &layout.total {
            let length = i64::try_from(frame.len()).ok()?.checked_sub(*add)?;
            quantity.write(u64::try_from(length).ok()?, &mut frame);
        }
        layout.seal(&mut frame);
        Some(self.framing.to_line(&frame))
    }

    /// True if the definition says how the protocol refuses what it does not know.
    pub fn has_error_answer(&self) -> bool {
        self.error_answer.is_some()
    }

    /// Where only silence ends a frame: how long, in ns.
    pub fn silence(&self) -> Option<u64> {
        match self.framing.kind {
            Kind::Silence(gap) => Some(gap),
            Kind::Counted { .. } | Kind::Delimited { .. } => None,
        }
    }

    /// The header's numbers that only tell one request from the next.
    fn sequence(&self) -> impl Iterator<Item = usize> {
        self.pairing.iter().flat_map(|rules| rules.sequence.iter().copied())
    }
}

impl Quantity {
    /// Puts `value` into its place in `bytes`, without the bits that do not fit. Nothing where
    /// `bytes` do not reach.
    pub fn write(&self, value: u64, bytes: &mut [u8]) {
        let end = self.end();
        let Some(place) = bytes.get_mut(self.at..end) else { return };
        let mask = ((1u64 << self.width) - 1) << self.shift;
        let word = super::word::unsigned(place, self.order) & !mask | (value << self.shift) & mask;
        super::word::put_unsigned(word, self.order, place);
    }
}

impl Layout {
    /// Sets the check at the end of a whole frame.
    fn seal(&self, frame: &mut [u8]) {
        let Some(check) = &self.check else { return };
        let at = frame.len().saturating_sub(self.trailer());
        let (covered, place) = frame.split_at_mut(at);
        let sum = check.sum.of(covered.get(check.from..).unwrap_or_default());
        super::word::put_unsigned(sum, check.order, place);
    }
}

impl Framing {
    /// A frame as it stands on the line: with escapes and delimiters.
    fn to_line(&self, frame: &[u8]) -> Vec<u8> {
        let mut line = Vec::with_capacity(frame.len() + 8);
        match &self.kind {
            Kind::Counted { start, escape } => {
                let flag = start.len().min(frame.len());
                line.extend_from_slice(&frame[..flag]);
                put_escaped(&mut line, &frame[flag..], escape.as_ref(), start);
            }
            Kind::Delimited { start, end, escape, cobs } => {
                let flag = usize::from(start.is_some()).min(frame.len());
                line.extend_from_slice(&frame[..flag]);
                if *cobs {
                    cobs::encode(frame, &mut line);
                } else {
                    let flags: Vec<u8> = start.iter().chain(end).copied().collect();
                    put_escaped(&mut line, &frame[flag..], escape.as_ref(), &flags);
                }
                line.extend_from_slice(end);
            }
            Kind::Silence(_) => line.extend_from_slice(frame),
        }
        line
    }
}

/// Only the flags and the escape byte itself are escaped, which every receiver has to understand.
fn put_escaped(line: &mut Vec<u8>, bytes: &[u8], escape: Option<&Escape>, flags: &[u8]) {
    let Some(escape) = escape else { return line.extend_from_slice(bytes) };
    for byte in bytes {
        let code = if *byte == escape.byte || flags.contains(byte) {
            escape.table.iter().position(|meant| *meant == Some(*byte))
        } else {
            None
        };
        match code.and_then(|code| u8::try_from(code).ok()) {
            Some(code) => line.extend([escape.byte, code]),
            None => line.push(*byte),
        }
    }
}
