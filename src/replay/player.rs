//! Plays: takes frames from the feed, waits for their moment, hands them to their lanes.

mod requests;
mod waiting;

use std::collections::VecDeque;
use std::thread::Scope;
use std::time::Duration;

use super::ReplayError;
use super::answer::Answerer;
use super::control::{Controls, Request, Said};
use super::feed::{Feed, FeedPlan, Item, Next, Place};
use super::lane::Lane;
use super::schedule::{Rate, Schedule};
use super::tally::Tally;
use crate::frame::{Frame, Gap, Timestamp};
use crate::recording::reader::Recording;
use crate::sys::timing::{least_timer_slack, steady_nanos};

/// Most frames taken from the feed before lanes and controls get their turn.
const TURN: usize = 2048;
/// How long to wait for the reader at a time.
const READER_PATIENCE: Duration = Duration::from_millis(5);
/// With [`Options::precise`], how long before a frame is due the waiting becomes looking.
const SPIN: u64 = 150_000;
/// Time between two looks of a person at the status.
const STATUS: u64 = 200_000_000;
/// A target that has taken nothing for so long is worth a word.
const STUCK: u64 = 1_000_000_000;
/// How long targets may take to get out what they took, after the last frame.
const LAST_BYTES: u64 = 1_000_000_000;

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

/// Plays until the end, or until somebody ends it. The lanes come back with their books.
pub fn play(
    stage: &mut Stage<'_>,
    controls: &mut Controls,
    audience: &mut dyn Audience,
    options: Options,
) -> Outcome {
    // Where a sandbox forbids it, frames are up to 50 µs later.
    let _ = least_timer_slack();
    let began = steady_nanos();
    let tallies = vec![Tally::default(); stage.lane_of.len()];
    let (recording, plan) = (stage.recording, stage.plan);
    std::thread::scope(|scope| {
        let from = *plan.range.start();
        let feed = Feed::start(scope, recording, plan, Place { from, lap: 0, media: 0 });
        let mut player = Player {
            scope,
            stage,
            controls,
            audience,
            options,
            feed,
            schedule: Schedule::new(options.rate, began),
            tallies,
            damage: Vec::new(),
            marks: Vec::new(),
            position: from,
            media: 0,
            given: 0,
            steps: 0,
            starved: true,
            ended: false,
            next_status: began,
            said: VecDeque::new(),
            warned: false,
            ending: None,
        };
        let ending = player.run();
        if !matches!(ending, Ok(Ending::Finished | Ending::Count)) {
            for lane in &mut player.stage.lanes {
                lane.abandon(&mut player.tallies);
            }
        }
        player.take_books();
        let took = steady_nanos().saturating_sub(began);
        Outcome {
            ending,
            tallies: player.tallies,
            damage: player.damage,
            marks: player.marks,
            took,
        }
    })
}

struct Player<'a, 'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    stage: &'a mut Stage<'env>,
    controls: &'a mut Controls,
    audience: &'a mut dyn Audience,
    options: Options,
    feed: Feed,
    schedule: Schedule,
    tallies: Vec<Tally>,
    damage: Vec<String>,
    marks: Vec<(Timestamp, String)>,
    /// Recorded time of the latest item.
    position: Timestamp,
    /// Media time of the latest item.
    media: u64,
    /// Frames given to lanes.
    given: u64,
    /// Frames to play although time stands still.
    steps: u64,
    /// The reader has not got as far as we have.
    starved: bool,
    /// Nothing more comes from the feed.
    ended: bool,
    next_status: u64,
    /// What was asked for and not done yet.
    said: VecDeque<Said>,
    /// It was said that a target takes nothing.
    warned: bool,
    ending: Option<Ending>,
}

impl Player<'_, '_, '_> {
    fn run(&mut self) -> Result<Ending, ReplayError> {
        self.begin()?;
        while self.ending.is_none() {
            self.obey_next();
            let due = self.release();
            let now = steady_nanos();
            for lane in &mut self.stage.lanes {
                lane.flush(now, self.schedule.rate() != Rate::Max, &mut self.tallies)?;
            }
            let count = self.options.count.is_some_and(|count| self.given >= count);
            let over = count || !self.answers();
            if self.ended && over && self.stage.lanes.iter().all(Lane::is_empty) {
                self.ending = Some(if count { Ending::Count } else { Ending::Finished });
                break;
            }
            if self.starved && self.stage.lanes.iter().all(Lane::is_empty) {
                self.feed.wait(READER_PATIENCE);
            }
            self.wait(due)?;
            self.status();
        }
        match self.ending {
            Some(ending @ (Ending::Finished | Ending::Count)) => {
                self.finish()?;
                Ok(self.ending.unwrap_or(ending))
            }
            Some(ending) => Ok(ending),
            None => Ok(Ending::Finished),
        }
    }

    /// Waits for the first frame, so that the clock starts when it is there.
    fn begin(&mut self) -> Result<(), ReplayError> {
        while self.ending.is_none() && self.feed.look() == Next::NotYet {
            self.feed.wait(READER_PATIENCE);
            self.wait(Some(0))?;
        }
        let now = steady_nanos();
        self.schedule = Schedule::new(self.options.rate, now);
        if self.options.paused {
            self.schedule.pause(now, 0);
        }
        Ok(())
    }

    fn answers(&self) -> bool {
        self.stage.answerers.iter().any(Option::is_some)
    }

    /// Gives lanes what is due. Returns when to come back, if that is known.
    fn release(&mut self) -> Option<u64> {
        let now = steady_nanos();
        self.starved = false;
        for _ in 0..TURN {
            if self.ended || self.options.count.is_some_and(|count| self.given >= count) {
                self.ended = true;
                return None;
            }
            let media = match self.feed.look() {
                Next::At(media) => media,
                Next::NotYet => {
                    self.starved = true;
                    return Some(0);
                }
                Next::End => {
                    self.ended = true;
                    return None;
                }
            };
            let due = match self.schedule.due(media) {
                Some(due) => due,
                None if self.steps > 0 => now,
                None => return None,
            };
            if due > now {
                return Some(due);
            }
            // A full lane is looked at when its target has room again.
            let full = self.feed.bus().is_some_and(|bus| {
                let lane = self.stage.lane_of.get(bus);
                lane.and_then(|lane| self.stage.lanes.get(*lane)).is_some_and(Lane::is_full)
            });
            if full {
                return None;
            }
            if let Some(item) = self.feed.take() {
                self.give(due, item);
            }
        }
        Some(0)
    }

    fn give(&mut self, due: u64, item: Item) {
        (self.position, self.media) = (item.time, item.media);
        match &item.frame {
            Frame::Gap(gap) => {
                if let Some(tally) = self.tallies.get_mut(item.bus) {
                    tally.gaps += 1;
                }
                self.audience.gap(item.bus, gap);
            }
            Frame::Notice(_) => {}
            Frame::Can(_) | Frame::Serial(_) => {
                self.steps = self.steps.saturating_sub(1);
                self.given += 1;
                let lane = self.stage.lane_of.get(item.bus).copied();
                if let Some(lane) = lane.and_then(|lane| self.stage.lanes.get_mut(lane)) {
                    lane.push(due, item);
                }
            }
        }
    }

    fn sent(&self) -> u64 {
        self.tallies.iter().map(|tally| tally.sent).sum()
    }

    /// Enters what the reader left out or could not read.
    fn take_books(&mut self) {
        for (tally, omitted) in self.tallies.iter_mut().zip(self.feed.take_omitted()) {
            tally.omitted.merge(&omitted);
        }
        for sentence in self.feed.take_damage() {
            if !self.damage.contains(&sentence) {
                self.damage.push(sentence);
            }
        }
    }

    /// Now and then tells how things go.
    fn status(&mut self) {
        let now = steady_nanos();
        if now < self.next_status {
            return;
        }
        self.next_status = now + STATUS;
        let stuck = |lane: &&Lane| lane.stuck_since().is_some_and(|since| now > since + STUCK);
        match self.stage.lanes.iter().find(stuck) {
            Some(lane) if !self.warned => {
                self.audience.warn(&format!(
                    "{} has taken nothing for 1 s; a CAN bus without another node that \
                     acknowledges frames takes none",
                    lane.target
                ));
                self.warned = true;
            }
            Some(_) => {}
            None => self.warned = false,
        }
        if self.audience.watches() {
            let latest = self.tallies.iter().map(|t| t.lateness.max()).max().unwrap_or(0);
            let timed = self.tallies.iter().any(|t| t.lateness.count() > 0);
            self.audience.show(&Position {
                time: self.position,
                rate: self.schedule.rate(),
                paused: self.schedule.is_paused(),
                lap: self.feed.lap(),
                sent: self.sent(),
                late: timed.then_some(latest),
            });
        }
    }

    /// Lets the targets get out what they took.
    fn finish(&mut self) -> Result<(), ReplayError> {
        let end = steady_nanos() + LAST_BYTES;
        loop {
            let mut done = true;
            for lane in &mut self.stage.lanes {
                done &= lane.sink().finish()?;
            }
            let now = steady_nanos();
            if done || now >= end {
                return Ok(());
            }
            let (said, heard) = self.wait_for_descriptors(Some(now + 1_000_000))?;
            for lane in heard {
                self.hear(lane)?;
            }
            if said {
                let mut stop = false;
                self.controls.take(&mut |what| {
                    stop |= matches!(what, Said::Signal(_) | Said::Request(Request::Quit));
                });
                if stop {
                    return Ok(());
                }
            }
        }
    }
}
