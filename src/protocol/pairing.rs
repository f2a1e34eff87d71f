//! Which request an answer belongs to.

use std::collections::HashMap;
use std::sync::Arc;

use super::message::{Answered, Reason};

/// Why there is no request when none is waiting.
const NO_REQUEST: &str = "no_request";

/// The rules, compiled. Numbers are places among the header's numbers.
#[derive(Clone, Debug)]
pub struct PairingRules {
    /// The number that tells slots apart, 16 bits at most.
    pub slot: usize,
    /// Its values (from, to) that share one slot, which any answer may look into.
    pub common: Vec<(u64, u64)>,
    /// Numbers that must be the same, and the reason told when they are not.
    pub same: Vec<(usize, Arc<str>)>,
    /// Those of them that only tell one request from the next and ask for nothing themselves.
    pub sequence: Vec<usize>,
}

/// A frame that waits for its answer.
#[derive(Debug)]
struct Waiting {
    same: Vec<u64>,
    frame: Answered,
}

/// Frames that wait for an answer: one a slot.
#[derive(Debug, Default)]
pub struct Pairing {
    /// `None` is the common slot.
    slots: HashMap<Option<u64>, Waiting>,
}

impl PairingRules {
    fn slot(&self, header: &[u64]) -> Option<u64> {
        let slot = header.get(self.slot).copied()?;
        let common = self.common.iter().any(|(from, to)| (*from..=*to).contains(&slot));
        (!common).then_some(slot)
    }

    /// True if an answer with the header `answer` may belong to the request with `request`.
    pub fn fits(&self, request: &[u64], answer: &[u64]) -> bool {
        let (asked, own) = (self.slot(request), self.slot(answer));
        (asked == own || asked.is_none()) && self.same(request) == self.same(answer)
    }

    fn same(&self, header: &[u64]) -> Vec<u64> {
        self.same.iter().filter_map(|(index, _)| header.get(*index).copied()).collect()
    }
}

impl Pairing {
    /// A frame was sent that may be answered; it replaces the one before.
    pub fn ask(&mut self, rules: &PairingRules, header: &[u64], frame: Answered) {
        self.slots.insert(rules.slot(header), Waiting { same: rules.same(header), frame });
    }

    /// A frame was sent that cannot be answered, and replaces the one before.
    pub fn forget(&mut self, rules: &PairingRules, header: &[u64]) {
        self.slots.remove(&rules.slot(header));
    }

    /// Forgets all; after a loss nobody knows what was asked.
    pub fn clear(&mut self) {
        self.slots.clear();
    }

    /// Takes the frame that an answer belongs to. A response answers nothing but a request.
    pub fn answer(
        &mut self,
        rules: &PairingRules,
        header: &[u64],
        response: bool,
    ) -> Result<Answered, Reason> {
        let same = rules.same(header);
        let own = rules.slot(header);
        let mut reason: Reason = NO_REQUEST.into();
        for slot in [own, None].into_iter().take(if own.is_none() { 1 } else { 2 }) {
            let Some(waiting) = self.slots.get(&slot) else { continue };
            if response && waiting.frame.asked.is_none() {
                continue;
            }
            match waiting.same.iter().zip(&same).position(|(asked, answered)| asked != answered) {
                Some(differs) if &*reason == NO_REQUEST => {
                    reason = rules.same.get(differs).map_or(reason, |(_, why)| why.clone());
                }
                Some(_) => {}
                None => {
                    return self.slots.remove(&slot).map(|waiting| waiting.frame).ok_or(reason);
                }
            }
        }
        Err(reason)
    }

    /// The reason of an answer when the protocol does not pair.
    pub fn none() -> Reason {
        NO_REQUEST.into()
    }
}
