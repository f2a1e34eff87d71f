//! Between two frames: waits, listens, answers.

use nix::poll::{PollFd, PollFlags};

use super::{Player, SPIN};
use crate::frame::{Frame, Timestamp};
use crate::replay::ReplayError;
use crate::replay::feed::Item;
use crate::sys::timing::{steady_nanos, wait};

/// A slow reader of our text is looked at again after this, nanoseconds.
const SLOW_READER: u64 = 5_000_000;

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
}
