//! Multiplexing: which signals are in a frame depends on the raw value of others.
//!
//! Simple: one switch `M`, and signals `m<value>`. Extended: a switch may itself be multiplexed
//! (`m<value>M`), and `SG_MUL_VAL_` names the switch of a signal and its values.

use std::collections::HashMap;

use super::model::{Database, Gate, Message};
use super::oddities::Oddities;
use super::statement::{Trouble, short};

/// Switches upon switches; deeper is a loop or a joke.
const MAX_DEPTH: usize = 16;

/// What stands between name and colon of an `SG_`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mark {
    /// `M`: selects others.
    pub switch: bool,
    /// `m<value>`: selected by this value.
    pub value: Option<u64>,
}

impl Mark {
    /// Reads `M`, `m3`, `m3M`, or nothing.
    pub fn parse(word: Option<&str>) -> Result<Self, Trouble> {
        let Some(word) = word else { return Ok(Self::default()) };
        if word == "M" {
            return Ok(Self { switch: true, value: None });
        }
        let digits = word.strip_prefix('m').map(|rest| rest.strip_suffix('M').unwrap_or(rest));
        match digits.and_then(|digits| digits.parse().ok()) {
            Some(value) => Ok(Self { switch: word.ends_with('M'), value: Some(value) }),
            None => Err(format!("{} is no multiplexer mark", short(word))),
        }
    }
}

/// `SG_MUL_VAL_`.
#[derive(Debug)]
pub struct Selection {
    /// Index of the switch in the message.
    pub switch: usize,
    /// Its values, as written.
    pub ranges: Vec<(u64, u64)>,
}

/// What the file says about multiplexing, by message and signal.
#[derive(Debug, Default)]
pub struct Written {
    values: Vec<(usize, usize, u64)>,
    /// The first plain switch of a message, and whether there are more.
    roots: HashMap<usize, (usize, bool)>,
    selections: HashMap<(usize, usize), Selection>,
}

impl Written {
    /// A mark in an `SG_`.
    pub fn mark(&mut self, message: usize, signal: usize, mark: Mark) {
        match mark.value {
            Some(value) => self.values.push((message, signal, value)),
            None if mark.switch => {
                let root = self.roots.entry(message).or_insert((signal, false));
                root.1 = root.0 != signal;
            }
            None => {}
        }
    }

    /// An `SG_MUL_VAL_`.
    pub fn select(&mut self, message: usize, signal: usize, selection: Selection) {
        self.selections.insert((message, signal), selection);
    }
}

/// Gives every multiplexed signal its gate. One that cannot have any gets a gate without values:
/// to show it always would be a guess.
pub fn resolve(db: &mut Database, mut written: Written, oddities: &mut Oddities) {
    let mut warned = None;
    for (index, signal, value) in std::mem::take(&mut written.values) {
        let message = &mut db.messages[index];
        if let Some(selection) = written.selections.remove(&(index, signal)) {
            select(message, signal, selection);
            continue;
        }
        let Message { name, signals, .. } = message;
        let line = signals[signal].line;
        let Some(&(switch, another)) = written.roots.get(&index) else {
            let own = &signals[signal].name;
            oddities.lose(line, || {
                format!("{own} is multiplexed, but {name} has no multiplexer; it is never decoded")
            });
            signals[signal].gate = Some(never(signal));
            continue;
        };
        if another && warned != Some(index) {
            warned = Some(index);
            let first = &signals[switch].name;
            oddities.note(line, || {
                format!(
                    "{name} has several multiplexers and does not say which of them selects its \
                     signals; {first} is taken"
                )
            });
        }
        signals[signal].gate = Some(Gate { switch, ranges: vec![(value, value)] });
    }
    for ((index, signal), selection) in written.selections {
        select(&mut db.messages[index], signal, selection);
    }
    for message in &mut db.messages {
        break_loops(message, oddities);
    }
}

fn never(signal: usize) -> Gate {
    Gate { switch: signal, ranges: Vec::new() }
}

fn select(message: &mut Message, signal: usize, selection: Selection) {
    let mut ranges = selection.ranges;
    ranges.sort_unstable();
    let mut merged: Vec<(u64, u64)> = Vec::with_capacity(ranges.len());
    for (from, to) in ranges {
        match merged.last_mut() {
            Some(last) if from <= last.1.saturating_add(1) => last.1 = last.1.max(to),
            _ => merged.push((from, to)),
        }
    }
    if let Some(switch) = message.signals.get_mut(selection.switch) {
        switch.switch = true;
    }
    message.signals[signal].gate = Some(Gate { switch: selection.switch, ranges: merged });
}

fn break_loops(message: &mut Message, oddities: &mut Oddities) {
    let signals = &message.signals;
    let ends = |start: usize| {
        let mut at = start;
        (0..MAX_DEPTH).any(|_| match signals[at].gate.as_ref() {
            Some(gate) if !gate.ranges.is_empty() => {
                at = gate.switch;
                false
            }
            _ => true,
        })
    };
    let endless: Vec<usize> = (0..signals.len()).filter(|&start| !ends(start)).collect();
    for index in endless {
        let signal = &mut message.signals[index];
        let (own, name) = (&signal.name, &message.name);
        oddities.lose(signal.line, || {
            format!("{own} of {name} is multiplexed by itself or {MAX_DEPTH} deep; never decoded")
        });
        signal.gate = Some(never(index));
    }
}
