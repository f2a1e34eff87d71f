//! When a trigger fires: once when its condition becomes true, not again before it was false.

use super::Window;
use crate::frame::Timestamp;

/// A trigger's state.
#[derive(Clone, Debug)]
pub struct Rule {
    /// What its events are called.
    pub name: String,
    /// Its condition, as it was written.
    pub when: String,
    /// Shortest time between two firings, nanoseconds.
    pub hold_off: u64,
    /// It has to hear another condition before it fires again.
    pub has_until: bool,
    /// Program and arguments; may be empty.
    pub run: Vec<String>,
    /// What is kept around it.
    pub window: Option<Window>,
    /// For a silence: how long, nanoseconds.
    pub silence: Option<u64>,
    heard: Timestamp,
    armed: bool,
    fired: Option<Timestamp>,
}

impl Rule {
    /// A trigger that has not fired yet.
    pub fn new(name: String, when: String) -> Self {
        Self {
            name,
            when,
            hold_off: 0,
            has_until: false,
            run: Vec::new(),
            window: None,
            silence: None,
            heard: Timestamp(0),
            armed: true,
            fired: None,
        }
    }

    /// Its condition is true or false at `time`. True if it fires.
    pub fn is(&mut self, holds: bool, time: Timestamp) -> bool {
        if !holds {
            self.armed |= !self.has_until;
            return false;
        }
        let held = self.fired.is_some_and(|fired| time.since(fired) < self.hold_off);
        if !self.armed || held {
            return false;
        }
        self.armed = false;
        self.fired = Some(time);
        true
    }

    /// Something happened that is over at once. True if it fires.
    pub fn happens(&mut self, time: Timestamp) -> bool {
        let fires = self.is(true, time);
        self.armed |= !self.has_until;
        fires
    }

    /// Its `until` is true.
    pub fn rearm(&mut self) {
        self.armed = true;
    }

    /// What must not be silent was heard.
    pub fn hears(&mut self, time: Timestamp) {
        self.heard = self.heard.max(time);
        self.is(false, time);
    }

    /// It is `time`. True if it fires for a silence.
    pub fn passes(&mut self, time: Timestamp) -> bool {
        let silent = self.silence.is_some_and(|silence| time.since(self.heard) >= silence);
        silent && self.is(true, time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule() -> Rule {
        Rule::new("a".to_owned(), "a".to_owned())
    }

    #[test]
    fn it_fires_once_and_again_only_after_it_was_false() {
        let mut rule = rule();
        let fired = [true, true, false, true, true].map(|holds| rule.is(holds, Timestamp(1)));
        assert_eq!(fired, [true, false, false, true, false]);
    }

    #[test]
    fn with_until_false_is_not_enough() {
        let mut rule = Rule { has_until: true, ..rule() };
        let fired = [true, false, true].map(|holds| rule.is(holds, Timestamp(1)));
        assert_eq!(fired, [true, false, false]);
        rule.rearm();
        assert!(rule.is(true, Timestamp(1)));
    }

    #[test]
    fn within_the_hold_off_it_waits_and_then_fires_if_it_is_still_true() {
        let mut rule = Rule { hold_off: 10, ..rule() };
        assert!(rule.is(true, Timestamp(0)));
        rule.is(false, Timestamp(1));
        assert!(!rule.is(true, Timestamp(2)));
        assert!(rule.is(true, Timestamp(10)));
        let mut events = Rule { hold_off: 10, ..self::rule() };
        let fired = [0, 5, 10, 12].map(|time| events.happens(Timestamp(time)));
        assert_eq!(fired, [true, false, true, false]);
    }

    #[test]
    fn a_silence_fires_once_and_again_after_something_was_heard() {
        let mut rule = Rule { silence: Some(10), ..rule() };
        let fired = [9, 10, 11].map(|time| rule.passes(Timestamp(time)));
        assert_eq!(fired, [false, true, false]);
        rule.hears(Timestamp(20));
        assert!(!rule.passes(Timestamp(29)));
        assert!(rule.passes(Timestamp(30)));
    }
}
