//! Plays: takes frames from the feed, waits for their moment, hands them to their lanes.

mod requests;
mod telling;
mod waiting;

use std::collections::VecDeque;
use std::thread::Scope;
use std::time::Duration;

use super::ReplayError;
use super::control::{Controls, Said};
use super::feed::{Feed, Item, Next, Place};
use super::lane::Lane;
use super::schedule::{Rate, Schedule};
use super::stage::{Audience, Ending, Options, Outcome, Stage};
use super::tally::Tally;
use crate::frame::{Frame, Timestamp};
use crate::sys::timing::{least_timer_slack, steady_nanos};

/// Most frames taken from the feed before lanes and controls get their turn.
const TURN: usize = 2048;
/// How long to wait for the reader at a time.
const READER_PATIENCE: Duration = Duration::from_millis(5);
/// With [`Options::precise`], how long before a frame is due the waiting becomes looking.
const SPIN: u64 = 150_000;

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
            held: None,
            ended: false,
            next_status: began,
            hear_by: began,
            said: VecDeque::new(),
            warned: false,
            ending: None,
        };
        let ending = player.run();
        if !matches!(ending, Ok(Ending::Finished | Ending::Count)) {
            player.abandon();
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

#[allow(clippy::struct_excessive_bools, reason = "each is a state of its own")]
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
    /// The lane in which the next frame waits for room.
    held: Option<usize>,
    /// Nothing more comes from the feed.
    ended: bool,
    next_status: u64,
    /// Until then nobody who speaks has waited too long.
    hear_by: u64,
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
            if self.ending.is_some() {
                // Else it would wait for the next thing to happen, which may never do.
                break;
            }
            let mut due = self.release();
            let now = steady_nanos();
            for lane in &mut self.stage.lanes {
                lane.flush(now, self.schedule.rate() != Rate::Max, &mut self.tallies)?;
            }
            let held = self.held.and_then(|lane| self.stage.lanes.get(lane));
            if held.is_some_and(|lane| !lane.is_full()) {
                due = Some(0);
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
        (self.starved, self.held) = (false, None);
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
            let lane = self.feed.bus().and_then(|bus| self.stage.lane_of.get(bus).copied());
            let is_full = |lane: &usize| self.stage.lanes.get(*lane).is_some_and(Lane::is_full);
            if let Some(full) = lane.filter(is_full) {
                self.held = Some(full);
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
}
