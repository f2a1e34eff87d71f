//! Answers like the device of a recorded dialogue.

use super::sink::Heard;
use crate::frame::{Frame, Timestamp};

/// Takes an answer: after how many nanoseconds, when it was recorded, and what.
pub type Reply<'a> = &'a mut dyn FnMut(u64, Timestamp, Frame);

/// Something that listens on a target and answers.
pub trait Answerer {
    /// Takes what somebody sent at `now`, on the steady clock.
    fn hear(&mut self, now: u64, heard: Heard<'_>, reply: Reply<'_>);

    /// What a person should know, such as requests that have no answer.
    fn take_notes(&mut self) -> Vec<String>;
}
