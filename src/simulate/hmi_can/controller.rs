//! The control controller: what it does with the frames of the HMI, and what it answers.

use std::collections::BTreeMap;

use super::modbus::{Assembly, Dialogue, MOST_REGISTERS, inverter_registers, result};
use super::panel::spaced;
use super::settings::Settings;
use super::{Delayed, device, frame};
use crate::frame::{CanFlags, CanFrame};
use crate::simulate::random::Random;
use crate::simulate::station::Station;
use crate::simulate::station::transfer::Supply;

/// What a person has set with commands, as far as it shows in the state.
#[derive(Clone, Copy, Debug)]
pub struct Controls {
    /// Volume of the voice, 0 to 9.
    pub volume: u8,
    /// The panels: 0 parallel, 1 parallel and in series.
    pub pv_mode: u8,
}

impl Default for Controls {
    fn default() -> Self {
        Self { volume: 6, pv_mode: 1 }
    }
}

/// The controller.
#[derive(Clone, Debug)]
pub struct Controller {
    random: Random,
    /// What is set.
    pub settings: Settings,
    /// What was commanded.
    pub controls: Controls,
    request: Assembly,
    /// Registers that were written, by device and number.
    registers: BTreeMap<(u8, u16), u16>,
}

impl Controller {
    /// A controller as it left the factory.
    pub fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, 0xC7C7),
            settings: Settings::default(),
            controls: Controls::default(),
            request: Assembly::default(),
            registers: BTreeMap::new(),
        }
    }

    /// Takes a frame of the HMI; what is answered, and how long after it (ns). Frames that say
    /// nothing to a controller change nothing.
    pub fn hear(&mut self, sent: &CanFrame, station: &Station) -> Vec<Delayed> {
        let [packet, parameter, device, upper] = sent.id.to_le_bytes();
        let meant = sent.flags.has(CanFlags::EXTENDED) && upper == 0;
        let odd = sent.flags.has(CanFlags::ERROR) || sent.flags.has(CanFlags::FD);
        if !meant || odd {
            return Vec::new();
        }
        if sent.flags.has(CanFlags::REMOTE) {
            // Any remote frame of this device asks for the settings (question 23).
            let asked = device == device::CONFIG;
            return if asked { self.read_out() } else { Vec::new() };
        }
        match (device, packet) {
            (device::CONFIG, 0 | 1) => {
                self.settings.store(parameter, packet, sent.data());
                Vec::new()
            }
            (device::MODBUS_REQ, _) => match self.request.push(packet, sent.data()) {
                Some((dialogue, data)) => self.serve(&dialogue, &data, station),
                None => Vec::new(),
            },
            (_, 0) => self.obey(device, sent.data(), station),
            _ => Vec::new(),
        }
    }

    fn read_out(&mut self) -> Vec<Delayed> {
        self.after(3.0, 9.0, self.settings.read_out())
    }

    /// Reports what a command has come to. The station decides for itself, so a command is carried
    /// out when it is what the station does already, and else refused.
    fn obey(&mut self, device: u8, data: &[u8], station: &Station) -> Vec<Delayed> {
        let [first, ..] = data else { return Vec::new() };
        let event = match (device, data) {
            (device::PV, [ctrl, _, mode]) if ctrl & 0b10 != 0 => {
                self.controls.pv_mode = mode & 1;
                if mode & 1 == 0 { 11 } else { 12 }
            }
            (device::PV, _) if station.solar().connected() => 9,
            (device::PV, _) => 10,
            (device::CHARGER, _) if station.charger().powered() => 19,
            (device::CHARGER, _) => 20,
            (device::INV1 | device::INV2, _) => {
                let large = u8::from(device == device::INV2);
                let on = station.inverters()[usize::from(large)].contactor();
                match (on, *first != 0) {
                    (true, true) => 34 + 2 * large,
                    (false, false) => 35 + 2 * large,
                    // Load present on the inverter.
                    (true, false) => 50,
                    // Contactor control off, check inverter.
                    (false, true) => 40,
                }
            }
            (device::ALT, _) if station.transfer().supply() == Supply::Mains => 0,
            (device::ALT, _) => 1,
            // A tracker command was executed.
            (device::TRACKER, _) => 0,
            (device::GEN, _) => return self.after(8.0, 15.0, vec![log(device, &[])]),
            (device::VOICE, [ctrl, _, volume, _]) if ctrl & 0b10 != 0 => {
                self.controls.volume = (*volume).min(9);
                return Vec::new();
            }
            _ => return Vec::new(),
        };
        self.after(8.0, 15.0, vec![log(device, &[event])])
    }

    fn serve(&mut self, asked: &Dialogue, data: &[u16], station: &Station) -> Vec<Delayed> {
        let whole = usize::from(asked.count) == data.len();
        let answer = match (asked.function, asked.address) {
            (3 | 4 | 6 | 16, 1..=3) if asked.count == 0 || asked.count > MOST_REGISTERS => {
                Err(result::VALUE)
            }
            (3 | 4, 1..=2) => Ok(inverter_registers(station, asked.address, asked.count)),
            (3 | 4, 3) => Ok(self.stored(asked)),
            (6 | 16, 1..=3) if whole => {
                for (register, value) in (asked.register..=u16::MAX).zip(data) {
                    self.registers.insert((asked.address, register), *value);
                }
                Ok(asked.confirmation().to_vec())
            }
            (6 | 16, 1..=3) => Err(result::PARAMETERS),
            (_, 1..=3) => Err(result::FUNCTION),
            _ => Err(result::TIMEOUT),
        };
        match answer {
            Ok(data) => self.after(36.0, 78.0, asked.answer(0, &data)),
            Err(code @ result::TIMEOUT) => self.after(480.0, 780.0, asked.answer(code, &[])),
            Err(code) => self.after(36.0, 78.0, asked.answer(code, &[])),
        }
    }

    /// What was written, and what such a device would have in the other registers.
    fn stored(&self, asked: &Dialogue) -> Vec<u16> {
        let registers = (0..asked.count).map(|i| asked.register.wrapping_add(i));
        let value = |register| self.registers.get(&(asked.address, register)).copied();
        registers.map(|r| value(r).unwrap_or(1000 + r % 16)).collect()
    }

    /// Frames after a time between `from` and `to` ms.
    fn after(&mut self, from: f64, to: f64, frames: Vec<CanFrame>) -> Vec<Delayed> {
        let first = (self.random.between(from, to) * 1e6) as u64;
        spaced(frames).into_iter().map(|(delay, frame)| (first + delay, frame)).collect()
    }
}

/// An event of `device` (section 4.4).
fn log(device: u8, data: &[u8]) -> CanFrame {
    frame(device::LOG, device, 0, data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::hmi_can::{orders, settings};

    fn station() -> Station {
        let mut station = Station::new(1, orders(&Settings::default()));
        station.advance(6.0 * 3600.0);
        station
    }

    fn answers(controller: &mut Controller, frames: &[CanFrame]) -> Vec<CanFrame> {
        let station = station();
        let heard = frames.iter().flat_map(|sent| controller.hear(sent, &station));
        heard.map(|(_, frame)| frame).collect()
    }

    #[test]
    fn a_setting_is_read_back_after_the_remote_request() {
        let mut controller = Controller::new(1);
        let set = frame(device::CONFIG, 0x26, 0, &[7]);
        assert_eq!(answers(&mut controller, &[set, settings::save()]), []);
        let read = answers(&mut controller, &[settings::request()]);
        assert_eq!((read.len(), read[6].data()[2]), (15, 7));
    }

    #[test]
    fn registers_that_were_written_are_read_back() {
        let mut controller = Controller::new(1);
        let data: Vec<u16> = (0..MOST_REGISTERS).map(|i| 7 * i).collect();
        let count = MOST_REGISTERS;
        let write = Dialogue { address: 3, function: 16, register: 0x20, count };
        assert_eq!(write.request(&data).len(), 32);
        let done = answers(&mut controller, &write.request(&data));
        assert_eq!(done, write.answer(0, &[0x20, count]));
        let read = Dialogue { function: 3, ..write };
        assert_eq!(answers(&mut controller, &read.request(&[])), read.answer(0, &data));
    }

    #[test]
    fn modbus_that_cannot_be_done_gets_its_code() {
        let one = Dialogue { address: 3, function: 16, register: 0, count: 2 };
        for (dialogue, data, code) in [
            (Dialogue { address: 9, ..one.clone() }, &[1, 2][..], 11),
            (Dialogue { function: 5, ..one.clone() }, &[1, 2], 1),
            (Dialogue { function: 77, ..one.clone() }, &[1, 2], 1),
            (Dialogue { count: 0, ..one.clone() }, &[], 3),
            (one.clone(), &[1], 9),
        ] {
            let answer = answers(&mut Controller::new(1), &dialogue.request(data));
            assert_eq!(answer, dialogue.answer(code, &[]), "{dialogue:?}");
        }
        // The packets of a request are 0, 1, 2: a missing one makes it worth nothing.
        let mut torn = one.request(&[1, 2]);
        torn.remove(0);
        assert_eq!(answers(&mut Controller::new(1), &torn), []);
    }

    #[test]
    fn commands_are_reported_and_frames_of_others_are_not_heard() {
        let mut controller = Controller::new(1);
        let tracker = frame(device::TRACKER, 0, 0, &[1, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(answers(&mut controller, &[tracker]), [frame(0x14, 0x0B, 0, &[0])]);
        answers(&mut controller, &[frame(device::VOICE, 0, 0, &[0b10, 0, 9, 0])]);
        assert_eq!(controller.controls.volume, 9);
        let small = CanFrame::new(0x123, CanFlags::default(), &[1]);
        let above = CanFrame::new(0x1F0B_0000, CanFlags::EXTENDED, &[1]);
        let state = frame(device::TRACKER, 0, 1, &[0; 5]);
        assert_eq!(answers(&mut controller, &[small, above, state]), []);
    }
}
