//! What was read from chunks that overlap in time, given out in time order.
//!
//! Each chunk is a sorted run; what comes next is the earliest of their heads. Things of one time come by
//! their rank, then in the order of the chunks, then as they stand in one.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::limits::MAX_READY;
use super::reader::Entry;
use crate::frame::{Frame, Stamped, Timestamp};

/// By what runs are compared: the time and rank of the next entry, number and place of the run.
type Head = (Timestamp, (usize, bool), u64, usize);

/// Runs of entries.
#[derive(Default)]
pub struct Ready {
    /// Each with its earliest last, so that taking it is a pop.
    runs: Vec<Run>,
    heads: BinaryHeap<Reverse<Head>>,
    /// Places of runs that are used up.
    free: Vec<usize>,
    /// How many runs there were.
    number: u64,
    /// Bytes of memory for all of them, about.
    held: usize,
}

#[derive(Default)]
struct Run {
    entries: Vec<Stamped<Entry>>,
    bytes: usize,
}

impl Ready {
    /// When the next entry happened.
    pub fn next_time(&self) -> Option<Timestamp> {
        self.heads.peek().map(|Reverse(head)| head.0)
    }

    /// True when what is held should be given out first.
    pub fn is_full(&self) -> bool {
        self.held > MAX_READY
    }

    /// Adds what was in a chunk.
    pub fn add(&mut self, mut entries: Vec<Stamped<Entry>>) {
        // Stable, and then reversed: what is at the end comes first.
        entries.sort_by_key(|entry| (entry.time, entry.value.rank()));
        entries.reverse();
        let Some(first) = entries.last() else { return };
        let (time, rank) = (first.time, first.value.rank());
        let bytes = entries.iter().map(weight).sum();
        let place = self.free.pop().unwrap_or(self.runs.len());
        if place == self.runs.len() {
            self.runs.push(Run::default());
        }
        self.runs[place] = Run { entries, bytes };
        self.held += bytes;
        self.number += 1;
        self.heads.push(Reverse((time, rank, self.number, place)));
    }

    /// Takes the next entry.
    pub fn pop(&mut self) -> Option<Stamped<Entry>> {
        let mut head = self.heads.peek_mut()?;
        let Reverse((.., number, place)) = *head;
        let run = &mut self.runs[place];
        let entry = run.entries.pop();
        if let Some(next) = run.entries.last() {
            *head = Reverse((next.time, next.value.rank(), number, place));
        } else {
            std::collections::binary_heap::PeekMut::pop(head);
            self.held -= std::mem::take(run).bytes;
            self.free.push(place);
        }
        entry
    }
}

fn weight(entry: &Stamped<Entry>) -> usize {
    let heap = match &entry.value {
        Entry::Message { data, .. } => data.len(),
        Entry::Frame(_, Frame::Serial(bytes)) => bytes.data.len() + 16 * bytes.errors.len(),
        Entry::Frame(..) => 0,
    };
    size_of::<Stamped<Entry>>() + heap
}
