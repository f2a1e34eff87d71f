//! Between two frames: waits, listens, answers.

use nix::poll::{PollFd, PollFlags};

use super::{Player, SPIN};
use crate::frame::{Frame, Timestamp};
use crate::replay::ReplayError;
use crate::replay::control::{Request, Said};
use crate::replay::feed::Item;
use crate::replay::lane::Lane;
use crate::sys::timing::{sleep_until, steady_nanos, wait};

/// How long targets may take to get out what they took, after the last frame.
const LAST_BYTES: u64 = 1_000_000_000;
/// How long targets may take at an early end to get out what was counted as sent.
const LAST_WORD: u64 = 50_000_000;
/// Before a frame that is due so soon nobody is listened to: the sleep is shorter than a person or
/// a signal notices, costs less than waiting for descriptors, and is more exact.
const NAP: u64 = 5_000_000;
/// `MAX_SLACK` of `fs/select.c`.
const ROUNDED_UP: u64 = 100_000_000;
/// A slow reader of our text is looked at again after this, nanoseconds.
const SLOW_READER: u64 = 5_000_000;

/// When to stop listening for the sake of a frame that is due at `due` and shall be waited for
/// exactly, or with `spin` nanoseconds to look at the clock: before the last [`NAP`], and earlier by
/// what poll(2) may round a long wait up, which is at most a two hundredth and 100 ms.
fn before(due: u64, spin: u64) -> u64 {
    let left = due.saturating_sub(steady_nanos());
    if left <= NAP { due - spin.min(due) } else { due - NAP - (left / 200).min(ROUNDED_UP) }
}

/// Something to say, and when.
struct Answer {
    at: u64,
    time: Timestamp,
    frame: Frame,
}

impl Player<'_, '_, '_> {
    /// Waits until `due`, until a lane wants to be looked at, or until somebody says something.
    pub(super) fn wait(&mut self, due: Option<u64>) -> Result<(), ReplayError> {
        let mut until = due;
        let mut sooner = |time: u64| until = Some(until.map_or(time, |until| until.min(time)));
        for lane in &mut self.stage.lanes {
            if due != Some(0) && !lane.sink().rest()? {
                sooner(steady_nanos() + SLOW_READER);
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
        if !self.said.is_empty() && self.steps == 0 {
            sooner(0);
        }
        if self.audience.watches() {
            sooner(self.next_status);
        }
        let on_time = due.filter(|due| Some(*due) == until && *due > 0);
        let spin = if self.options.precise { SPIN } else { 0 };
        match on_time {
            Some(due) if due <= self.hear_by && self.may_nap() => {
                sleep_until(due.saturating_sub(spin));
            }
            Some(due) => self.listen(Some(before(due, spin)))?,
            None => self.listen(until)?,
        }
        if let Some(due) = on_time
            && spin > 0
            && steady_nanos() + spin >= due
        {
            while steady_nanos() < due {
                std::hint::spin_loop();
            }
        }
        Ok(())
    }

    /// True if nobody has to be heard before the next frame goes out.
    fn may_nap(&self) -> bool {
        !self.answers() && !self.stage.lanes.iter().any(Lane::is_blocked)
    }

    /// Waits until `until`, or until somebody speaks, and hears what is said.
    fn listen(&mut self, until: Option<u64>) -> Result<(), ReplayError> {
        let (said, heard) = self.wait_for_descriptors(until)?;
        self.hear_by = steady_nanos() + NAP;
        if said {
            self.take_said();
        }
        for lane in heard {
            self.hear(lane)?;
        }
        self.look();
        Ok(())
    }

    /// Whether a control has something to say, and the lanes that do.
    pub(super) fn wait_for_descriptors(
        &self,
        until: Option<u64>,
    ) -> Result<(bool, Vec<usize>), ReplayError> {
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
    pub(super) fn hear(&mut self, number: usize) -> Result<(), ReplayError> {
        let Some(lane) = self.stage.lanes.get_mut(number) else { return Ok(()) };
        lane.wake();
        let mut answers = Vec::new();
        let now = steady_nanos();
        let answerer = self.stage.answerers.get_mut(number).and_then(Option::as_mut);
        let Some((bus, answerer)) = answerer else {
            // Nobody listens to it, but whoever writes must not be held up.
            return lane.sink().hear(&mut |_| {});
        };
        let before = answerer.counts().answered;
        lane.sink().hear(&mut |heard| {
            answerer.hear(now, heard, &mut |delay, time, frame| {
                answers.push(Answer { at: now + delay, time, frame });
            });
        })?;
        let (bus, notes) = (*bus, answerer.take_notes());
        self.given += answerer.counts().answered - before;
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
            let before = answerer.counts().answered;
            answerer.look(now, &mut |delay, time, frame| {
                answers.push(Answer { at: now + delay, time, frame });
            });
            self.given += answerer.counts().answered - before;
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
            lane.push(at, Item { media: 0, time, bus, frame });
        }
    }

    /// Gives up what still waits in the lanes. What targets have taken already still goes out, for
    /// a moment.
    pub(super) fn abandon(&mut self) {
        for lane in &mut self.stage.lanes {
            lane.abandon(&mut self.tallies);
        }
        let end = steady_nanos() + LAST_WORD;
        loop {
            let mut out = true;
            for lane in &mut self.stage.lanes {
                // Why it ended is known; a target that is gone as well adds nothing to that.
                out &= lane.sink().rest().unwrap_or(true);
            }
            let now = steady_nanos();
            if out || now >= end {
                return;
            }
            sleep_until((now + 1_000_000).min(end));
        }
    }

    /// Lets the targets get out what they took.
    pub(super) fn finish(&mut self) -> Result<(), ReplayError> {
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
