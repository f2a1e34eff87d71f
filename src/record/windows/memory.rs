//! What happened lately, packed, for windows that reach back: bounded by bytes.
//!
//! Entries stand in blocks in the order of their coming. A frame takes some 25 bytes instead of the
//! hundred that it has in the queue. What is in a window already is marked, so that it is in none
//! twice and that, when a block goes, it is known what of it no window wanted.

use std::collections::VecDeque;

use super::packed::{self, Unpacked};
use crate::frame::Timestamp;
use crate::record::entry::Entry;

/// Bytes of a block: what is given up at a time where there is not enough room.
const BLOCK: usize = 16 << 10;
/// Most blocks given up that are remembered; older ones are added up.
const REMEMBERED: usize = 4096;

/// What happened lately.
pub struct Memory {
    limit: usize,
    bytes: usize,
    buses: usize,
    blocks: VecDeque<Block>,
    /// Number of the first block.
    first: u64,
    /// What had to go early, by block.
    given_up: VecDeque<GivenUp>,
}

struct Block {
    packed: Vec<u8>,
    /// What is not packed, in order.
    others: Vec<Entry>,
    bytes: usize,
    span: (Timestamp, Timestamp),
    /// For each bus what is in it, and what of that is in a window.
    counts: Vec<(u64, u64)>,
}

/// What was given up although a window might want it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GivenUp {
    /// Times of the earliest and latest entry.
    pub span: (Timestamp, Timestamp),
    /// For each bus how much.
    pub counts: Vec<u64>,
}

/// An entry in the memory.
pub struct Found {
    /// The entry.
    pub entry: Entry,
    /// It is in a window already.
    pub marked: bool,
    at: Place,
}

/// A place in the memory, in front of an entry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    block: u64,
    at: usize,
    other: usize,
}

impl Memory {
    /// A memory that holds at most about `limit` bytes, of so many buses.
    pub fn new(limit: usize, buses: usize) -> Self {
        let (blocks, given_up) = (VecDeque::new(), VecDeque::new());
        Self { limit, bytes: 0, buses, blocks, first: 0, given_up }
    }

    /// Adds what has happened.
    pub fn push(&mut self, entry: &Entry) {
        if self.blocks.back().is_none_or(|block| block.bytes >= BLOCK) {
            self.blocks.push_back(Block::new(self.buses, entry.time()));
        }
        let Some(block) = self.blocks.back_mut() else { return };
        let before = block.bytes;
        block.push(entry);
        self.bytes += block.bytes - before;
    }

    /// The entry at `place`, which moves on behind it.
    pub fn next(&self, place: &mut Place) -> Option<Found> {
        if place.block < self.first {
            *place = Place { block: self.first, ..Place::default() };
        }
        loop {
            let at = *place;
            if let Some((entry, marked)) = self.block(place.block)?.next(place) {
                return Some(Found { entry, marked, at });
            }
            // The last block still grows.
            if place.block + 1 >= self.first + self.blocks.len() as u64 {
                return None;
            }
            *place = Place { block: place.block + 1, ..Place::default() };
        }
    }

    /// Notes that what was found is in a window now, or in none any more.
    pub fn mark(&mut self, found: &Found, kept: bool) {
        let Some(block) = self.block_mut(found.at.block) else { return };
        packed::mark(&mut block.packed, found.at.at, kept);
        if let Entry::Frame(item) = &found.entry
            && let Some((_, of_bus)) = block.counts.get_mut(usize::from(item.bus))
        {
            let weight = item.frame.value.weight();
            *of_bus = if kept { *of_bus + weight } else { of_bus.saturating_sub(weight) };
        }
    }

    /// Takes back the marks of what happened at `from` or later.
    pub fn unmark(&mut self, from: Timestamp) {
        let mut place = self.place_of(from);
        while let Some(found) = self.next(&mut place) {
            if found.marked && found.entry.time() >= from {
                self.mark(&found, false);
            }
        }
    }

    /// A place in front of everything from `time` on.
    pub fn place_of(&self, time: Timestamp) -> Place {
        // The last block still grows.
        let whole = self.blocks.iter().take(self.blocks.len().saturating_sub(1));
        let older = whole.take_while(|block| block.span.1 < time).count();
        Place { block: self.first + older as u64, ..Place::default() }
    }

    /// Forgets what is older than `horizon` and in front of `needed`. `outside` is told of each bus
    /// how much of it was in no window.
    pub fn expire(
        &mut self,
        horizon: Timestamp,
        needed: Place,
        mut outside: impl FnMut(usize, u64),
    ) {
        while let Some(block) = self.blocks.front() {
            if block.span.1 >= horizon || self.first >= needed.block {
                break;
            }
            self.drop_first(&mut outside);
        }
        while self.given_up.front().is_some_and(|given_up| given_up.span.1 < horizon) {
            self.given_up.pop_front();
        }
    }

    /// True when it holds more than it may.
    pub fn is_over(&self) -> bool {
        self.bytes > self.limit && self.blocks.len() > 1
    }

    /// Gives up the oldest block.
    pub fn give_up(&mut self, mut outside: impl FnMut(usize, u64)) {
        let Some(span) = self.blocks.front().map(|block| block.span) else { return };
        let mut counts = vec![0; self.buses];
        self.drop_first(&mut |bus, count| {
            outside(bus, count);
            counts[bus] = count;
        });
        self.given_up.push_back(GivenUp { span, counts });
        if self.given_up.len() > REMEMBERED
            && let Some(oldest) = self.given_up.pop_front()
            && let Some(next) = self.given_up.front_mut()
        {
            next.add(&oldest);
        }
    }

    /// What was given up from `from` on; it is not told again.
    pub fn take_given_up(&mut self, from: Timestamp) -> Option<GivenUp> {
        let mut sum: Option<GivenUp> = None;
        self.given_up.retain(|part| {
            let wanted = part.span.1 >= from;
            if wanted && part.counts.iter().any(|count| *count > 0) {
                match &mut sum {
                    Some(sum) => sum.add(part),
                    None => sum = Some(part.clone()),
                }
            }
            !wanted
        });
        sum
    }

    /// True when something from `from` on was given up.
    pub fn lacks(&self, from: Timestamp) -> bool {
        self.given_up.iter().any(|part| part.span.1 >= from)
    }

    fn drop_first(&mut self, outside: &mut impl FnMut(usize, u64)) {
        let Some(block) = self.blocks.pop_front() else { return };
        self.first += 1;
        self.bytes -= block.bytes;
        for (bus, (all, kept)) in block.counts.into_iter().enumerate() {
            outside(bus, all - kept);
        }
    }

    fn block(&self, number: u64) -> Option<&Block> {
        self.blocks.get(usize::try_from(number.checked_sub(self.first)?).ok()?)
    }

    fn block_mut(&mut self, number: u64) -> Option<&mut Block> {
        self.blocks.get_mut(usize::try_from(number.checked_sub(self.first)?).ok()?)
    }
}

impl Place {
    /// Behind everything.
    pub const LAST: Self = Self { block: u64::MAX, at: 0, other: 0 };
}

impl GivenUp {
    fn add(&mut self, other: &Self) {
        self.span = (self.span.0.min(other.span.0), self.span.1.max(other.span.1));
        for (sum, count) in self.counts.iter_mut().zip(&other.counts) {
            *sum += count;
        }
    }
}

impl Block {
    fn new(buses: usize, time: Timestamp) -> Self {
        let packed = Vec::with_capacity(BLOCK + 256);
        let counts = vec![(0, 0); buses];
        Self { packed, others: Vec::new(), bytes: 0, span: (time, time), counts }
    }

    fn push(&mut self, entry: &Entry) {
        let before = self.packed.len();
        if !packed::pack(entry, &mut self.packed) {
            self.others.push(entry.clone());
            self.bytes += entry.bytes();
        }
        self.bytes += self.packed.len() - before;
        if let Entry::Frame(item) = entry
            && let Some((count, _)) = self.counts.get_mut(usize::from(item.bus))
        {
            *count += item.frame.value.weight();
        }
        let time = entry.time();
        self.span = (self.span.0.min(time), self.span.1.max(time));
    }

    /// The entry at `place`, which is in this block.
    fn next(&self, place: &mut Place) -> Option<(Entry, bool)> {
        let (found, marked, length) = packed::unpack(self.packed.get(place.at..)?)?;
        let entry = match found {
            Unpacked::Entry(entry) => entry,
            Unpacked::Other => {
                place.other += 1;
                self.others.get(place.other - 1)?.clone()
            }
        };
        place.at += length;
        Some((entry, marked))
    }
}
