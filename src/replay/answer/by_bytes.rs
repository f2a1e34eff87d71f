//! Answers on a serial line whose protocol is not known: a request is the bytes that the host sent
//! before the device spoke, and is known again by all of them.

use std::collections::BTreeSet;

use super::book::{Book, Found, MOST, Recorded};
use super::{Answerer, Counts, Learnt, Manner, Pupil, Reply};
use crate::frame::{Direction, Frame, SerialBytes, Timestamp};
use crate::replay::sink::Heard;

/// Bytes that have this much silence behind them are all that is asked, nanoseconds.
const SILENCE: u64 = 50_000_000;
/// Longest request.
const LONGEST: usize = 64 << 10;
/// What a piece takes beside its bytes, about.
const EACH: usize = 32;

/// What was said, in pieces: how long after the first, and the bytes.
type Pieces = Vec<(u64, Vec<u8>)>;

/// Learns what a device says.
#[derive(Default)]
pub struct Learner {
    book: Book<Pieces>,
    request: Vec<u8>,
    /// When the request was complete.
    asked: Timestamp,
    /// When the answer began, and its pieces.
    answer: Option<(Timestamp, Pieces)>,
    /// What the answer takes.
    size: usize,
}

impl Learner {
    /// Takes the next bytes of the recording.
    pub fn learn(&mut self, time: Timestamp, bytes: &SerialBytes) {
        match bytes.direction {
            Direction::Tx => {
                self.close();
                // A host that asks again after a pause has given up what it asked before.
                if time.since(self.asked) >= SILENCE && !self.request.is_empty() {
                    self.close_request();
                }
                self.request.extend_from_slice(&bytes.data);
                self.request.truncate(LONGEST);
                self.asked = time;
            }
            Direction::Rx if self.request.is_empty() => {}
            Direction::Rx => {
                let (began, pieces) = self.answer.get_or_insert_with(|| (time, Vec::new()));
                pieces.push((time.since(*began), bytes.data.clone()));
                self.size += bytes.data.len() + EACH;
                // A device that never stops talking must not fill the memory: the book has no room
                // for this, and the request stays without an answer.
                if self.size > MOST {
                    self.close();
                }
            }
        }
    }

    /// Takes notice that something is missing in the recording here.
    pub fn gap(&mut self) {
        self.request.clear();
        self.answer = None;
        self.size = 0;
    }

    /// The host speaks again, so the answer is complete.
    fn close(&mut self) {
        let Some((began, pieces)) = self.answer.take() else { return };
        let size = std::mem::take(&mut self.size);
        self.book.ask(&self.request);
        self.book.answer(&self.request, began.since(self.asked), began, pieces, size);
        self.request.clear();
    }

    fn close_request(&mut self) {
        self.book.ask(&self.request);
        self.request.clear();
    }

    /// Ends with a device that answers as was learnt. The second value is how many answers it has;
    /// the third is true if there was no room for all.
    pub fn finish(mut self, manner: Manner) -> (ByBytes, usize, bool) {
        self.close();
        if !self.request.is_empty() {
            self.close_request();
        }
        let (answers, full) = (self.book.answers(), self.book.is_full());
        let requests = self.book.requests().map(<[u8]>::to_vec).collect();
        let device = ByBytes {
            book: self.book,
            requests,
            manner,
            held: Vec::new(),
            heard: 0,
            counts: Counts::default(),
            notes: Vec::new(),
        };
        (device, answers, full)
    }
}

impl Pupil for Learner {
    fn take(&mut self, time: Timestamp, frame: &Frame) {
        match frame {
            Frame::Serial(bytes) => self.learn(time, bytes),
            Frame::Gap(_) => self.gap(),
            Frame::Can(_) | Frame::Notice(_) => {}
        }
    }

    fn graduate(self: Box<Self>, manner: Manner) -> Learnt {
        let (device, answers, full) = self.finish(manner);
        Learnt { device: Box::new(device), answers, full }
    }
}

/// A device, learnt from a recording.
pub struct ByBytes {
    book: Book<Pieces>,
    /// All that was asked, in order.
    requests: BTreeSet<Vec<u8>>,
    manner: Manner,
    /// Bytes that are no whole request yet, or one that a longer one begins with.
    held: Vec<u8>,
    /// When the last of them came, on the steady clock.
    heard: u64,
    counts: Counts,
    notes: Vec<String>,
}

impl ByBytes {
    /// True if a recorded request begins with what is held and goes on.
    fn may_go_on(&self) -> bool {
        let longer = self.requests.range(self.held.clone()..).find(|r| **r != self.held);
        longer.is_some_and(|request| request.starts_with(&self.held))
    }

    fn answer(&mut self, reply: Reply<'_>) {
        let request = std::mem::take(&mut self.held);
        self.counts.requests += 1;
        match self.book.find(&request, self.manner.cycle) {
            Found::Answer(Recorded { delay, time, answer }) => {
                self.counts.answered += 1;
                for (after, data) in answer.iter() {
                    let at = if self.manner.delay { delay + after } else { 0 };
                    let data = data.clone();
                    let bytes = SerialBytes { direction: Direction::Rx, data, errors: Vec::new() };
                    reply(at, time.plus(*after), Frame::Serial(bytes));
                }
            }
            Found::Silence => self.counts.silent += 1,
            Found::Unknown => {
                let hex: Vec<String> =
                    request.iter().take(64).map(|byte| format!("{byte:02X}")).collect();
                let what = format!("[{}]", hex.join(" "));
                if self.counts.miss(&what) {
                    self.notes.push(format!("never recorded: {what}"));
                }
            }
        }
    }
}

impl Answerer for ByBytes {
    fn hear(&mut self, now: u64, heard: Heard<'_>, reply: Reply<'_>) {
        let Heard::Serial(bytes) = heard else { return };
        for &byte in bytes {
            if self.held.len() < LONGEST {
                self.held.push(byte);
            }
            if self.requests.contains(&self.held) && !self.may_go_on() {
                self.answer(reply);
            }
        }
        self.heard = now;
    }

    fn next_look(&self) -> Option<u64> {
        (!self.held.is_empty()).then_some(self.heard + SILENCE)
    }

    fn look(&mut self, now: u64, reply: Reply<'_>) {
        if self.next_look().is_some_and(|look| now >= look) {
            self.answer(reply);
        }
    }

    fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    fn counts(&self) -> &Counts {
        &self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MILLI: u64 = 1_000_000;

    fn device(dialogue: &[(u64, Direction, &[u8])], cycle: bool) -> ByBytes {
        let mut learner = Learner::default();
        for (time, direction, data) in dialogue {
            let bytes =
                SerialBytes { direction: *direction, data: data.to_vec(), errors: Vec::new() };
            learner.learn(Timestamp(time * MILLI), &bytes);
        }
        learner.finish(Manner { cycle, delay: true, error: false }).0
    }

    fn ask(device: &mut ByBytes, now: u64, bytes: &[u8]) -> Vec<(u64, Vec<u8>)> {
        let mut answers = Vec::new();
        let mut reply = |delay, _, frame| {
            let Frame::Serial(bytes) = frame else { panic!() };
            answers.push((delay, bytes.data));
        };
        device.hear(now, Heard::Serial(bytes), &mut reply);
        device.look(now + SILENCE, &mut reply);
        answers
    }

    #[test]
    fn a_dialogue_is_learnt_with_its_pieces_and_times() {
        use Direction::{Rx, Tx};
        let mut device = device(
            &[
                (1000, Tx, b"A"),
                (1001, Tx, b"B"),
                (1011, Rx, b"x"),
                (1014, Rx, b"y"),
                (2000, Tx, b"AB"),
                (2005, Rx, b"z"),
                (3000, Tx, b"ABC"),
                (4000, Tx, b"Q"),
            ],
            true,
        );
        let first = vec![(10 * MILLI, b"x".to_vec()), (13 * MILLI, b"y".to_vec())];
        assert_eq!(ask(&mut device, 0, b"AB"), first);
        assert_eq!(ask(&mut device, 0, b"AB"), [(5 * MILLI, b"z".to_vec())]);
        assert_eq!(ask(&mut device, 0, b"AB"), first);
        assert_eq!(ask(&mut device, 0, b"ABC"), []);
        assert_eq!(ask(&mut device, 0, b"N"), []);
        let counts = device.counts();
        assert_eq!((counts.requests, counts.answered, counts.silent), (5, 3, 1));
        assert_eq!(device.take_notes(), ["never recorded: [4E]"]);
    }

    #[test]
    fn an_answer_without_end_is_not_remembered() {
        let mut learner = Learner::default();
        let piece = |direction, data| SerialBytes { direction, data, errors: Vec::new() };
        learner.learn(Timestamp(0), &piece(Direction::Tx, b"A".to_vec()));
        for n in 1..=80 {
            learner.learn(Timestamp(n), &piece(Direction::Rx, vec![0; 1 << 20]));
        }
        assert!(learner.answer.is_none(), "80 MiB are held");
        let (mut device, answers, full) =
            learner.finish(Manner { cycle: true, delay: true, error: false });
        assert_eq!((answers, full), (0, true));
        assert_eq!(ask(&mut device, 0, b"A"), []);
        assert_eq!(device.counts().silent, 1);
    }
}
