//! What a person or a script asks for while a recording is played.

use super::Player;
use crate::frame::Timestamp;
use crate::replay::control::{Request, Said};
use crate::replay::feed::{Feed, Place};
use crate::replay::schedule::Rate;
use crate::replay::stage::Ending;
use crate::sys::timing::steady_nanos;
use crate::text::parse_moment;

impl Player<'_, '_, '_> {
    /// Takes what was said. Signals count at once.
    pub(super) fn take_said(&mut self) {
        let said = &mut self.said;
        self.controls.take(&mut |what| said.push_back(what));
        if let Some(Said::Signal(name)) = said.iter().find(|what| matches!(what, Said::Signal(_))) {
            self.ending = Some(Ending::Signal(name));
        }
    }

    /// Does what was asked for, in order: after `step`, the next thing once that was done.
    pub(super) fn obey_next(&mut self) {
        while self.steps == 0 || self.ended {
            let Some(what) = self.said.pop_front() else { return };
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
        // Behind the last frame there is no place to be.
        let last = self.stage.recording.span().map_or(from, |span| span.1);
        self.position = from.min(last);
        self.ended = false;
        let place = self.place();
        self.audience.say(&format!("now at {place}"));
    }
}
