//! Answers on a CAN bus: rules say which frames ask and which answer them. A request may be
//! several frames in a row; it is known again by their identifiers and data.

use std::collections::BTreeSet;

use super::book::{Book, Found, MOST};
use super::{Answerer, Counts, Learnt, Manner, Pupil, Reply};
use crate::decode::answers::AnswerRule;
use crate::frame::{CanFlags, CanFrame, Frame, Timestamp};
use crate::replay::sink::Heard;

/// Frames of a request that have this much silence behind them are all of it, nanoseconds.
const SILENCE: u64 = 50_000_000;
/// What comes later than this after a request, or after the frame before, answers it no more.
const LATE: u64 = 1_000_000_000;
/// Most frames of a request.
const LONGEST: usize = 256;
/// What a frame of an answer takes, about.
const EACH: usize = 80;

/// What was said: how long after the first frame, and the frame.
type Frames = Vec<(u64, Said)>;

/// A frame as a key.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Said {
    id: u32,
    flags: u8,
    dlc: u8,
    data: Vec<u8>,
}

impl Said {
    fn of(frame: &CanFrame) -> Self {
        // Who sent it at that time does not matter now.
        let flags = frame.flags.0 & !CanFlags::TX.0;
        Self { id: frame.id, flags, dlc: frame.dlc, data: frame.data().to_vec() }
    }

    fn frame(&self) -> CanFrame {
        CanFrame::new(self.id, CanFlags(self.flags), &self.data).with_dlc(self.dlc)
    }
}

/// One rule's dialogue while it is learnt.
#[derive(Default)]
struct Learning {
    request: Vec<u8>,
    frames: usize,
    asked: Timestamp,
    answer: Option<(Timestamp, Frames)>,
    latest: Timestamp,
}

/// Learns what a device says.
pub struct Learner {
    rules: Vec<AnswerRule>,
    books: Vec<Book<Frames>>,
    open: Vec<Learning>,
}

impl Learner {
    /// Begins with empty books.
    pub fn new(rules: Vec<AnswerRule>) -> Self {
        let books = rules.iter().map(|_| Book::new()).collect();
        let open = rules.iter().map(|_| Learning::default()).collect();
        Self { rules, books, open }
    }

    /// Takes the next frame of the recording.
    pub fn learn(&mut self, time: Timestamp, frame: &CanFrame) {
        for ((rule, book), open) in self.rules.iter().zip(&mut self.books).zip(&mut self.open) {
            if rule.asks(frame) {
                open.close(book);
                if time.since(open.asked) >= SILENCE && open.frames > 0 {
                    open.close_request(book);
                }
                if open.frames < LONGEST {
                    put(&mut open.request, frame);
                    open.frames += 1;
                }
                (open.asked, open.latest) = (time, time);
            } else if rule.answers(frame) && open.frames > 0 && time.since(open.latest) < LATE {
                open.latest = time;
                let (began, frames) = open.answer.get_or_insert_with(|| (time, Vec::new()));
                frames.push((time.since(*began), Said::of(frame)));
                // The book has no room for this, and the request stays without an answer.
                if frames.len() * EACH > MOST {
                    open.close(book);
                }
            }
        }
    }

    /// Takes notice that something is missing in the recording here.
    pub fn gap(&mut self) {
        self.open.iter_mut().for_each(|open| *open = Learning::default());
    }

    /// Ends with a device that answers as was learnt. The second value is how many answers it has;
    /// the third is true if there was no room for all.
    pub fn finish(mut self, manner: Manner) -> (ByFrames, usize, bool) {
        for (open, book) in self.open.iter_mut().zip(&mut self.books) {
            open.close(book);
            if open.frames > 0 {
                open.close_request(book);
            }
        }
        let answers = self.books.iter().map(Book::answers).sum();
        let full = self.books.iter().any(Book::is_full);
        let devices = self.rules.into_iter().zip(self.books).map(|(rule, book)| {
            let requests = book.requests().map(<[u8]>::to_vec).collect();
            Device {
                rule,
                book,
                requests,
                held: Vec::new(),
                frames: 0,
                words: Vec::new(),
                heard: 0,
            }
        });
        let device = ByFrames {
            devices: devices.collect(),
            manner,
            counts: Counts::default(),
            notes: Vec::new(),
        };
        (device, answers, full)
    }
}

impl Pupil for Learner {
    fn take(&mut self, time: Timestamp, frame: &Frame) {
        match frame {
            Frame::Can(frame) => self.learn(time, frame),
            Frame::Gap(_) => self.gap(),
            Frame::Serial(_) | Frame::Notice(_) => {}
        }
    }

    fn graduate(self: Box<Self>, manner: Manner) -> Learnt {
        let (device, answers, full) = self.finish(manner);
        Learnt { device: Box::new(device), answers, full }
    }
}

impl Learning {
    /// Somebody asks again, so the answer is complete.
    fn close(&mut self, book: &mut Book<Frames>) {
        let Some((began, frames)) = self.answer.take() else { return };
        let size = frames.len() * EACH;
        book.ask(&self.request);
        book.answer(&self.request, began.since(self.asked), began, frames, size);
        self.request.clear();
        self.frames = 0;
    }

    fn close_request(&mut self, book: &mut Book<Frames>) {
        book.ask(&self.request);
        self.request.clear();
        self.frames = 0;
    }
}

/// Appends what makes a frame of a request that request.
fn put(request: &mut Vec<u8>, frame: &CanFrame) {
    let flags = frame.flags.0 & (CanFlags::EXTENDED | CanFlags::REMOTE).0;
    request.extend_from_slice(&frame.id.to_be_bytes());
    request.push(flags);
    request.push(frame.data().len().to_le_bytes()[0]);
    request.extend_from_slice(frame.data());
}

/// What one rule knows, and what it has heard of the next request.
struct Device {
    rule: AnswerRule,
    book: Book<Frames>,
    requests: BTreeSet<Vec<u8>>,
    held: Vec<u8>,
    frames: usize,
    /// The frames held, for a person.
    words: Vec<u8>,
    heard: u64,
}

impl Device {
    /// True if a recorded request begins with what is held and goes on.
    fn may_go_on(&self) -> bool {
        let longer = self.requests.range(self.held.clone()..).find(|r| **r != self.held);
        longer.is_some_and(|request| request.starts_with(&self.held))
    }
}

/// A device, learnt from a recording.
pub struct ByFrames {
    devices: Vec<Device>,
    manner: Manner,
    counts: Counts,
    notes: Vec<String>,
}

impl ByFrames {
    fn answer(&mut self, number: usize, reply: Reply<'_>) {
        let Some(device) = self.devices.get_mut(number) else { return };
        let request = std::mem::take(&mut device.held);
        let words = std::mem::take(&mut device.words);
        device.frames = 0;
        self.counts.requests += 1;
        match device.book.find(&request, self.manner.cycle) {
            Found::Answer(found) => {
                self.counts.answered += 1;
                for (after, said) in found.answer.iter() {
                    let at = if self.manner.delay { found.delay + after } else { 0 };
                    reply(at, found.time.plus(*after), Frame::Can(said.frame()));
                }
            }
            Found::Silence => self.counts.silent += 1,
            Found::Unknown => {
                let what = format!("{} [{}]", device.rule.name, String::from_utf8_lossy(&words));
                if self.counts.miss(&what) {
                    self.notes.push(format!("never recorded: {what}"));
                }
            }
        }
    }
}

impl Answerer for ByFrames {
    fn hear(&mut self, now: u64, heard: Heard<'_>, reply: Reply<'_>) {
        let Heard::Can(frame) = heard else { return };
        for number in 0..self.devices.len() {
            let device = &mut self.devices[number];
            if !device.rule.asks(&frame) || device.frames >= LONGEST {
                continue;
            }
            put(&mut device.held, &frame);
            if !device.words.is_empty() {
                device.words.push(b' ');
            }
            crate::text::candump::put(&mut device.words, &frame);
            device.frames += 1;
            device.heard = now;
            if device.requests.contains(&device.held) && !device.may_go_on() {
                self.answer(number, reply);
            }
        }
    }

    fn next_look(&self) -> Option<u64> {
        let held = self.devices.iter().filter(|device| device.frames > 0);
        held.map(|device| device.heard + SILENCE).min()
    }

    fn look(&mut self, now: u64, reply: Reply<'_>) {
        for number in 0..self.devices.len() {
            let device = &self.devices[number];
            if device.frames > 0 && now >= device.heard + SILENCE {
                self.answer(number, reply);
            }
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
    use crate::decode::answers::FramePattern;

    const MILLI: u64 = 1_000_000;

    fn can(id: u32, flags: CanFlags, data: &[u8]) -> CanFrame {
        CanFrame::new(id, flags, data)
    }

    fn rule(request: (u32, u32, bool), answer: (u32, u32)) -> AnswerRule {
        let pattern = |id, mask, remote| FramePattern { id, mask, extended: false, remote };
        AnswerRule {
            name: "r".to_owned(),
            request: vec![pattern(request.0, request.1, request.2)],
            answer: vec![pattern(answer.0, answer.1, false)],
        }
    }

    fn ask(device: &mut ByFrames, frames: &[CanFrame]) -> Vec<(u64, CanFrame)> {
        let mut answers = Vec::new();
        let mut reply = |delay, _, frame| {
            let Frame::Can(frame) = frame else { panic!() };
            answers.push((delay, frame));
        };
        for frame in frames {
            device.hear(0, Heard::Can(*frame), &mut reply);
        }
        device.look(SILENCE, &mut reply);
        answers
    }

    #[test]
    fn requests_of_several_frames_have_answers_of_several_frames() {
        let none = CanFlags::default();
        let rules = vec![
            rule((0x100, 0x7FF, true), (0x110, 0x7F0)),
            rule((0x200, 0x7F0, false), (0x300, 0x7F0)),
        ];
        let mut learner = Learner::new(rules);
        for (time, frame) in [
            (1000, can(0x100, CanFlags::REMOTE, &[])),
            (1002, can(0x555, none, &[9])),
            (1004, can(0x111, CanFlags::TX, &[1])),
            (1005, can(0x112, none, &[2])),
            (2000, can(0x200, none, &[7])),
            (2001, can(0x201, none, &[8])),
            (2010, can(0x300, none, &[3])),
            (9000, can(0x112, none, &[66])),
        ] {
            learner.learn(Timestamp(time * MILLI), &frame);
        }
        let manner = Manner { cycle: true, delay: true, error: false };
        let (mut device, answers, _) = learner.finish(manner);
        assert_eq!(answers, 2);
        let expected = [(4 * MILLI, can(0x111, none, &[1])), (5 * MILLI, can(0x112, none, &[2]))];
        assert_eq!(ask(&mut device, &[can(0x100, CanFlags::REMOTE, &[])]), expected);
        let both = [can(0x200, none, &[7]), can(0x201, none, &[8])];
        assert_eq!(ask(&mut device, &both), [(9 * MILLI, can(0x300, none, &[3]))]);
        assert_eq!(ask(&mut device, &both[..1]), []);
        assert_eq!(ask(&mut device, &[can(0x100, none, &[])]), []);
        assert_eq!(device.take_notes(), ["never recorded: r [200#07]"]);
    }

    #[test]
    fn an_answer_without_end_is_not_remembered() {
        let none = CanFlags::default();
        let mut learner = Learner::new(vec![rule((0x100, 0x7FF, false), (0x110, 0x7F0))]);
        learner.learn(Timestamp(0), &can(0x100, none, &[]));
        for n in 1..=1_000_000 {
            learner.learn(Timestamp(n), &can(0x111, none, &[1; 8]));
        }
        assert!(learner.open[0].answer.is_none(), "a million frames are held");
        let (_, answers, full) = learner.finish(Manner { cycle: true, delay: true, error: false });
        assert_eq!((answers, full), (0, true));
    }
}
