//! The person at the HMI: opens the settings, changes one, lets the voice speak, asks a device
//! over MODBUS; and the controller's answers to it.

use super::modbus::{Dialogue, inverter_registers};
use super::settings::{self, Settings};
use super::{MILLISECOND, device, frame, state};
use crate::frame::CanFrame;
use crate::simulate::random::Random;
use crate::simulate::station::Station;

/// Mean pause between two actions, s.
const PAUSE: f64 = 2.2;

/// A frame and how long after the beginning of the action it is sent, ns.
type Delayed = (u64, CanFrame);

/// The HMI and who stands in front of it.
#[derive(Clone, Debug)]
pub struct Panel {
    random: Random,
    due: u64,
    actions: u32,
}

impl Panel {
    /// A panel that was just switched on.
    pub fn new(seed: u64) -> Self {
        Self { random: Random::new(seed, 0x4A41), due: 700 * MILLISECOND, actions: 0 }
    }

    /// When the next action begins, ns.
    pub fn due(&self) -> u64 {
        self.due
    }

    /// The frames of the next action and of the controller's answer.
    pub fn act(
        &mut self,
        station: &Station,
        settings: &mut Settings,
        volume: &mut u8,
    ) -> Vec<Delayed> {
        self.actions += 1;
        self.due += ((0.4 + self.random.wait(PAUSE)) * 1e9) as u64;
        match (self.actions, self.random.index(16)) {
            // After power-up the HMI reads all settings, then the clock is set.
            (1, _) => self.read_settings(settings),
            (2, _) => vec![(0, frame(device::RTC, 0, 0, &state::clock(station)))],
            (_, 0..=1) => self.read_settings(settings),
            (_, 2) => self.change_delay(settings),
            (_, 3) => self.change_file(settings),
            (_, 4..=5) => self.speak(volume),
            (_, 6) => self.move_tracker(station),
            (_, 7) => vec![(0, frame(device::CHARGER, 0, 0, &[2]))],
            (_, 8..=9) => self.write_registers(),
            _ => self.read_registers(station),
        }
    }

    fn read_settings(&mut self, settings: &Settings) -> Vec<Delayed> {
        let first = self.milliseconds(3.0, 9.0);
        let answer = settings.read_out().into_iter();
        let spaced =
            answer.enumerate().map(|(i, frame)| (first + i as u64 * 2 * MILLISECOND, frame));
        std::iter::once((0, settings::request())).chain(spaced).collect()
    }

    /// Another delay for switching the inverters on, kept in the EEPROM a second later.
    fn change_delay(&mut self, settings: &mut Settings) -> Vec<Delayed> {
        settings.delay_start_ts = [20, 30, 45, 60][self.random.index(4)];
        let value = settings.delay_start_ts.to_le_bytes();
        vec![(0, settings::set(0x27, &value)), (self.milliseconds(600.0, 900.0), settings::save())]
    }

    fn change_file(&mut self, settings: &mut Settings) -> Vec<Delayed> {
        let parameter = self.random.index(3) as u8;
        let name = ["spring_job.txt", "summer_job.txt", "station.scr"][self.random.index(3)];
        let files = [&mut settings.scr_file, &mut settings.job_file, &mut settings.job_test];
        for (index, file) in files.into_iter().enumerate() {
            if index == usize::from(parameter) {
                *file = name.to_string();
            }
        }
        let [first, second] = settings::set_text(parameter, name);
        vec![(0, first), (2 * MILLISECOND, second)]
    }

    /// Bits of the first byte: 0 speak, 1 volume, 2 sound.
    fn speak(&mut self, volume: &mut u8) -> Vec<Delayed> {
        *volume = 4 + self.random.index(5) as u8;
        let message = 1 + self.random.index(26) as u8;
        vec![(0, frame(device::VOICE, 0, 0, &[0b011, message, *volume, 0]))]
    }

    /// A position in millimetres for one actuator: close to where it is.
    fn move_tracker(&mut self, station: &Station) -> Vec<Delayed> {
        let vertical = self.random.chance(0.5);
        let tracker = station.tracker();
        let position = if vertical { tracker.vertical } else { tracker.horizontal };
        let value = (position.round() as f32).to_le_bytes();
        let head = [1, 1, u8::from(!vertical), 0];
        let command = frame(device::TRACKER, 0, 0, &[&head[..], &value].concat());
        // The controller reports the command as carried out with message 0.
        let done = frame(device::LOG, device::TRACKER, 0, &[0]);
        vec![(0, command), (self.milliseconds(8.0, 15.0), done)]
    }

    fn read_registers(&mut self, station: &Station) -> Vec<Delayed> {
        let address = 1 + self.random.index(2) as u8;
        let count = 3 + self.random.index(10) as u16;
        let dialogue = Dialogue { address, function: 3, register: 0, count };
        // Now and then a device does not answer in time.
        if self.random.chance(0.06) {
            let answer = dialogue.answer(11, &[]);
            return self.exchange(dialogue.request(&[]), answer, 600.0);
        }
        let answer = dialogue.answer(0, &inverter_registers(station, address, count));
        self.exchange(dialogue.request(&[]), answer, 45.0)
    }

    fn write_registers(&mut self) -> Vec<Delayed> {
        let count = 2 + self.random.index(6) as u16;
        let dialogue = Dialogue { address: 3, function: 16, register: 0x20, count };
        let data: Vec<u16> = (0..count).map(|i| 300 + 10 * i).collect();
        let answer = dialogue.answer(0, &dialogue.confirmation());
        self.exchange(dialogue.request(&data), answer, 60.0)
    }

    /// A request, and its answer after about `wait` ms.
    fn exchange(&mut self, ask: Vec<CanFrame>, answer: Vec<CanFrame>, wait: f64) -> Vec<Delayed> {
        let spaced = |from: u64, frames: Vec<CanFrame>| {
            (0..).zip(frames).map(move |(i, frame)| (from + i * 2 * MILLISECOND, frame))
        };
        let pause = self.milliseconds(0.8 * wait, 1.3 * wait);
        let answered = ask.len() as u64 * 2 * MILLISECOND + pause;
        spaced(0, ask).chain(spaced(answered, answer)).collect()
    }

    fn milliseconds(&mut self, from: f64, to: f64) -> u64 {
        (self.random.between(from, to) * 1e6) as u64
    }
}
