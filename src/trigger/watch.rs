//! Watches the frames of a recording for all triggers.

use super::listener::{Heard, Known, Listener};
use super::rule::Rule;
use super::{TriggerForm, resolve};
use crate::frame::error::{BusState, CanError};
use crate::frame::{CanFlags, Frame, Stamped, Timestamp};
use crate::recording::event::Event;

/// All triggers of a recording.
pub struct Triggers {
    pub(super) rules: Vec<Rule>,
    pub(super) buses: Vec<Watched>,
    /// Those that wait for marks.
    pub(super) marks: Vec<usize>,
}

/// A bus, as far as a trigger is about it.
#[derive(Default)]
pub(super) struct Watched {
    pub name: String,
    pub listener: Option<Listener>,
    pub frames: Vec<usize>,
    pub gaps: Vec<usize>,
    /// Each with the class that it wants, if it wants one.
    pub error_frames: Vec<(usize, Option<String>)>,
}

/// What is kept around a firing: nanoseconds before and after it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    /// Before.
    pub before: u64,
    /// After.
    pub after: u64,
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
    /// What shall be kept as a recording of its own.
    pub window: Option<Window>,
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
    pub fn new(forms: &[TriggerForm], buses: Vec<(String, Option<Known>)>) -> Result<Self, String> {
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

    /// The longest time that a window reaches back, if there are windows, nanoseconds.
    pub fn reach(&self) -> Option<u64> {
        self.rules.iter().filter_map(|rule| rule.window).map(|window| window.before).max()
    }

    /// Somebody has set a mark.
    pub fn mark(&mut self, time: Timestamp, fired: &mut Vec<Fired>) {
        for number in &self.marks {
            if let Some(rule) = self.rules.get_mut(*number)
                && rule.happens(time)
            {
                fired.push(firing(rule, time, None, None));
            }
        }
    }

    /// Takes what was recorded of bus number `bus`.
    pub fn take(&mut self, bus: usize, frame: &Stamped<Frame>, fired: &mut Vec<Fired>) {
        let Self { rules, buses, .. } = self;
        let Some(watched) = buses.get_mut(bus) else { return };
        let time = frame.time;
        let name = &watched.name;
        let mut happens = |which: &mut dyn Iterator<Item = &usize>| {
            for number in which {
                let Some(rule) = rules.get_mut(*number) else { continue };
                if rule.happens(time) {
                    fired.push(firing(rule, time, Some(name), None));
                }
            }
        };
        match &frame.value {
            Frame::Gap(_) => {
                happens(&mut watched.gaps.iter());
                // What came before a loss tells nothing about what follows.
                if let Some(listener) = &mut watched.listener {
                    listener.forget();
                }
                return;
            }
            Frame::Notice(_) => return,
            Frame::Can(can) if can.flags.has(CanFlags::ERROR) => {
                let Some(error) = CanError::of(can) else { return };
                let wanted = watched.error_frames.iter();
                let wanted = wanted.filter(|(_, class)| is_about(&error, class.as_deref()));
                return happens(&mut wanted.map(|(number, _)| number));
            }
            Frame::Can(_) | Frame::Serial(_) => {}
        }
        for number in &watched.frames {
            if let Some(rule) = rules.get_mut(*number) {
                rule.hears(time);
            }
        }
        let name = &watched.name;
        if let Some(listener) = &mut watched.listener {
            listener.take(frame, &mut |heard| probe(&heard, name, rules, fired));
        }
    }

    /// It is `time`: who waits for a silence may have heard enough of it.
    pub fn pass(&mut self, time: Timestamp, fired: &mut Vec<Fired>) {
        let Self { rules, buses, .. } = self;
        for Watched { name, listener, .. } in buses {
            if let Some(listener) = listener {
                listener.pass(time, &mut |heard| probe(&heard, name, rules, fired));
            }
        }
        for rule in rules {
            if rule.passes(time) {
                fired.push(firing(rule, time, None, None));
            }
        }
    }
}

fn is_about(error: &CanError, class: Option<&str>) -> bool {
    match class {
        None => true,
        Some("error-passive") => error.state() == Some(BusState::Passive),
        Some("error-warning") => error.state() == Some(BusState::Warning),
        Some(class) => error.is_called(class),
    }
}

/// Tells the rules that want to know of a message.
fn probe(heard: &Heard<'_>, bus: &String, rules: &mut [Rule], fired: &mut Vec<Fired>) {
    let time = heard.time;
    for probe in &heard.probes {
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
        // What repeats fulfils a condition if one of it does. What is not there says nothing.
        let (mut found, mut holds) = (None, false);
        (heard.values)(signal, &mut |value| {
            if !holds {
                (found, holds) = (Some(value), comparison.holds(value, with));
            }
        });
        let Some(value) = found else { continue };
        if probe.until {
            if holds {
                rule.rearm();
            }
        } else if rule.is(holds, time) {
            fired.push(firing(rule, time, Some(bus), Some(value)));
        }
    }
}

fn firing(rule: &Rule, time: Timestamp, bus: Option<&String>, value: Option<f64>) -> Fired {
    Fired {
        time,
        name: rule.name.clone(),
        condition: rule.when.clone(),
        bus: bus.cloned(),
        value,
        run: rule.run.clone(),
        window: rule.window,
    }
}
