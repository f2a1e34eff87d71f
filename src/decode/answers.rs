//! Which frames ask for something, and which answer that.

use crate::frame::{CanFlags, CanFrame};

/// Frames of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FramePattern {
    /// Identifier.
    pub id: u32,
    /// Its bits that count.
    pub mask: u32,
    /// 29-bit identifiers.
    pub extended: bool,
    /// Remote frames; otherwise data frames.
    pub remote: bool,
}

impl FramePattern {
    /// True for a frame of this kind.
    pub fn fits(&self, frame: &CanFrame) -> bool {
        let has = |flag| frame.flags.has(flag);
        !has(CanFlags::ERROR)
            && has(CanFlags::EXTENDED) == self.extended
            && has(CanFlags::REMOTE) == self.remote
            && (frame.id ^ self.id) & self.mask == 0
    }
}

/// What asks, and what answers that.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AnswerRule {
    /// What asks, for a person.
    pub name: String,
    /// Frames that ask.
    pub request: Vec<FramePattern>,
    /// Frames that answer.
    pub answer: Vec<FramePattern>,
}

impl AnswerRule {
    /// True for a frame that asks.
    pub fn asks(&self, frame: &CanFrame) -> bool {
        self.request.iter().any(|pattern| pattern.fits(frame))
    }

    /// True for a frame that answers.
    pub fn answers(&self, frame: &CanFrame) -> bool {
        self.answer.iter().any(|pattern| pattern.fits(frame))
    }
}
