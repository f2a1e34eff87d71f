//! Watches the frames of a recording for all triggers.

use std::sync::Arc;

use super::rule::Rule;
use super::{Comparison, TriggerForm, resolve};
use crate::decode::bus::{CanBus, CanItem};
use crate::decode::can::{Match, Value};
use crate::decode::definition::CanDefinition;
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};
use crate::recording::event::Event;

/// All triggers of a recording.
pub struct Triggers {
    pub(super) rules: Vec<Rule>,
    pub(super) buses: Vec<Watched>,
}

/// A bus, as far as a trigger is about it.
#[derive(Default)]
pub(super) struct Watched {
    pub name: String,
    pub can: Option<CanBus>,
    /// By message of the definition.
    pub messages: Vec<Vec<Probe>>,
    pub frames: Vec<usize>,
    pub gaps: Vec<usize>,
    pub error_frames: Vec<usize>,
}

/// What a rule wants to know of a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Probe {
    pub rule: usize,
    /// It is the rule's `until`.
    pub until: bool,
    /// The signal, how it is compared and with what; `None` if it matters that the message came.
    pub signal: Option<(usize, Comparison, f64)>,
}

/// A trigger has fired.
#[derive(Clone, Debug, PartialEq)]
pub struct Fired {
    /// When.
    pub time: Timestamp,
    /// The trigger's name.
    pub name: String,
    /// Its condition.
    pub condition: String,
    /// The bus; a silence on several buses has none.
    pub bus: Option<String>,
    /// The value that was compared.
    pub value: Option<f64>,
    /// What shall be run.
    pub run: Vec<String>,
}

impl Fired {
    /// As an event of the recording.
    pub fn event(&self) -> Event {
        let mut properties = vec![("condition", self.condition.clone())];
        properties.extend(self.bus.clone().map(|bus| ("bus", bus)));
        properties.extend(self.value.map(|value| ("value", value.to_string())));
        Event::new(self.time, &self.name, properties)
    }
}

impl Triggers {
    /// Resolves `forms` against the buses: their names, and what is known of their messages. The
    /// error is a sentence that names the trigger.
    pub fn new(
        forms: &[TriggerForm],
        buses: &[(String, Option<Arc<CanDefinition>>)],
    ) -> Result<Self, String> {
        resolve::triggers(forms, buses)
    }

    /// Silence counts from `start`.
    pub fn begin(&mut self, start: Timestamp) {
        self.rules.iter_mut().for_each(|rule| rule.hears(start));
    }

    /// True if one of them runs a command.
    pub fn has_commands(&self) -> bool {
        self.rules.iter().any(|rule| !rule.run.is_empty())
    }

    /// Takes what was recorded of bus number `bus`.
    pub fn take(&mut self, bus: usize, frame: &Stamped<Frame>, fired: &mut Vec<Fired>) {
        let Self { rules, buses } = self;
        let Some(watched) = buses.get_mut(bus) else { return };
        let time = frame.time;
        let name = &watched.name;
        let mut happens = |which: &[usize]| {
            for number in which {
                let Some(rule) = rules.get_mut(*number) else { continue };
                if rule.happens(time) {
                    fired.push(firing(rule, time, Some(name), None));
                }
            }
        };
        match &frame.value {
            Frame::Gap(_) => {
                happens(&watched.gaps);
                // What came before a loss tells nothing about what follows.
                if let Some(can) = &mut watched.can {
                    can.finish(&mut |_| {});
                }
                return;
            }
            Frame::Notice(_) => return,
            Frame::Can(can) if can.flags.has(CanFlags::ERROR) => {
                return happens(&watched.error_frames);
            }
            Frame::Can(_) | Frame::Serial(_) => {}
        }
        for number in &watched.frames {
            if let Some(rule) = rules.get_mut(*number) {
                rule.hears(time);
            }
        }
        if let (Some(decoder), Frame::Can(can)) = (&mut watched.can, &frame.value) {
            let (messages, name) = (&watched.messages, &watched.name);
            decoder.feed(time, can, &mut |item| {
                if let CanItem::Message(found) = item {
                    let probes = messages.get(found.index).map_or(&[][..], |probes| probes);
                    probe(probes, &found, can, (time, name), rules, fired);
                }
            });
        }
    }

    /// It is `time`: who waits for a silence may have heard enough of it.
    pub fn pass(&mut self, time: Timestamp, fired: &mut Vec<Fired>) {
        for rule in &mut self.rules {
            if rule.passes(time) {
                fired.push(firing(rule, time, None, None));
            }
        }
    }
}

fn probe(
    probes: &[Probe],
    found: &Match<'_>,
    frame: &CanFrame,
    (time, bus): (Timestamp, &String),
    rules: &mut [Rule],
    fired: &mut Vec<Fired>,
) {
    for probe in probes {
        let Some(rule) = rules.get_mut(probe.rule) else { continue };
        let Some((signal, comparison, with)) = probe.signal else {
            if probe.until {
                rule.rearm();
            } else if rule.silence.is_some() {
                rule.hears(time);
            } else if rule.happens(time) {
                fired.push(firing(rule, time, Some(bus), None));
            }
            continue;
        };
        // A signal that is not in the frame says nothing.
        let Some(value) = value(found, frame, signal) else { continue };
        let holds = comparison.holds(value, with);
        if probe.until {
            if holds {
                rule.rearm();
            }
        } else if rule.is(holds, time) {
            fired.push(firing(rule, time, Some(bus), Some(value)));
        }
    }
}

fn value(found: &Match<'_>, frame: &CanFrame, signal: usize) -> Option<f64> {
    let mut value = None;
    found.decode(frame, |reading| {
        if reading.signal == signal {
            value = Some(match reading.value {
                Value::Unsigned(number) => number as f64,
                Value::Signed(number) => number as f64,
                Value::Float(number) => number,
            });
        }
    });
    value
}

fn firing(rule: &Rule, time: Timestamp, bus: Option<&String>, value: Option<f64>) -> Fired {
    Fired {
        time,
        name: rule.name.clone(),
        condition: rule.when.clone(),
        bus: bus.cloned(),
        value,
        run: rule.run.clone(),
    }
}
