//! Replay: frames of a recording, in time order, at the right moment, onto buses.
//!
//! [`play`](player::play) takes frames that a [`Feed`](feed::Feed) reads ahead, asks the
//! [`Schedule`](schedule::Schedule) when each is due, and hands them to a [`Lane`](lane::Lane) per
//! target, whose [`Sink`](sink::Sink) gives them to the kernel. Nothing here transmits on a bus
//! without a [`Permit`](crate::permit::Permit).

pub mod answer;
pub mod control;
pub mod feed;
pub mod keys;
pub mod lane;
pub mod lateness;
pub mod player;
pub mod reach;
pub mod schedule;
pub mod select;
pub mod sink;
pub mod stage;
pub mod tally;
pub mod target;
pub mod verify;

/// Why something cannot be replayed. The text is the whole sentence.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReplayError(pub String);
