//! Answers like the device of a recorded dialogue.

pub mod book;
pub mod by_bytes;
pub mod by_frames;
pub mod by_meaning;

use std::collections::BTreeMap;

use super::sink::Heard;
use crate::frame::{Frame, Timestamp};

/// Takes an answer: after how many nanoseconds, when it was recorded, and what.
pub type Reply<'a> = &'a mut dyn FnMut(u64, Timestamp, Frame);

/// Something that learns from a recorded dialogue what a device says.
pub trait Pupil {
    /// Takes the next of the bus's frames and gaps, in their order.
    fn take(&mut self, time: Timestamp, frame: &Frame);

    /// Ends with a device that answers as was learnt.
    fn graduate(self: Box<Self>, manner: Manner) -> Learnt;
}

/// What a [`Pupil`] has become.
pub struct Learnt {
    /// The device.
    pub device: Box<dyn Answerer>,
    /// How many answers it has.
    pub answers: usize,
    /// True if there was no room for all.
    pub full: bool,
}

/// Something that listens on a target and answers.
pub trait Answerer {
    /// Takes what somebody sent at `now`, on the steady clock.
    fn hear(&mut self, now: u64, heard: Heard<'_>, reply: Reply<'_>);

    /// When [`Answerer::look`] wants to be called, on the steady clock, if nothing is heard before.
    fn next_look(&self) -> Option<u64> {
        None
    }

    /// Takes notice that it is `now` and nothing was heard.
    fn look(&mut self, _now: u64, _reply: Reply<'_>) {}

    /// What a person should know, such as requests that have no answer.
    fn take_notes(&mut self) -> Vec<String>;

    /// What became of the requests.
    fn counts(&self) -> &Counts;
}

/// How a device behaves where the recording leaves a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Manner {
    /// After the last recorded answer to a request comes the first again; otherwise it stays.
    pub cycle: bool,
    /// Answers take as long as the recorded ones; otherwise no time.
    pub delay: bool,
    /// Requests that were never recorded get the protocol's error answer; otherwise nothing.
    pub error: bool,
}

/// What became of requests.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Requests heard.
    pub requests: u64,
    /// Requests with a recorded answer.
    pub answered: u64,
    /// Requests that the recorded device did not answer either.
    pub silent: u64,
    /// Requests that were never recorded, by what they are.
    pub unknown: BTreeMap<String, u64>,
    /// Requests that were never recorded, beyond those kinds.
    pub more_unknown: u64,
    /// What was heard and is no request: damaged frames.
    pub damaged: u64,
}

/// Most kinds of unknown requests that are told apart.
const KINDS: usize = 1000;

impl Counts {
    /// Counts a request that was never recorded. True for the first of its kind.
    pub fn miss(&mut self, what: &str) -> bool {
        if let Some(count) = self.unknown.get_mut(what) {
            *count += 1;
            return false;
        }
        if self.unknown.len() >= KINDS {
            self.more_unknown += 1;
            return false;
        }
        self.unknown.insert(what.to_owned(), 1);
        true
    }

    /// Requests that were never recorded.
    pub fn misses(&self) -> u64 {
        self.unknown.values().sum::<u64>() + self.more_unknown
    }
}
