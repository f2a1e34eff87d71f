//! Where frames go: CAN interfaces, adapters, serial lines, text.

pub mod can;
pub mod pty;
pub mod serial;
pub mod slcan;
pub mod trace;

use std::os::fd::BorrowedFd;
use std::time::Duration;

use super::ReplayError;
use super::feed::Item;
use super::tally::NotSent;

/// Something to send, and when.
#[derive(Clone, Debug)]
pub struct Due {
    /// When, on the steady clock.
    pub at: u64,
    /// What.
    pub item: Item,
    /// True for a whole item or the last part of one: then it counts as sent.
    pub last: bool,
}

/// What became of the first so many of what was offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Took {
    /// How many are done with.
    pub count: usize,
    /// Why they were not sent, if so.
    pub omitted: Option<NotSent>,
    /// Why no more are taken now, if so.
    pub blocked: Option<Blocked>,
}

impl Took {
    /// So many were sent.
    pub fn sent(count: usize) -> Self {
        Self { count, omitted: None, blocked: None }
    }

    /// So many were not sent.
    pub fn omitted(count: usize, why: NotSent) -> Self {
        Self { count, omitted: Some(why), blocked: None }
    }

    /// So many were sent, and now there is no room for more.
    pub fn blocked(count: usize, until: Blocked) -> Self {
        Self { count, omitted: None, blocked: Some(until) }
    }
}

/// When a sink that took nothing may be asked again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocked {
    /// When its descriptor is writable.
    Writable,
    /// After a while.
    For(Duration),
}

/// Something that takes frames and serial pieces. Never waits.
pub trait Sink {
    /// Takes the first of `front`, in their order. At least one is offered.
    ///
    /// # Errors
    /// The target is gone, in a sentence.
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError>;

    /// The descriptor that tells of room and of what comes back.
    fn descriptor(&self) -> Option<BorrowedFd<'_>>;

    /// True for a CAN bus.
    fn is_can(&self) -> bool {
        false
    }

    /// True if what comes back has to be looked at.
    fn listens(&self) -> bool {
        false
    }

    /// Takes what came back.
    ///
    /// # Errors
    /// The target is gone, in a sentence.
    fn hear(&mut self, _take: &mut dyn FnMut(Heard<'_>)) -> Result<(), ReplayError> {
        Ok(())
    }

    /// Nothing more is due for now. False if something is still on its way out of this process.
    ///
    /// # Errors
    /// The target is gone, in a sentence.
    fn rest(&mut self) -> Result<bool, ReplayError> {
        Ok(true)
    }

    /// Everything was sent: is it all out? Asked again and again for a second at most.
    ///
    /// # Errors
    /// The target is gone, in a sentence.
    fn finish(&mut self) -> Result<bool, ReplayError> {
        Ok(true)
    }

    /// What a person should know about how the target was opened.
    fn notes(&mut self) -> Vec<String> {
        Vec::new()
    }
}

/// What somebody else sent to a target.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// Bytes on a serial line.
    Serial(&'a [u8]),
    /// A frame on a CAN bus.
    Can(crate::frame::CanFrame),
}
