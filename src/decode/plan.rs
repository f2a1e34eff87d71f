//! A message, compiled: groups of signals that are in a frame together.

use std::collections::HashMap;

use super::dbc::{Gate, Message};
use super::layout::{Bits, Payload, Scale, Value};

/// One signal found in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Index of the signal in [`Message::signals`].
    pub signal: usize,
    /// Its bits as in the frame; what value tables are about.
    pub raw: u64,
    /// What they mean.
    pub value: Value,
}

#[derive(Debug)]
struct Step {
    bits: Bits,
    scale: Scale,
    signal: usize,
}

/// From and to, both included.
type Range = (u64, u64);

#[derive(Debug)]
struct Check {
    switch: Bits,
    ranges: Vec<Range>,
    /// The switch's own gate.
    above: Option<usize>,
}

#[derive(Debug)]
struct Group {
    gate: Option<usize>,
    steps: Vec<Step>,
}

/// How to decode a message's frames. Independent of the order of the signals in the file.
#[derive(Debug)]
pub struct Plan {
    groups: Vec<Group>,
    gates: Vec<Check>,
}

impl Plan {
    /// That of `message`.
    pub fn of(message: &Message) -> Self {
        let (known, above) = (HashMap::new(), HashMap::new());
        let mut compiler = Compiler { message, gates: Vec::new(), known, above };
        let mut groups: Vec<Group> = Vec::new();
        let mut places: HashMap<Option<usize>, usize> = HashMap::new();
        for (index, signal) in message.signals.iter().enumerate() {
            // Never in a frame (see `dbc::multiplex`).
            if signal.gate.as_ref().is_some_and(|gate| gate.ranges.is_empty()) {
                continue;
            }
            let gate = signal.gate.as_ref().map(|gate| compiler.gate(gate));
            let place = *places.entry(gate).or_insert_with(|| {
                groups.push(Group { gate, steps: Vec::new() });
                groups.len() - 1
            });
            let step = Step { bits: Bits::of(signal), scale: Scale::of(signal), signal: index };
            groups[place].steps.push(step);
        }
        Self { groups, gates: compiler.gates }
    }

    /// Gives each signal that is in the frame to `visit`.
    #[inline]
    pub fn decode(&self, payload: &Payload, mut visit: impl FnMut(Reading)) {
        for group in &self.groups {
            if group.gate.is_some_and(|gate| !self.opens(gate, payload)) {
                continue;
            }
            for step in &group.steps {
                if let Some(raw) = step.bits.take(payload) {
                    visit(Reading { signal: step.signal, raw, value: step.scale.value(raw) });
                }
            }
        }
    }

    // The chain ends: `dbc::multiplex` has broken loops.
    fn opens(&self, mut gate: usize, payload: &Payload) -> bool {
        loop {
            let check = &self.gates[gate];
            let Some(raw) = check.switch.take(payload) else { return false };
            let at = check.ranges.partition_point(|(_, to)| *to < raw);
            if check.ranges.get(at).is_none_or(|(from, _)| raw < *from) {
                return false;
            }
            match check.above {
                Some(above) => gate = above,
                None => return true,
            }
        }
    }
}

struct Compiler<'a> {
    message: &'a Message,
    gates: Vec<Check>,
    known: HashMap<(usize, &'a [Range]), usize>,
    /// By switch, the gate that it stands behind itself: looked up once for all signals below.
    above: HashMap<usize, Option<usize>>,
}

impl<'a> Compiler<'a> {
    fn gate(&mut self, gate: &'a Gate) -> usize {
        let key = (gate.switch, gate.ranges.as_slice());
        if let Some(&known) = self.known.get(&key) {
            return known;
        }
        let switch = &self.message.signals[gate.switch];
        // A gate without values never opens and is its own switch: nothing is above it.
        let above = if gate.ranges.is_empty() { None } else { self.above(gate.switch) };
        let index = self.gates.len();
        self.gates.push(Check { switch: Bits::of(switch), ranges: gate.ranges.clone(), above });
        self.known.insert(key, index);
        index
    }

    fn above(&mut self, switch: usize) -> Option<usize> {
        if let Some(&known) = self.above.get(&switch) {
            return known;
        }
        let message: &'a Message = self.message;
        let gate = message.signals[switch].gate.as_ref().map(|gate| self.gate(gate));
        self.above.insert(switch, gate);
        gate
    }
}
