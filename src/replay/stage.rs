//! What a [`Player`](super::player::play) is given, whom it tells how things go, and what it leaves.

use super::ReplayError;
use super::answer::Answerer;
use super::feed::FeedPlan;
use super::lane::Lane;
use super::schedule::Rate;
use super::tally::Tally;
use crate::frame::{Gap, Timestamp};
use crate::recording::reader::Recording;

/// How to play.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// How fast.
    pub rate: Rate,
    /// End after so many frames.
    pub count: Option<u64>,
    /// Look at the clock for the last part of a wait instead of sleeping.
    pub precise: bool,
    /// Begin standing still.
    pub paused: bool,
}

/// What is played, and where to.
pub struct Stage<'env> {
    /// The recording.
    pub recording: &'env Recording,
    /// What of it.
    pub plan: &'env FeedPlan,
    /// The targets.
    pub lanes: Vec<Lane>,
    /// For each bus of the plan (and of `answerers`) the number of its lane.
    pub lane_of: Vec<usize>,
    /// For each lane what answers there, and as which bus.
    pub answerers: Vec<Option<(usize, Box<dyn Answerer>)>>,
}

/// Where the replay is.
#[derive(Clone, Copy, Debug)]
pub struct Position {
    /// Recorded time of the latest frame.
    pub time: Timestamp,
    /// How fast.
    pub rate: Rate,
    /// Standing still.
    pub paused: bool,
    /// Laps played before this one.
    pub lap: u64,
    /// Frames sent.
    pub sent: u64,
    /// The longest lateness so far, nanoseconds; none while nothing is timed.
    pub late: Option<u64>,
}

/// The person who watches.
pub trait Audience {
    /// Something that was asked for, or good to know.
    fn say(&mut self, text: &str);
    /// Something that is not as it should be.
    fn warn(&mut self, text: &str);
    /// Something is missing in the recording here.
    fn gap(&mut self, bus: usize, gap: &Gap);
    /// Where the replay is, now and then.
    fn show(&mut self, position: &Position);
    /// `true` if [`Audience::show`] leads anywhere.
    fn watches(&self) -> bool;
}

/// Why a replay ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Everything was played.
    Finished,
    /// The number of frames asked for was reached.
    Count,
    /// Asked to quit.
    Quit,
    /// This signal came.
    Signal(&'static str),
}

/// How a replay went.
#[derive(Debug)]
pub struct Outcome {
    /// Why it ended, or what made it fail.
    pub ending: Result<Ending, ReplayError>,
    /// The books, by bus.
    pub tallies: Vec<Tally>,
    /// What could not be read of the recording.
    pub damage: Vec<String>,
    /// Recorded times that were marked, and the words for them.
    pub marks: Vec<(Timestamp, String)>,
    /// How long it took, nanoseconds.
    pub took: u64,
}
