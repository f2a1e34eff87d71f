//! Answers on a serial line whose protocol is known: requests are matched by what they mean, and
//! the recorded answer is made to fit the request at hand.

use std::sync::Arc;

use super::book::{Book, Found};
use super::{Answerer, Counts, Learnt, Manner, Pupil, Reply};
use crate::frame::{Direction, Frame, SerialBytes, Timestamp};
use crate::protocol::item::{FrameItem, Item, ItemKind};
use crate::protocol::message::Message;
use crate::protocol::{Decoder, Protocol, Side};
use crate::replay::sink::Heard;

/// Requests that wait for their answer while a recording is learnt.
const WAITING: usize = 64;

/// A device, learnt from a recording.
pub struct ByMeaning {
    protocol: Arc<Protocol>,
    manner: Manner,
    book: Book<Vec<u8>>,
    decoder: Decoder,
    counts: Counts,
    notes: Vec<String>,
    /// When bytes came last, on the steady clock; only where silence ends a frame.
    heard: Option<u64>,
}

/// Learns what a device says.
pub struct Learner {
    protocol: Arc<Protocol>,
    decoder: Decoder,
    book: Book<Vec<u8>>,
    /// What was asked, and when it was complete.
    waiting: Vec<(FrameItem, Timestamp)>,
}

impl Learner {
    /// Begins with an empty book.
    pub fn new(protocol: Arc<Protocol>) -> Self {
        let decoder = Decoder::new(protocol.clone());
        Self { protocol, decoder, book: Book::new(), waiting: Vec::new() }
    }

    /// Takes the next bytes of the recording.
    pub fn learn(&mut self, time: Timestamp, bytes: &SerialBytes) {
        let mut items = Vec::new();
        self.decoder.feed(bytes.direction, time, &bytes.data, &mut |item| items.push(item));
        for item in items {
            self.take(time, item);
        }
    }

    /// Takes notice that something is missing in the recording here.
    pub fn gap(&mut self) {
        self.decoder.finish(&mut |_| {});
        self.waiting.clear();
    }

    fn take(&mut self, now: Timestamp, item: Item) {
        let ItemKind::Frame(frame) = item.kind else { return };
        if frame.side == Some(Side::Response) {
            // What it answers is taken from the books of the decoder only as far as that knows it.
            let unpaired = match &frame.message {
                Some(Message::Response(response)) => response.asked.is_err(),
                Some(Message::LinkReply { answers, .. }) => answers.is_err(),
                _ => false,
            };
            let fits = |(asked, _): &(FrameItem, _)| self.protocol.pairs(asked, &frame);
            let Some(place) = self.waiting.iter().rposition(fits).filter(|_| !unpaired) else {
                return;
            };
            let (asked, at) = self.waiting.remove(place);
            let delay = item.time.since(at);
            let size = frame.bytes.len();
            let meaning = self.protocol.meaning(&asked);
            self.book.answer(&meaning, delay, item.time, frame.bytes, size);
        } else if frame.link_error.is_none() {
            self.book.ask(&self.protocol.meaning(&frame));
            if self.waiting.len() == WAITING {
                self.waiting.remove(0);
            }
            self.waiting.push((*frame, now));
        }
    }

    /// Ends with a device that answers as was learnt. The second value is how many answers it has;
    /// the third is true if there was no room for all.
    pub fn finish(self, manner: Manner) -> (ByMeaning, usize, bool) {
        let (answers, full) = (self.book.answers(), self.book.is_full());
        let device = ByMeaning {
            decoder: Decoder::new(self.protocol.clone()),
            protocol: self.protocol,
            manner,
            book: self.book,
            counts: Counts::default(),
            notes: Vec::new(),
            heard: None,
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

impl ByMeaning {
    fn answer(&mut self, item: Item, reply: Reply<'_>) {
        let frame = match item.kind {
            ItemKind::Frame(frame) if frame.link_error.is_none() => frame,
            ItemKind::Frame(_) | ItemKind::Other(_) => {
                self.counts.damaged += 1;
                if self.counts.damaged == 1 {
                    self.notes.push("something damaged was heard, and is not answered".to_owned());
                }
                return;
            }
        };
        if frame.side == Some(Side::Response) {
            return;
        }
        self.counts.requests += 1;
        match self.book.find(&self.protocol.meaning(&frame), self.manner.cycle) {
            Found::Answer(found) => {
                self.counts.answered += 1;
                let delay = if self.manner.delay { found.delay } else { 0 };
                reply(delay, found.time, said(self.protocol.refit(&found.answer, &frame)));
            }
            Found::Silence => self.counts.silent += 1,
            Found::Unknown => {
                let what = describe(&frame);
                if self.counts.miss(&what) {
                    self.notes.push(format!("never recorded: {what}"));
                }
                if let Some(error) =
                    self.protocol.error_answer(&frame).filter(|_| self.manner.error)
                {
                    reply(0, item.time, said(error));
                }
            }
        }
    }
}

impl Answerer for ByMeaning {
    fn hear(&mut self, now: u64, heard: Heard<'_>, reply: Reply<'_>) {
        let Heard::Serial(bytes) = heard else { return };
        let mut items = Vec::new();
        self.decoder.feed(Direction::Tx, Timestamp(now), bytes, &mut |item| items.push(item));
        for item in items {
            self.answer(item, reply);
        }
        self.heard = Some(now);
    }

    fn next_look(&self) -> Option<u64> {
        Some(self.heard? + self.protocol.silence()?)
    }

    fn look(&mut self, now: u64, reply: Reply<'_>) {
        if self.next_look().is_none_or(|look| now < look) {
            return;
        }
        self.heard = None;
        // Time that passes on the other line ends a frame on this one.
        let mut items = Vec::new();
        self.decoder.feed(Direction::Rx, Timestamp(now), &[], &mut |item| items.push(item));
        for item in items.into_iter().filter(|item| item.direction == Direction::Tx) {
            self.answer(item, reply);
        }
    }

    fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    fn counts(&self) -> &Counts {
        &self.counts
    }
}

fn said(data: Vec<u8>) -> Frame {
    Frame::Serial(SerialBytes { direction: Direction::Rx, data, errors: Vec::new() })
}

/// A request, for a person.
fn describe(frame: &FrameItem) -> String {
    let mut words: Vec<String> = Vec::new();
    match &frame.message {
        Some(Message::Request(request)) => {
            let asked = &request.asked;
            words.extend(asked.operation.iter().map(ToString::to_string));
            match (&asked.command, &asked.id) {
                (Some(command), _) => words.push(command.name.to_string()),
                (None, Some(id)) => words.push(id.quantity.hex(id.value)),
                (None, None) => {}
            }
        }
        Some(Message::Link { kind: Some(kind) }) => {
            let number = kind.value.to_string();
            words.push(kind.label().map_or(number, ToString::to_string));
        }
        _ => {}
    }
    let hex: Vec<String> = frame.bytes.iter().take(64).map(|byte| format!("{byte:02X}")).collect();
    words.push(format!("[{}]", hex.join(" ")));
    words.join(" ")
}
