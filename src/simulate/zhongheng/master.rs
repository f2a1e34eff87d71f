//! The supervision computer: connects, and then asks one thing after the other.

use std::collections::VecDeque;

use super::frame::{Control, Deframer, Escaping, Frame, MAX_DATA, link};
use super::layout::{command, commands};
use super::plant::RECTIFIERS;
use super::slave::{SET, status};
use crate::simulate::random::Random;

const MILLISECOND: u64 = 1_000_000;
/// An answer of 262 bytes takes 140 ms on the line; after this long there will be none.
const TIMEOUT: u64 = 600 * MILLISECOND;
/// The same request is sent this often before the slave counts as gone (section 4).
const ATTEMPTS: u8 = 3;
/// Pause before a slave that is not there is called again.
const RECONNECT: u64 = 1000 * MILLISECOND;

const ANALOGS: u16 = 0x407E;
const RECTIFIER: u16 = 0x40EC;
const ALARMS: u16 = 0x414B;

/// A request on its way.
#[derive(Clone, Debug)]
struct Outstanding {
    frame: Frame,
    sent: u64,
    attempts: u8,
}

/// A master that polls one slave. Pure: [`Master::poll`] says what to send, [`Master::feed`] takes
/// what came back.
#[derive(Clone, Debug)]
pub struct Master {
    random: Random,
    address: u16,
    deframer: Deframer,
    connected: bool,
    sequence: u8,
    outstanding: Option<Outstanding>,
    due: u64,
    /// Requests that go before the usual round.
    urgent: VecDeque<Vec<u8>>,
    round: Vec<Vec<u8>>,
    next: usize,
    rectifier: usize,
    turn: usize,
    answers: u64,
    settings_read: u64,
}

impl Master {
    /// A master for the slave with `address`; 0 calls whichever slave is there.
    pub fn new(seed: u64, address: u16) -> Self {
        let mut random = Random::new(seed, 0x4A57);
        Self {
            address,
            deframer: Deframer::default(),
            connected: false,
            sequence: 0,
            outstanding: None,
            due: 20 * MILLISECOND,
            urgent: VecDeque::new(),
            round: round(&mut random),
            random,
            next: 0,
            rectifier: 0,
            turn: 0,
            answers: 0,
            settings_read: 0,
        }
    }

    /// When [`Master::poll`] has something to do next, ns since the beginning.
    pub fn due(&self) -> u64 {
        self.outstanding.as_ref().map_or(self.due, |o| o.sent + TIMEOUT)
    }

    /// Good answers so far.
    pub fn answers(&self) -> u64 {
        self.answers
    }

    /// The bytes to send at `now` (ns since the beginning), if it is time to send any.
    pub fn poll(&mut self, now: u64) -> Option<Vec<u8>> {
        if now < self.due() {
            return None;
        }
        let request = match self.outstanding.take() {
            None => Outstanding { frame: self.request(), sent: now, attempts: 1 },
            Some(lost) if lost.attempts < ATTEMPTS => {
                Outstanding { sent: now, attempts: lost.attempts + 1, ..lost }
            }
            Some(_) => {
                self.connected = false;
                self.due = now + RECONNECT;
                return None;
            }
        };
        let connecting = request.frame.control.link() == link::CONNECT;
        // The connect frame is escaped fully; its data 0 then turns that off (section 6.3).
        let escaping = if connecting { Escaping::Full } else { Escaping::Minimal };
        let bytes = request.frame.encode(escaping);
        self.outstanding = Some(request);
        Some(bytes)
    }

    /// Takes `bytes` that arrived at `now`.
    pub fn feed(&mut self, bytes: &[u8], now: u64) {
        for byte in bytes {
            if let Some(frame) = self.deframer.push(*byte) {
                self.receive(&frame, now);
            }
        }
    }

    fn request(&mut self) -> Frame {
        if !self.connected {
            self.sequence = 0;
            let control = Control(Control::ACK | link::CONNECT);
            return Frame { address: self.address, control, data: vec![0] };
        }
        let control = Control(Control::ACK | self.sequence | link::SINGLE);
        Frame { address: self.address, control, data: self.next_command() }
    }

    /// Every third request goes through the whole list, the others follow what moves: the plant's
    /// analog values, and one rectifier after the other.
    fn next_command(&mut self) -> Vec<u8> {
        if let Some(urgent) = self.urgent.pop_front() {
            return urgent;
        }
        self.turn += 1;
        match self.turn % 3 {
            1 => ANALOGS.to_be_bytes().to_vec(),
            2 => {
                let position = self.rectifier as u8;
                self.rectifier = (self.rectifier + 1) % RECTIFIERS;
                [&RECTIFIER.to_be_bytes()[..], &[position]].concat()
            }
            _ => {
                let command = self.round.get(self.next).cloned().unwrap_or_default();
                self.next += 1;
                if self.next >= self.round.len() {
                    self.next = 0;
                    self.round = round(&mut self.random);
                }
                command
            }
        }
    }

    /// Takes note of the setting that `answer` tells, to be written when its turn comes.
    fn write_back(&mut self, mut request: Vec<u8>, answer: &[u8]) {
        let ([high, low], [status, values @ ..]) = (&request[..], answer) else { return };
        let settable = command(u16::from_be_bytes([*high, *low])).is_some_and(|c| c.settable);
        if !settable || status & !status::ALARM_BIT != status::OK {
            return;
        }
        self.settings_read += 1;
        // The number of settings is no multiple of this, so all of them have their turn.
        if self.settings_read.is_multiple_of(WRITE_BACK) && values.len() + 2 <= MAX_DATA {
            request[0] |= SET.to_be_bytes()[0];
            request.extend(values);
            self.urgent.push_back(request);
        }
    }

    fn receive(&mut self, answer: &Frame, now: u64) {
        let Some(asked) = self.outstanding.clone() else { return };
        let expected = self.address == 0 || answer.address == self.address;
        let control = answer.control;
        let ours = control.from_slave() && !control.wants_answer() && expected;
        if !ours || control.sequence() != asked.frame.control.sequence() {
            return;
        }
        match (asked.frame.control.link(), control.link()) {
            (link::CONNECT, link::ACKNOWLEDGE) => self.connected = true,
            (link::SINGLE, link::SINGLE) => {
                let alarm = answer.data.first().is_some_and(|s| s & status::ALARM_BIT != 0);
                if alarm && self.urgent.is_empty() {
                    self.urgent.push_back(ALARMS.to_be_bytes().to_vec());
                }
                self.write_back(asked.frame.data.clone(), &answer.data);
                self.sequence ^= Control::SEQUENCE;
            }
            // An error answer: the timeout sends the request again.
            _ => return,
        }
        self.answers += 1;
        let sent = asked.sent;
        self.outstanding = None;
        let pace = self.random.between(200e6, 300e6) as u64;
        self.due = (sent + pace).max(now + 10 * MILLISECOND);
    }
}

/// Every so many settings that were read, one is written back as it is: that the slave keeps them
/// is nothing a supervision relies on.
const WRITE_BACK: u64 = 4;

/// All commands but those that are asked for all the time, in the order of their numbers; the
/// alarm sound is switched on or off and read back in between.
fn round(random: &mut Random) -> Vec<Vec<u8>> {
    let sound = if random.chance(0.5) { 0x14 } else { 0x15 };
    let mut ids: Vec<u16> = commands().map(|command| command.id).collect();
    ids.sort_unstable();
    let mut round: Vec<Vec<u8>> = Vec::new();
    for id in ids.into_iter().filter(|id| *id != ANALOGS && *id != RECTIFIER) {
        if id == 0x028C {
            round.push([&(id | SET).to_be_bytes()[..], &[sound]].concat());
        }
        round.push(id.to_be_bytes().to_vec());
    }
    round
}
