//! What became of the frames of a bus: sent, or not and why.

use super::lateness::Lateness;

/// Why something recorded was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum NotSent {
    /// Its identifier passes no filter, or it is not one of the messages asked for.
    Filtered,
    /// It went the other way.
    OtherDirection,
    /// Error frames are reports of a controller; nobody sends them.
    ErrorFrame,
    /// Nobody had the pseudo-terminal open.
    NobodyThere,
    /// Whoever had it open read nothing for too long.
    NotRead,
    /// The adapter refused it again and again.
    Refused,
    /// It was still waiting for the target when the replay ended.
    Unfinished,
}

impl NotSent {
    /// All of them, in the order of a report.
    pub const ALL: [Self; 7] = [
        Self::Filtered,
        Self::OtherDirection,
        Self::ErrorFrame,
        Self::NobodyThere,
        Self::NotRead,
        Self::Refused,
        Self::Unfinished,
    ];

    /// In one word, for JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Filtered => "filtered",
            Self::OtherDirection => "other_direction",
            Self::ErrorFrame => "error_frame",
            Self::NobodyThere => "nobody_there",
            Self::NotRead => "not_read",
            Self::Refused => "refused",
            Self::Unfinished => "unfinished",
        }
    }

    /// For a person.
    pub fn text(self) -> &'static str {
        match self {
            Self::Filtered => "filtered",
            Self::OtherDirection => "of the other direction",
            Self::ErrorFrame => "error frames",
            Self::NobodyThere => "with nobody there",
            Self::NotRead => "not read in time",
            Self::Refused => "refused by the adapter",
            Self::Unfinished => "still waiting at the end",
        }
    }

    /// True if it should have been sent but could not be.
    pub fn is_loss(self) -> bool {
        matches!(self, Self::NotRead | Self::Refused)
    }
}

/// Counts by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Omitted([u64; NotSent::ALL.len()]);

impl Omitted {
    /// Counts `count` more.
    pub fn add(&mut self, why: NotSent, count: u64) {
        self.0[why as usize] += count;
    }

    /// Adds all of `other`.
    pub fn merge(&mut self, other: &Self) {
        for (sum, more) in self.0.iter_mut().zip(other.0) {
            *sum += more;
        }
    }

    /// The reasons that occurred, and how often.
    pub fn counts(&self) -> impl Iterator<Item = (NotSent, u64)> {
        NotSent::ALL.into_iter().map(|why| (why, self.0[why as usize])).filter(|(_, n)| *n > 0)
    }

    /// All together.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }
}

/// The books of one bus.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Frames (of a serial line: recorded pieces) handed to the target.
    pub sent: u64,
    /// Payload bytes in them.
    pub bytes: u64,
    /// What was not sent.
    pub omitted: Omitted,
    /// Records that something is missing in the recording here.
    pub gaps: u64,
    /// How late frames went out.
    pub lateness: Lateness,
}

/// The books of one target.
#[derive(Clone, Copy, Debug, Default)]
pub struct Waits {
    /// How often it took nothing because its queue was full.
    pub count: u64,
    /// For how long all in all, nanoseconds.
    pub nanos: u64,
}
