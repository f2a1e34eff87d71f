//! Identifiers with several meanings: which one a frame has is told by its length or by the frame
//! before it.

use crate::frame::Timestamp;

/// A message that frames with some identifier are, under conditions.
#[derive(Debug)]
pub(super) struct Meaning {
    /// Of the frames that it is about.
    pub key: u32,
    /// Place of the message in the database.
    pub message: usize,
    /// Lengths that the frame may have; any if empty.
    pub lengths: Vec<usize>,
    /// What must have come before.
    pub after: Option<After>,
}

/// A condition on the frame before.
#[derive(Debug)]
pub(super) struct After {
    /// It must be one of these.
    pub any_of: Vec<Seen>,
    /// It is the last frame before whose key, under this mask, ...
    pub mask: u32,
    /// ... is this.
    pub key: u32,
    /// It must not be longer ago, nanoseconds.
    pub within: Option<u64>,
}

/// What a frame was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Seen {
    /// No frame, or one that is of no use to any rule: unknown, or not of its declared length.
    #[default]
    Nothing,
    /// A message of the database, by its place, with its declared length.
    Message(usize),
    /// A remote message, by its place.
    Remote(usize),
}

/// The last frame that concerns a rule.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Last {
    /// What it was.
    pub seen: Seen,
    /// When.
    pub time: Timestamp,
}

impl Meaning {
    /// Whether a frame of `key` and `length` at `time` is this message.
    pub fn holds(&self, key: u32, length: usize, time: Timestamp, last: &Last) -> bool {
        self.key == key
            && (self.lengths.is_empty() || self.lengths.contains(&length))
            && self.after.as_ref().is_none_or(|after| after.holds(time, last))
    }

    /// Whether frames of `key` must be remembered for it.
    pub fn watches(&self, key: u32) -> bool {
        self.after.as_ref().is_some_and(|after| key & after.mask == after.key)
    }
}

impl After {
    fn holds(&self, time: Timestamp, last: &Last) -> bool {
        self.any_of.contains(&last.seen)
            && self.within.is_none_or(|longest| time.since(last.time) <= longest)
    }
}
