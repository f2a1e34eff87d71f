//! The frames of one bus, one after the other: what each means, and what several mean together.

use std::sync::Arc;

use super::assembly::{Assembled, Open};
use super::can::{Check, Found, Match, key};
use super::context::{Last, Seen};
use super::definition::{CanDefinition, RemoteMessage};
use crate::frame::{CanFlags, CanFrame, Timestamp};

/// What a frame is, or what it has made complete.
#[derive(Clone, Copy, Debug)]
pub enum CanItem<'a> {
    /// A data frame that carries a message; [`Match::decode`] gives its signals.
    Message(Match<'a>),
    /// A remote frame that is a message.
    Remote(&'a RemoteMessage),
    /// A frame of which nothing is known: unknown identifier, other remote frames, error frames.
    Unknown,
    /// Several frames together.
    Assembly(Assembled<'a>),
}

/// Decodes the frames of one bus in the order of their times.
///
/// Its memory is bounded: one frame for each rule, and up to [`super::assembly::LONGEST`] bytes
/// for each assembly.
#[derive(Debug)]
pub struct CanBus {
    definition: Arc<CanDefinition>,
    /// By rule: the last frame that concerns it.
    last: Vec<Last>,
    /// By assembly.
    open: Vec<Open>,
}

impl CanBus {
    /// Begins without any frame seen.
    pub fn new(definition: Arc<CanDefinition>) -> Self {
        let last = vec![Last::default(); definition.meanings.len()];
        let open = definition.assemblies.iter().map(|_| Open::default()).collect();
        Self { definition, last, open }
    }

    /// What it decodes with.
    pub fn definition(&self) -> &Arc<CanDefinition> {
        &self.definition
    }

    /// Takes the next frame. `visit` gets first what the frame itself is, then the assemblies that
    /// it ended: one that it left incomplete, one that it made complete. Allocates nothing for
    /// frames that are no part of an assembly.
    #[inline]
    pub fn feed(&mut self, time: Timestamp, frame: &CanFrame, visit: &mut impl FnMut(CanItem<'_>)) {
        let decoder = &self.definition.decoder;
        let found = decoder.identify(frame);
        let plain = |found: &Found| !self.definition.ruled.get(found.index).is_some_and(|is| *is);
        if let Some(found) = found.filter(plain) {
            visit(decoder.as_message(found, frame).map_or(CanItem::Unknown, CanItem::Message));
            return;
        }
        self.feed_ruled(time, frame, found, visit);
    }

    /// Says that the input has ended, or that frames were lost here: what is open is given up, and
    /// what came before tells nothing about what follows.
    pub fn finish(&mut self, visit: &mut impl FnMut(CanItem<'_>)) {
        let mut give = |assembled: Assembled<'_>| visit(CanItem::Assembly(assembled));
        for (assembly, open) in self.definition.assemblies.iter().zip(&mut self.open) {
            open.give_up(assembly, &mut give);
        }
        self.last.fill(Last::default());
    }

    /// A frame that a rule may be about: remote, unknown, or a message with rules.
    fn feed_ruled(
        &mut self,
        time: Timestamp,
        frame: &CanFrame,
        found: Option<Found>,
        visit: &mut impl FnMut(CanItem<'_>),
    ) {
        if frame.flags.has(CanFlags::ERROR) {
            visit(CanItem::Unknown);
            return;
        }
        let Self { definition, last, open } = self;
        let key = key(frame.id, frame.flags.has(CanFlags::EXTENDED));
        if frame.flags.has(CanFlags::REMOTE) {
            let at = definition.remotes.iter().position(|remote| remote.key() == key);
            remember(definition, last, key, time, at.map_or(Seen::Nothing, Seen::Remote));
            let remote = at.and_then(|at| definition.remotes.get(at));
            visit(remote.map_or(CanItem::Unknown, CanItem::Remote));
            return;
        }
        let found = meaning(definition, last, key, time, frame).or(found);
        let message = found.map(|found| found.index);
        let mut found = found.and_then(|found| definition.decoder.as_message(found, frame));
        let whole = found.is_some_and(|found| found.check == Check::Exact);
        let seen = message.filter(|_| whole).map_or(Seen::Nothing, Seen::Message);
        remember(definition, last, key, time, seen);
        let numbered = || {
            let numbered = definition.assemblies.iter().map(|a| (a, a.number(key, message)));
            numbered.enumerate().filter_map(|(at, (a, number))| Some((at, a, number?)))
        };
        // What a frame behind the first has to carry is not declared.
        if let Some(found) = &mut found
            && found.check == Check::Short
            && !frame.data().is_empty()
            && numbered().any(|(_, assembly, number)| assembly.ends_anywhere() && number > 0)
        {
            found.check = Check::Exact;
        }
        visit(found.map_or(CanItem::Unknown, CanItem::Message));
        let mut give = |assembled: Assembled<'_>| visit(CanItem::Assembly(assembled));
        for (at, assembly, number) in numbered() {
            if let Some(open) = open.get_mut(at) {
                open.take(assembly, number, found.as_ref(), (time, frame.data()), &mut give);
            }
        }
    }
}

/// The message that a rule makes of the frame.
fn meaning(
    definition: &CanDefinition,
    last: &[Last],
    key: u32,
    time: Timestamp,
    frame: &CanFrame,
) -> Option<Found> {
    let mut rules = definition.meanings.iter().zip(last);
    let (rule, _) = rules.find(|(rule, last)| rule.holds(key, frame.data().len(), time, last))?;
    Some(Found { index: rule.message, j1939: None })
}

fn remember(definition: &CanDefinition, last: &mut [Last], key: u32, time: Timestamp, seen: Seen) {
    for (rule, last) in definition.meanings.iter().zip(last) {
        if rule.watches(key) {
            *last = Last { seen, time };
        }
    }
}

impl RemoteMessage {
    pub(super) fn key(&self) -> u32 {
        key(self.id, self.extended)
    }
}
