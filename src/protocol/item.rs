//! What is found on a line.

use std::sync::Arc;

use super::condition::Side;
use super::deframer::Cut;
use super::message::Message;
use super::word::Reading;
use crate::frame::{Direction, Timestamp};

/// One thing found on a line.
#[derive(Clone, Debug)]
pub struct Item {
    /// When its first byte came.
    pub time: Timestamp,
    /// Which way it went.
    pub direction: Direction,
    /// What it is.
    pub kind: ItemKind,
}

/// What was found.
#[derive(Clone, Debug)]
pub enum ItemKind {
    /// A good frame.
    Frame(Box<FrameItem>),
    /// Anything else; never [`Cut::Frame`].
    Other(Cut),
}

/// A frame with a good check, and what it says.
#[derive(Clone, Debug)]
pub struct FrameItem {
    /// All of it, unescaped.
    pub bytes: Vec<u8>,
    /// The numbers of its header.
    pub header: Vec<Reading>,
    /// Its data, without header and check.
    pub data: Vec<u8>,
    /// Who sent it, if the definition says how to know.
    pub side: Option<Side>,
    /// The definition's check that it fails. Such a frame says nothing.
    pub link_error: Option<Arc<str>>,
    /// What it says, if the definition knows.
    pub message: Option<Message>,
}
