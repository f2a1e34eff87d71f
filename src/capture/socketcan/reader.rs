//! From batches of messages to frames and gaps in the recording, in the order they happened.

use super::hardware::HardwareTime;
use super::message::{Stamps, decode};
use crate::clock::Stamper;
use crate::frame::error::{BusState, CanError};
use crate::frame::{CanFlags, Frame, GapReason, Level, Stamped, Timestamp};
use crate::queue::{Controller, Inlet};
use crate::sys::RawMessage;

const SECOND: u64 = 1_000_000_000;

/// Puts what is read from one interface into the recording.
pub(super) struct Reader {
    pub(super) inlet: Inlet,
    /// Name of the interface, for notices.
    name: String,
    stamper: Stamper,
    hardware: Option<HardwareTime>,
    frames: Vec<Stamped<Frame>>,
    drops: Drops,
    outage: Option<Outage>,
    /// Told after the frames that are in hand, so that nothing in the recording goes back, and at
    /// most once a second: a controller may change its state with every frame.
    news: Option<String>,
    controller: Controller,
    /// Its state, as far as it was told.
    told_state: Option<BusState>,
    told_at: Timestamp,
    /// When reading began.
    began: Timestamp,
    /// When the last frame was received.
    last: Option<Timestamp>,
    /// What has been said once need not be said again.
    told_hardware: bool,
    told_foreign: bool,
}

/// The socket's drop counter, as far as it is in the recording.
#[derive(Debug, Default)]
struct Drops {
    seen: u32,
}

impl Drops {
    /// How many drops are new, now that the counter stands at `counter`. Two ways lead to the
    /// same counter, so it may also stand where it stood before, or earlier. It wraps.
    fn new_at(&mut self, counter: u32) -> Option<u64> {
        let new = counter.wrapping_sub(self.seen);
        if new == 0 || new > u32::MAX / 2 {
            return None;
        }
        self.seen = counter;
        Some(new.into())
    }
}

/// A time without link.
#[derive(Clone, Copy, Debug)]
struct Outage {
    /// Up to here the link is known to have been there.
    from: Timestamp,
    /// When it was seen to be down; `None` while there is only the socket's word for it.
    seen: Option<Timestamp>,
    /// The controller has left the bus: its link is up, and it says itself when it is back.
    bus_off: bool,
}

impl Reader {
    pub(super) fn new(name: &str, inlet: Inlet, hardware: bool) -> Self {
        let mut stamper = inlet.timeline().stamper();
        let began = stamper.begin_read();
        Self {
            inlet,
            name: name.to_owned(),
            stamper,
            hardware: hardware.then(HardwareTime::default),
            frames: Vec::new(),
            drops: Drops::default(),
            outage: None,
            news: None,
            controller: Controller::default(),
            told_state: None,
            told_at: Timestamp(0),
            began,
            last: None,
            told_hardware: false,
            told_foreign: false,
        }
    }

    /// Records what was just read, up to the moment `until`. Returns the time now, or `None` if
    /// there was something later than `until`.
    pub(super) fn take<'a>(
        &mut self,
        messages: impl Iterator<Item = RawMessage<'a>>,
        until: Timestamp,
    ) -> Option<Timestamp> {
        let now = self.stamper.begin_read();
        let mut ended = false;
        for message in messages {
            let Some(message) = decode(message) else {
                self.tell_foreign();
                continue;
            };
            let own = message.frame.flags.has(CanFlags::TX);
            let time = self.time(message.stamps, now, own);
            if time > until {
                ended = true;
                break;
            }
            let error = CanError::of(&message.frame);
            self.end_outage_before(time, error.as_ref());
            if let Some(count) = message.stamps.drops.and_then(|drops| self.drops.new_at(drops)) {
                self.flush();
                self.inlet.gap(GapReason::KernelQueue, count, self.last(), time);
            }
            self.frames.push(Stamped { time, value: Frame::Can(message.frame) });
            self.last = Some(time);
            if let Some(error) = error {
                self.hear(&error, time);
            }
        }
        self.flush();
        self.tell_news(now);
        (!ended).then_some(now)
    }

    /// Records what the kernel has dropped behind the last frame, now that all before is read.
    pub(super) fn settle(&mut self, drops: u32, now: Timestamp) {
        if let Some(count) = self.drops.new_at(drops) {
            let last = self.last();
            self.inlet.gap(GapReason::KernelQueue, count, last, now.max(last));
        }
    }

    /// A new socket counts its drops from 0.
    pub(super) fn new_socket(&mut self) {
        self.drops = Drops::default();
    }

    /// The link may be gone; it was there at `known`. What is read from now on may have been
    /// received before that or, if it is back already, after.
    pub(super) fn link_lost(&mut self, known: Timestamp) {
        if self.outage.is_none() {
            let from = known.max(self.last());
            self.outage = Some(Outage { from, seen: None, bus_off: false });
        }
    }

    /// The link is gone, and what was received before has been read. True if that is news.
    pub(super) fn link_down(&mut self, known: Timestamp) -> bool {
        self.link_lost(known);
        let (now, last) = (self.stamper.begin_read(), self.last());
        match &mut self.outage {
            Some(outage) if outage.seen.is_none() => {
                *outage = Outage { from: outage.from.max(last), seen: Some(now), ..*outage };
                true
            }
            Some(outage) if outage.bus_off => {
                outage.bus_off = false;
                true
            }
            _ => false,
        }
    }

    /// The link is there, at `now`.
    pub(super) fn link_up(&mut self, now: Timestamp) {
        let Some(outage) = self.outage.take() else { return };
        self.flush();
        let to = now.max(outage.from);
        self.inlet.gap(GapReason::LinkDown, 0, outage.from, to);
        let millis = to.since(outage.from).div_ceil(1_000_000);
        let (name, seconds, rest) = (&self.name, millis / 1_000, millis % 1_000);
        self.news = Some(format!("{name} is up again: nothing recorded for {seconds}.{rest:03} s"));
    }

    /// What happened to the link and the controller, if that has not been told yet.
    pub(super) fn tell_news(&mut self, now: Timestamp) {
        let state = self.controller.state;
        if self.news.is_none() && state == self.told_state || now.since(self.told_at) < SECOND {
            return;
        }
        self.told_at = now;
        if let Some(text) = self.news.take() {
            self.inlet.notice(Level::Info, text);
        }
        if let Some(state) = state.filter(|_| state != self.told_state) {
            // That a controller is as it should be is worth no line at the beginning.
            if self.told_state.is_some() || state != BusState::Active {
                let level = if state == BusState::Active { Level::Info } else { Level::Warning };
                let counters = self.controller.errors.map_or(String::new(), |(tx, rx)| {
                    format!(" (error counters: transmitting {tx}, receiving {rx})")
                });
                self.inlet.notice(level, format!("{} is {state} now{counters}", self.name));
            }
        }
        self.told_state = state;
    }

    /// What the kernel says of the controller, once a second. What it does not say stays as the
    /// latest error frame had it.
    pub(super) fn look_at(&mut self, state: Option<BusState>, errors: Option<(u32, u32)>) {
        let Controller { state: before, errors: counted } = self.controller;
        self.set_controller(state.or(before), errors.or(counted));
    }

    /// What an error frame says of the controller.
    fn hear(&mut self, error: &CanError, time: Timestamp) {
        let Controller { state, errors } = self.controller;
        let counted = error.counters().map(|(tx, rx)| (u32::from(tx), u32::from(rx)));
        self.set_controller(error.state().or(state), counted.or(errors));
        if error.state() == Some(BusState::BusOff) {
            self.bus_off(time);
        }
    }

    fn set_controller(&mut self, state: Option<BusState>, errors: Option<(u32, u32)>) {
        let controller = Controller { state, errors };
        if controller != self.controller {
            self.controller = controller;
            self.inlet.tally().set_controller(controller);
        }
    }

    /// The controller has left the bus.
    pub(super) fn bus_off(&mut self, time: Timestamp) {
        if self.outage.is_none() {
            let from = time.max(self.last());
            self.outage = Some(Outage { from, seen: Some(from), bus_off: true });
        }
    }

    /// True while the controller is known to be off the bus.
    pub(super) fn is_bus_off(&self) -> bool {
        self.outage.is_some_and(|outage| outage.bus_off)
    }

    /// True while the link is not known to be there.
    pub(super) fn is_down(&self) -> bool {
        self.outage.is_some()
    }

    /// The recording ends at `end`, whether the link is there or not.
    pub(super) fn finish(&mut self, end: Timestamp) {
        self.told_at = Timestamp(0);
        self.tell_news(end);
        if let Some(outage) = self.outage.take() {
            self.inlet.gap(GapReason::LinkDown, 0, outage.from, end.max(outage.from));
        }
    }

    /// A frame received at `time` proves that the link is there, unless it was on its way
    /// through the kernel when the link went down.
    fn end_outage_before(&mut self, time: Timestamp, error: Option<&CanError>) {
        // Off the bus, a controller may still tell of errors, but hears no frames.
        let still_off = error.is_some_and(|e| e.state().is_none_or(|s| s >= BusState::BusOff));
        if self.is_bus_off() && still_off {
            return;
        }
        match &mut self.outage {
            Some(Outage { from, seen: Some(seen), .. }) if time <= *seen => {
                *from = (*from).max(time);
            }
            Some(Outage { seen: Some(_), .. }) => self.link_up(time),
            _ => {}
        }
    }

    fn time(&mut self, stamps: Stamps, now: Timestamp, own: bool) -> Timestamp {
        let kernel = stamps.kernel.map_or(now, |wall| self.stamper.stamp(wall));
        let time = match (&mut self.hardware, stamps.hardware) {
            (Some(clock), Some(hardware)) => clock.map(hardware, kernel),
            (Some(_), None) if !own && !self.told_hardware => {
                self.told_hardware = true;
                let name = &self.name;
                let text =
                    format!("{name}: its driver gives no hardware time, the kernel's counts");
                self.inlet.notice(Level::Warning, text);
                kernel
            }
            _ => kernel,
        };
        // Times of two kinds together must not go back either.
        self.last.map_or(time, |last| time.max(last))
    }

    /// Nothing that is not yet recorded was received before this.
    fn last(&self) -> Timestamp {
        self.last.unwrap_or(self.began)
    }

    fn tell_foreign(&mut self) {
        if !self.told_foreign {
            self.told_foreign = true;
            let name = &self.name;
            let text = format!("{name}: left out a message that is no CAN 2.0 or CAN FD frame");
            self.inlet.notice(Level::Warning, text);
        }
    }

    fn flush(&mut self) {
        if !self.frames.is_empty() {
            self.inlet.push(&mut self.frames);
        }
    }
}

#[cfg(test)]
mod tests;
