//! The monitor: answers what it is asked, and is silent otherwise.

use std::collections::BTreeMap;
use std::time::Duration;

use super::fault::{FAULTS, Fault, LineFaults, damage};
use super::frame::{Deframer, Escaping, Frame, link};
use super::layout::{Command, command};
use super::plant::{POSITIONS, Plant};
use crate::simulate::random::Random;

/// Status codes of an answer (Zhongheng 09-series RS232 protocol, section 5.2).
pub mod status {
    #![allow(missing_docs, reason = "the names are the document's")]
    pub const OK: u8 = 0;
    pub const FAIL: u8 = 1;
    pub const TOO_LOW: u8 = 2;
    pub const TOO_HIGH: u8 = 3;
    pub const INVALID_DATA: u8 = 4;
    pub const INVALID_DATA_ID: u8 = 5;
    pub const BUSY: u8 = 6;
    /// Set while an alarm has come up that the master has not read yet.
    pub const ALARM_BIT: u8 = 0x80;
}

/// Bit 15 of the CmdID: the request sets instead of reading.
pub const SET: u16 = 0x8000;

/// Every slave on the line is meant (section 3.3).
const EVERYBODY: u16 = 0xFFFF;
/// The last request again, with the same sequence bit and not later than this (ns), is taken for
/// a repetition after a lost answer, and gets the same answer. Masters that never toggle the bit
/// exist (section 6.3); those that ask less often than this get new values.
const REPEATED: u64 = 1_000_000_000;

/// A request that was carried out, and its answer.
#[derive(Clone, Debug)]
struct Done {
    at: u64,
    request: Frame,
    answer: Frame,
}

/// A slave on the line.
#[derive(Clone, Debug)]
pub struct Slave {
    address: u16,
    deframer: Deframer,
    escaping: Escaping,
    plant: Plant,
    time_scale: f64,
    lived: u64,
    /// What was set, by CmdID.
    pub(super) settings: BTreeMap<u16, Vec<u8>>,
    last: Option<Done>,
    faults: LineFaults,
    /// Of the faults; a stream of its own, so that they do not change anything else.
    chance: Random,
    late: bool,
    random: Random,
}

impl Slave {
    /// A slave with `address` (1..=65279) in front of the plant of `seed`, whose time runs
    /// `time_scale` times as fast as real time.
    pub fn new(address: u16, seed: u64, time_scale: f64) -> Self {
        Self {
            address,
            deframer: Deframer::default(),
            escaping: Escaping::Minimal,
            plant: Plant::new(seed),
            time_scale,
            lived: 0,
            settings: BTreeMap::new(),
            last: None,
            faults: LineFaults::none(FAULTS),
            chance: Random::new(seed, 0xFA17),
            late: false,
            random: Random::new(seed, 0x51A),
        }
    }

    /// The same slave, misbehaving.
    #[must_use]
    pub fn with_faults(mut self, faults: LineFaults) -> Self {
        self.faults = faults;
        self
    }

    /// The plant behind it.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Takes `bytes` that arrived at `now` (ns since the beginning) and returns the answers to all
    /// requests they completed.
    pub fn feed(&mut self, bytes: &[u8], now: u64) -> Vec<u8> {
        let passed = now.saturating_sub(self.lived);
        self.lived = self.lived.max(now);
        self.plant.advance(passed as f64 / 1e9 * self.time_scale);
        let mut answers = Vec::new();
        for byte in bytes {
            if let Some(request) = self.deframer.push(*byte) {
                answers.extend(self.answer(&request, now).unwrap_or_default());
            }
        }
        answers
    }

    /// How long it takes to answer: 5 to 30 ms, or longer than any master waits.
    pub fn think_time(&mut self) -> Duration {
        let (from, to) = if std::mem::take(&mut self.late) { (1.0, 2.0) } else { (0.005, 0.030) };
        Duration::from_secs_f64(self.random.between(from, to))
    }

    fn answer(&mut self, request: &Frame, now: u64) -> Option<Vec<u8>> {
        // What another slave says is none of our business; the classes of devices that some
        // broadcasts go to are not documented.
        let to_us = matches!(request.address, 0 | EVERYBODY) || request.address == self.address;
        if !to_us || request.control.from_slave() {
            return None;
        }
        let fault = self.faults.pick(&mut self.chance);
        let data_frame = request.control.link() == link::SINGLE;
        let answer = match fault {
            Some(Fault::LinkError) => self.frame(request, link::ERROR, Vec::new()),
            Some(Fault::Busy) if data_frame => {
                let status = self.status(status::BUSY);
                self.frame(request, link::SINGLE, vec![status])
            }
            _ => self.carry_out(request, now)?,
        };
        // Several slaves may hear a broadcast, so none of them answers it.
        if request.address == EVERYBODY || !request.control.wants_answer() {
            return None;
        }
        self.late |= fault == Some(Fault::Late);
        Some(damage(answer, fault, self.escaping, &mut self.chance))
    }

    /// An answer carries the sequence bit of its request.
    fn frame(&self, request: &Frame, link: u8, data: Vec<u8>) -> Frame {
        Frame { address: self.address, control: request.control.answer(link), data }
    }

    fn carry_out(&mut self, request: &Frame, now: u64) -> Option<Frame> {
        if let Some(done) = &self.last
            && done.request == *request
            && now.saturating_sub(done.at) < REPEATED
        {
            return Some(done.answer.clone());
        }
        let (link, data) = self.respond(request)?;
        let answer = self.frame(request, link, data);
        self.last = (link == link::SINGLE).then(|| Done {
            at: now,
            request: request.clone(),
            answer: answer.clone(),
        });
        Some(answer)
    }

    /// Data link command and data of the answer; `None` where no answer is due.
    fn respond(&mut self, request: &Frame) -> Option<(u8, Vec<u8>)> {
        match request.control.link() {
            link::CONNECT => {
                // Data 1 asks for escaped control characters, 0 for plain ones; the answer names
                // the largest block of data (section 6.3).
                let full = request.data.first() == Some(&1);
                self.escaping = if full { Escaping::Full } else { Escaping::Minimal };
                Some((link::ACKNOWLEDGE, vec![0xFF]))
            }
            link::DISCONNECT => Some((link::ACKNOWLEDGE, Vec::new())),
            // How the address would be given is not documented: acknowledged, but kept.
            link::ADDRESS_ESTABLISH => Some((link::ADDRESS_ACKNOWLEDGE, Vec::new())),
            link::ADDRESS_ACKNOWLEDGE => None,
            link::SINGLE => Some((link::SINGLE, self.serve(&request.data))),
            // Undefined, or defined only for slaves (section 4, link error).
            _ => Some((link::ERROR, Vec::new())),
        }
    }

    /// Status byte and data of the answer to the application request `data`.
    fn serve(&mut self, data: &[u8]) -> Vec<u8> {
        let [high, low, rest @ ..] = data else {
            return vec![self.status(status::INVALID_DATA_ID)];
        };
        let word = u16::from_be_bytes([*high, *low]);
        let Some(command) = command(word & !SET) else {
            return vec![self.status(status::INVALID_DATA_ID)];
        };
        // The document prints the set of 0x00b9 without the CT bit (Z3).
        let forgotten = command.id == 0x00B9 && command.accepts(rest.len());
        if word & SET != 0 || forgotten {
            let code = self.set(command, rest).err().unwrap_or(status::OK);
            return vec![self.status(code)];
        }
        match self.read(command, rest) {
            Ok(values) => {
                if matches!(command.id, 0x414B | 0x40EF) {
                    self.plant.alarms_mut().read();
                }
                let mut answer = vec![self.status(status::OK)];
                answer.extend(values);
                answer
            }
            Err(code) => vec![self.status(code)],
        }
    }

    fn read(&self, command: &Command, arguments: &[u8]) -> Result<Vec<u8>, u8> {
        let position = match (command.id, arguments) {
            (0x40EC, [position]) if usize::from(*position) < POSITIONS => usize::from(*position),
            (0x40EC, [_]) => return Err(status::TOO_HIGH),
            (0x40EC, _) => return Err(status::INVALID_DATA),
            _ => 0,
        };
        let stored = self.settings.get(&command.id).cloned();
        Ok(stored.unwrap_or_else(|| command.fill(&self.plant, position)))
    }

    fn set(&mut self, command: &Command, data: &[u8]) -> Result<(), u8> {
        if !command.settable {
            return Err(status::FAIL);
        }
        if !command.accepts(data.len()) {
            return Err(status::INVALID_DATA);
        }
        if command.id == 0x0064 {
            self.set_float_voltage(command, data)?;
        }
        self.settings.insert(command.id, data.to_vec());
        Ok(())
    }

    /// The float voltage of 0x0064 is obeyed, within the limits that come with it.
    fn set_float_voltage(&mut self, command: &Command, data: &[u8]) -> Result<(), u8> {
        let number = |name| command.number(name, data).filter(|n| n.is_finite());
        let limits = (number("system_min_voltage"), number("system_max_voltage"));
        match (number("float_voltage"), limits) {
            (Some(volts), (Some(least), _)) if volts < least => Err(status::TOO_LOW),
            (Some(volts), (_, Some(most))) if volts > most => Err(status::TOO_HIGH),
            (Some(volts), (Some(_), Some(_))) => {
                self.plant.set_float_voltage(volts);
                Ok(())
            }
            _ => Err(status::INVALID_DATA),
        }
    }

    fn status(&self, code: u8) -> u8 {
        code | if self.plant.alarms().news() { status::ALARM_BIT } else { 0 }
    }
}
