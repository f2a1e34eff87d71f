//! The person at the HMI: opens the settings, changes one, gives a command, lets the voice speak,
//! asks a device over MODBUS.

use super::modbus::{Dialogue, MOST_REGISTERS};
use super::settings::{self, Settings};
use super::{Delayed, MILLISECOND, PACKET_GAP, device, frame, state};
use crate::frame::CanFrame;
use crate::simulate::random::Random;
use crate::simulate::station::Station;

/// Mean pause between two actions, s.
const PAUSE: f64 = 2.2;
/// So many kinds of commands there are beside settings and MODBUS.
const COMMANDS: u32 = 10;
/// Every so many MODBUS dialogues move as many registers as fit.
const LONG: u32 = 10;

/// The HMI and who stands in front of it.
#[derive(Clone, Debug)]
pub struct Panel {
    random: Random,
    due: u64,
    actions: u32,
    /// What comes next of each kind: all of them have their turn.
    setting: u8,
    command: u32,
    dialogues: u32,
    settings: Settings,
}

impl Panel {
    /// A panel that was just switched on.
    pub fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, 0x4A41),
            due: 700 * MILLISECOND,
            actions: 0,
            setting: 0,
            command: 0,
            dialogues: 0,
            settings: Settings::default(),
        }
    }

    /// When the next action begins, ns.
    pub fn due(&self) -> u64 {
        self.due
    }

    /// The frames of the next action.
    pub fn act(&mut self, station: &Station) -> Vec<Delayed> {
        self.actions += 1;
        self.due += ((0.4 + self.random.wait(PAUSE)) * 1e9) as u64;
        match (self.actions, self.random.index(16)) {
            // After power-up the HMI reads all settings, then the clock is set.
            (1, _) | (_, 0) => vec![(0, settings::request())],
            (2, _) => vec![(0, frame(device::RTC, 0, 0, &state::clock(station)))],
            (_, 1..=4) => self.change_setting(station),
            (_, 5..=8) => self.give_command(station),
            (_, 9..=10) => self.write_registers(),
            _ => self.read_registers(),
        }
    }

    /// The next setting, and now and then the order to keep it in the EEPROM a second later.
    fn change_setting(&mut self, station: &Station) -> Vec<Delayed> {
        let parameter = self.setting;
        self.setting = (self.setting + 1) % settings::COUNT;
        let today = state::date(station);
        let mut sent = spaced(self.settings.change(parameter, today, &mut self.random));
        if self.random.chance(0.4) {
            sent.push(((self.random.between(600.0, 900.0) * 1e6) as u64, settings::save()));
        }
        sent
    }

    /// Orders what is so already, since the station decides by itself.
    fn give_command(&mut self, station: &Station) -> Vec<Delayed> {
        self.command = (self.command + 1) % COMMANDS;
        let on = |index: usize| u8::from(station.inverters()[index].contactor());
        let (device, data) = match self.command {
            0 => return vec![(0, frame(device::RTC, 0, 0, &state::clock(station)))],
            1 => (device::CHARGER, vec![2]),
            // Which of the two fields is meant, then connect, or parallel and in series.
            2 => (device::PV, vec![0b10, 1, self.random.index(2) as u8]),
            3 => (device::INV1, vec![on(0)]),
            4 => (device::INV2, vec![on(1)]),
            5 => (device::ALT, vec![u8::from(station.mains().present())]),
            // A test of the generator.
            6 => (device::GEN, vec![2]),
            7 => (device::RESERV, vec![self.random.index(4) as u8, self.random.index(2) as u8]),
            8 => (device::EXTOUT, vec![self.random.index(4) as u8, self.random.index(2) as u8]),
            _ if self.random.chance(0.5) => return self.move_tracker(station),
            _ => return self.speak(),
        };
        vec![(0, frame(device, 0, 0, &data))]
    }

    /// Bits of the first byte: 0 speak, 1 volume, 2 sound.
    fn speak(&mut self) -> Vec<Delayed> {
        let volume = 4 + self.random.index(5) as u8;
        let (message, sound) = (1 + self.random.index(26), 1 + self.random.index(14));
        let data = [0b011, message as u8, volume, sound as u8];
        vec![(0, frame(device::VOICE, 0, 0, &data))]
    }

    /// A position in millimetres for one actuator: close to where it is.
    fn move_tracker(&mut self, station: &Station) -> Vec<Delayed> {
        let vertical = self.random.chance(0.5);
        let tracker = station.tracker();
        let position = if vertical { tracker.vertical } else { tracker.horizontal };
        let value = (position.round() as f32).to_le_bytes();
        let head = [1, 1, u8::from(!vertical), 0];
        vec![(0, frame(device::TRACKER, 0, 0, &[&head[..], &value].concat()))]
    }

    fn read_registers(&mut self) -> Vec<Delayed> {
        // Now and then a device that does not answer in time.
        let address = if self.random.chance(0.06) { 9 } else { 1 + self.random.index(3) as u8 };
        let few = 3 + self.random.index(10) as u16;
        let count = self.registers(few);
        let function = if self.random.chance(0.7) { 3 } else { 4 };
        let dialogue = Dialogue { address, function, register: 0, count };
        spaced(dialogue.request(&[]))
    }

    fn write_registers(&mut self) -> Vec<Delayed> {
        let few = 2 + self.random.index(6) as u16;
        let count = self.registers(few);
        let dialogue = Dialogue { address: 3, function: 16, register: 0x20, count };
        let data: Vec<u16> = (0..count).map(|i| 300 + 10 * i).collect();
        spaced(dialogue.request(&data))
    }

    /// `few` registers, and now and then as many as there can be.
    fn registers(&mut self, few: u16) -> u16 {
        self.dialogues += 1;
        if self.dialogues.is_multiple_of(LONG) { MOST_REGISTERS } else { few }
    }
}

/// Frames one behind the other.
pub(super) fn spaced(frames: Vec<CanFrame>) -> Vec<Delayed> {
    (0..).zip(frames).map(|(i, frame)| (i * PACKET_GAP, frame)).collect()
}
