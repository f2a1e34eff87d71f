//! Plays: takes frames from the feed, waits for their moment, hands them to their lanes.

use std::thread::Scope;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags};

use super::ReplayError;
use super::answer::Answerer;
use super::control::{Controls, Request, Said};
use super::feed::{Feed, FeedPlan, Item, Next, Place};
use super::lane::Lane;
use super::schedule::{Rate, Schedule};
use super::tally::Tally;
use crate::frame::{Frame, Gap, Timestamp};
use crate::recording::reader::Recording;
use crate::sys::timing::{least_timer_slack, steady_nanos, wait};
use crate::text::parse_moment;

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

/// Something to say, and when.
struct Answer {
    at: u64,
    time: Timestamp,
    frame: Frame,
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
    /// It was said that a target takes nothing.
    warned: bool,
    ending: Option<Ending>,
}

impl Player<'_, '_, '_> {
    fn run(&mut self) -> Result<Ending, ReplayError> {
        self.begin()?;
        while self.ending.is_none() {
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
        while self.ending.is_none() && self.feed.next() == Next::NotYet {
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
            let media = match self.feed.next() {
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

    /// Waits until `due`, until a lane wants to be looked at, or until somebody says something.
    fn wait(&mut self, due: Option<u64>) -> Result<(), ReplayError> {
        let mut until = due;
        let mut sooner = |time: u64| until = Some(until.map_or(time, |until| until.min(time)));
        for lane in &mut self.stage.lanes {
            if due != Some(0) && !lane.sink().rest()? {
                sooner(steady_nanos() + 5_000_000);
            }
            if let Some(look) = lane.next_look() {
                sooner(look);
            }
        }
        for (_, answerer) in self.stage.answerers.iter().flatten() {
            if let Some(look) = answerer.next_look() {
                sooner(look);
            }
        }
        if self.audience.watches() {
            sooner(self.next_status);
        }
        let spin = due.filter(|due| self.options.precise && Some(*due) == until && *due > 0);
        let until =
            if spin.is_some() { until.map(|until| until.saturating_sub(SPIN)) } else { until };
        let (said, heard) = self.wait_for_descriptors(until)?;
        if said {
            self.take_said();
        }
        for lane in heard {
            self.hear(lane)?;
        }
        self.look();
        if let Some(due) = spin
            && steady_nanos() + SPIN >= due
        {
            while steady_nanos() < due {
                std::hint::spin_loop();
            }
        }
        Ok(())
    }

    /// Whether a control has something to say, and the lanes that do.
    fn wait_for_descriptors(&self, until: Option<u64>) -> Result<(bool, Vec<usize>), ReplayError> {
        let mut descriptors: Vec<PollFd<'_>> =
            self.controls.descriptors().map(|fd| PollFd::new(fd, PollFlags::POLLIN)).collect();
        let controls = descriptors.len();
        let mut owners = Vec::new();
        for (number, lane) in self.stage.lanes.iter().enumerate() {
            let (sink, events) = lane.waiting();
            if let Some(descriptor) = sink.descriptor().filter(|_| !events.is_empty()) {
                descriptors.push(PollFd::new(descriptor, events));
                owners.push(number);
            }
        }
        let ready = wait(&mut descriptors, until)
            .map_err(|error| ReplayError(format!("cannot wait: {error}")))?;
        if ready == 0 {
            return Ok((false, Vec::new()));
        }
        let is_ready = |fd: &PollFd<'_>| fd.revents().is_some_and(|events| !events.is_empty());
        let (of_controls, of_lanes) = descriptors.split_at(controls);
        let hears = |fd: &PollFd<'_>| {
            let events = fd.revents().unwrap_or(PollFlags::empty());
            events.intersects(PollFlags::POLLIN | PollFlags::POLLERR | PollFlags::POLLHUP)
        };
        let heard = of_lanes.iter().zip(owners).filter(|(fd, _)| hears(fd)).map(|(_, n)| n);
        Ok((of_controls.iter().any(is_ready), heard.collect()))
    }

    /// Takes what came back from a target, and answers it.
    fn hear(&mut self, number: usize) -> Result<(), ReplayError> {
        let Some(lane) = self.stage.lanes.get_mut(number) else { return Ok(()) };
        let mut answers = Vec::new();
        let now = steady_nanos();
        let answerer = self.stage.answerers.get_mut(number).and_then(Option::as_mut);
        let Some((bus, answerer)) = answerer else {
            // Nobody listens to it, but whoever writes must not be held up.
            return lane.sink().hear(&mut |_| {});
        };
        lane.sink().hear(&mut |heard| {
            answerer.hear(now, heard, &mut |delay, time, frame| {
                answers.push(Answer { at: now + delay, time, frame });
            });
        })?;
        let (bus, notes) = (*bus, answerer.take_notes());
        self.answer(number, bus, answers, notes);
        Ok(())
    }

    /// Lets answers that wait for silence come.
    fn look(&mut self) {
        let now = steady_nanos();
        let mut all = Vec::new();
        for (number, answerer) in self.stage.answerers.iter_mut().enumerate() {
            let Some((bus, answerer)) = answerer else { continue };
            if answerer.next_look().is_none_or(|look| now < look) {
                continue;
            }
            let mut answers = Vec::new();
            answerer.look(now, &mut |delay, time, frame| {
                answers.push(Answer { at: now + delay, time, frame });
            });
            all.push((number, *bus, answers, answerer.take_notes()));
        }
        for (number, bus, answers, notes) in all {
            self.answer(number, bus, answers, notes);
        }
    }

    fn answer(&mut self, lane: usize, bus: usize, answers: Vec<Answer>, notes: Vec<String>) {
        for text in notes {
            self.audience.say(&text);
        }
        let Some(lane) = self.stage.lanes.get_mut(lane) else { return };
        for Answer { at, time, frame } in answers {
            self.given += 1;
            lane.push(at, Item { media: 0, time, bus, frame });
        }
    }

    fn take_said(&mut self) {
        let mut said = Vec::new();
        self.controls.take(&mut |what| said.push(what));
        for what in said {
            match what {
                Said::Request(request) => self.obey(request),
                Said::Nonsense(text) => self.audience.warn(&text),
                Said::Signal(name) => self.ending = Some(Ending::Signal(name)),
            }
        }
    }

    fn obey(&mut self, request: Request) {
        let now = steady_nanos();
        match request {
            Request::Pause => self.schedule.pause(now, self.media),
            Request::Resume => self.schedule.resume(now),
            Request::Toggle if self.schedule.is_paused() => self.schedule.resume(now),
            Request::Toggle => self.schedule.pause(now, self.media),
            Request::Step(count) => {
                self.schedule.pause(now, self.media);
                self.steps += count;
            }
            Request::Seek(text) => return self.seek_text(&text),
            Request::Skip(by, forward) => {
                let nanos = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
                let back = Timestamp(self.position.nanos().saturating_sub(nanos));
                return self.seek(if forward { self.position.plus(nanos) } else { back });
            }
            Request::Rate(rate) => self.schedule.set_rate(rate, now, self.media),
            Request::Faster(faster) => {
                if let Rate::Times(times) = self.schedule.rate() {
                    let times = if faster { times * 2.0 } else { times / 2.0 };
                    let rate = Rate::Times(times.clamp(Rate::LEAST, Rate::MOST));
                    self.schedule.set_rate(rate, now, self.media);
                }
            }
            Request::Mark(text) => {
                let place = self.place();
                let words = if text.is_empty() { "mark" } else { &text };
                self.audience.say(&format!("{words}: {place}"));
                self.marks.push((self.position, text));
                return;
            }
            Request::Quit => self.ending = Some(Ending::Quit),
            Request::Status => {}
        }
        let state = if self.schedule.is_paused() { "paused" } else { "playing" };
        let (rate, place) = (self.schedule.rate(), self.place());
        self.audience.say(&format!("{state} at {place}, rate {rate}, {} sent", self.sent()));
    }

    /// The recorded time of the latest frame, for a person.
    fn place(&self) -> String {
        let start = self.stage.recording.span().map_or(self.position, |span| span.0);
        let after = self.position.since(start);
        format!(
            "+{}.{:03} s ({})",
            after / 1_000_000_000,
            after / 1_000_000 % 1000,
            crate::text::rfc3339(self.position)
        )
    }

    fn seek_text(&mut self, text: &str) {
        let start = self.stage.recording.span().map_or(Timestamp(0), |span| span.0);
        match parse_moment(text, start) {
            Ok(time) => self.seek(time),
            Err(error) => self.audience.warn(&error),
        }
    }

    /// Goes on at another place. What was due already is still sent.
    fn seek(&mut self, time: Timestamp) {
        self.take_books();
        let range = &self.stage.plan.range;
        let from = time.clamp(*range.start(), *range.end());
        let place = Place { from, lap: self.feed.lap(), media: self.media };
        self.feed = Feed::start(self.scope, self.stage.recording, self.stage.plan, place);
        self.schedule.jump(self.media, steady_nanos());
        self.position = from;
        self.ended = false;
        let place = self.place();
        self.audience.say(&format!("now at {place}"));
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
