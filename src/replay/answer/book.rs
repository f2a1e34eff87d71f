//! What a recorded device answered to what, in its order.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;
use std::sync::Arc;

use crate::frame::Timestamp;

/// Most memory for answers, bytes.
pub(super) const MOST: usize = 64 << 20;
/// What an answer takes beside its content, about.
const EACH: usize = 48;

/// An answer.
#[derive(Debug, PartialEq, Eq)]
pub struct Recorded<A> {
    /// From the request's end to the answer's beginning, nanoseconds.
    pub delay: u64,
    /// When it was recorded.
    pub time: Timestamp,
    /// What was said. Equal answers are kept once.
    pub answer: Arc<A>,
}

// Not derived, since that would ask for `A: Clone`.
impl<A> Clone for Recorded<A> {
    fn clone(&self) -> Self {
        Self { delay: self.delay, time: self.time, answer: self.answer.clone() }
    }
}

/// All answers, by what was asked.
#[derive(Debug)]
pub struct Book<A> {
    pages: HashMap<Vec<u8>, Page<A>>,
    /// The answers there are.
    known: HashSet<Arc<A>>,
    used: usize,
    /// There was no room for more.
    full: bool,
}

#[derive(Debug)]
struct Page<A> {
    answers: Vec<Recorded<A>>,
    next: usize,
}

/// What a book says to a request.
#[derive(Debug, PartialEq, Eq)]
pub enum Found<A> {
    /// The recorded device answered so.
    Answer(Recorded<A>),
    /// The recorded device said nothing.
    Silence,
    /// It was never asked that.
    Unknown,
}

impl<A: Eq + Hash> Book<A> {
    /// An empty book.
    pub fn new() -> Self {
        Self { pages: HashMap::new(), known: HashSet::new(), used: 0, full: false }
    }

    /// Enters that this was asked.
    pub fn ask(&mut self, request: &[u8]) {
        if self.pages.contains_key(request) || !self.room(request.len()) {
            return;
        }
        self.pages.insert(request.to_vec(), Page { answers: Vec::new(), next: 0 });
    }

    /// Enters the answer to what was asked; `size` is its length in bytes.
    pub fn answer(&mut self, request: &[u8], delay: u64, time: Timestamp, answer: A, size: usize) {
        let known = self.known.get(&answer).cloned();
        if !self.room(if known.is_some() { 0 } else { size }) {
            return;
        }
        let answer = known.unwrap_or_else(|| {
            let answer = Arc::new(answer);
            self.known.insert(answer.clone());
            answer
        });
        if let Some(page) = self.pages.get_mut(request) {
            page.answers.push(Recorded { delay, time, answer });
        }
    }

    /// The next answer to `request`; behind the last one the first again if `cycle`, else the last.
    pub fn find(&mut self, request: &[u8], cycle: bool) -> Found<A> {
        let Some(page) = self.pages.get_mut(request) else { return Found::Unknown };
        let count = page.answers.len();
        let at = if cycle { page.next % count.max(1) } else { page.next.min(count.max(1) - 1) };
        let Some(found) = page.answers.get(at) else { return Found::Silence };
        page.next = if cycle { (at + 1) % count } else { (at + 1).min(count - 1) };
        Found::Answer(found.clone())
    }

    /// What was asked.
    pub fn requests(&self) -> impl Iterator<Item = &[u8]> {
        self.pages.keys().map(Vec::as_slice)
    }

    /// True if there was no room for everything.
    pub fn is_full(&self) -> bool {
        self.full
    }

    /// How many answers it has.
    pub fn answers(&self) -> usize {
        self.pages.values().map(|page| page.answers.len()).sum()
    }

    fn room(&mut self, size: usize) -> bool {
        self.full |= self.used + size + EACH > MOST;
        if !self.full {
            self.used += size + EACH;
        }
        !self.full
    }
}

impl<A: Eq + Hash> Default for Book<A> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_in_their_order_and_then_again_or_the_last_stays() {
        for (cycle, expected) in [(true, ["a", "b", "a", "b"]), (false, ["a", "b", "b", "b"])] {
            let mut book = Book::new();
            book.ask(b"q");
            for answer in ["a", "b"] {
                book.answer(b"q", 7, Timestamp(1), answer, 1);
            }
            let found = expected.map(|_| match book.find(b"q", cycle) {
                Found::Answer(found) => *found.answer,
                other => panic!("{other:?}"),
            });
            assert_eq!(found, expected);
            book.ask(b"silent");
            assert_eq!(book.find(b"silent", cycle), Found::Silence);
            assert_eq!(book.find(b"never", cycle), Found::Unknown);
        }
    }

    #[test]
    fn a_dialogue_without_end_does_not_fill_the_memory() {
        let mut book = Book::new();
        for number in 0..40_u64 {
            book.ask(&number.to_be_bytes());
            book.answer(&number.to_be_bytes(), 0, Timestamp(1), number, 4 << 20);
        }
        assert!(book.is_full() && book.answers() < 17);
    }
}
