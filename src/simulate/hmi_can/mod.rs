//! The CAN bus of the simulated station: control controller on one side, operator's panel (HMI) on
//! the other, as both would be seen by a third node.
//!
//! Layouts and periods are those of the "HMI CAN protocol" (control controller and HMI controller
//! of a hybrid solar power station); sections are named where they are used. All frames are
//! extended (29 bits, `device << 16 | parameter << 8 | packet`), integers and floats little-endian.
//!
//! | where | what |
//! |---|---|
//! | [`state`] | the station's state as frames (section 4.1) |
//! | [`event`] | what is reported at once (section 4.4) |
//! | [`settings`] | the settings: read out and written (sections 4.3 and 5.4) |
//! | [`modbus`] | MODBUS dialogues cut into frames (section 6) |
//! | [`panel`] | what a person at the HMI does |
//! | [`controller`] | what the control controller does about it |
//! | [`fault`] | frames that are missing or damaged |
//! | [`wire`] | when frames get onto the wire |

pub mod controller;
pub mod event;
pub mod fault;
pub mod modbus;
pub mod onto_can;
pub mod panel;
pub mod settings;
pub mod state;
pub mod wire;

use std::collections::VecDeque;

use super::random::Random;
use super::station::{Orders, Station, generator::Delays};
use crate::frame::{CanFlags, CanFrame};
use controller::Controller;
use fault::{BusFaults, Damage, FAULTS};
use panel::Panel;
use settings::Settings;
use state::Packet;
use wire::{Sender, Wire};

/// Bit rate of the bus, bit/s (HMI CAN protocol, section 2).
pub const BIT_RATE: u32 = 125_000;

/// Devices, as numbered in bits 23..16 of the identifier (HMI CAN protocol, section 3).
pub mod device {
    #![allow(missing_docs, reason = "the names are the document's")]
    pub const PORTS: u8 = 0x01;
    pub const RTC: u8 = 0x02;
    pub const BATMON: u8 = 0x03;
    pub const MPPT: u8 = 0x04;
    pub const PV: u8 = 0x05;
    pub const CHARGER: u8 = 0x06;
    pub const INV1: u8 = 0x07;
    pub const INV2: u8 = 0x08;
    pub const ALT: u8 = 0x09;
    pub const GEN: u8 = 0x0A;
    pub const TRACKER: u8 = 0x0B;
    pub const SPA: u8 = 0x0C;
    pub const VOICE: u8 = 0x0D;
    pub const RESERV: u8 = 0x0F;
    pub const EXTOUT: u8 = 0x10;
    pub const MODBUS_REQ: u8 = 0x11;
    pub const MODBUS_ANS: u8 = 0x12;
    pub const CONFIG: u8 = 0x13;
    pub const LOG: u8 = 0x14;
}

const MILLISECOND: u64 = 1_000_000;
/// Frames of one sender that belong together follow each other so fast, ns.
const PACKET_GAP: u64 = 2 * MILLISECOND;

/// A frame and how long after the reason for it it is sent, ns.
type Delayed = (u64, CanFrame);

/// A frame of the protocol.
pub(crate) fn frame(device: u8, parameter: u8, packet: u8, data: &[u8]) -> CanFrame {
    let id = u32::from(device) << 16 | u32::from(parameter) << 8 | u32::from(packet);
    CanFrame::new(id, CanFlags::EXTENDED, data)
}

/// Which of the two controllers is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The control controller. It answers what [`HmiCan::hear`] is given.
    Controller,
    /// The HMI controller.
    Hmi,
    /// Both; they hear each other.
    Both,
}

/// The station's bus: an endless sequence of frames and the times they end on the wire.
#[derive(Clone, Debug)]
pub struct HmiCan {
    random: Random,
    role: Role,
    time_scale: f64,
    station: Station,
    controller: Controller,
    panel: Panel,
    wire: Wire,
    damage: Damage,
    /// Of the iterator: frames that a fault has added.
    ready: VecDeque<(u64, CanFrame)>,
    /// When each group of state packets is due next, ns.
    due: [u64; state::GROUPS.len()],
    ports: [u8; 5],
    /// The station has lived until here, ns.
    lived: u64,
    seed: u64,
}

impl HmiCan {
    /// The bus of one seed. Station time runs `time_scale` times as fast as real time: with 1440
    /// a day takes a minute. The periods of the frames are not scaled.
    pub fn new(seed: u64, time_scale: f64) -> Self {
        let mut random = Random::new(seed, 0xCA4);
        let controller = Controller::new(seed);
        let station = Station::new(seed, orders(&controller.settings));
        // A controller's tasks start one after the other, not all at once.
        let due = std::array::from_fn(|_| (random.between(5.0, 220.0) * 1e6) as u64);
        let ports = state::ports(&station);
        Self {
            random,
            role: Role::Both,
            time_scale,
            station,
            controller,
            panel: Panel::new(seed),
            wire: Wire::default(),
            damage: Damage::new(seed, BusFaults::none(FAULTS)),
            ready: VecDeque::new(),
            due,
            ports,
            lived: 0,
            seed,
        }
    }

    /// The same bus with only one of its controllers.
    #[must_use]
    pub fn with_role(mut self, role: Role) -> Self {
        self.role = role;
        self
    }

    /// The same bus, on which frames are lost and damaged.
    #[must_use]
    pub fn with_faults(mut self, faults: BusFaults) -> Self {
        self.damage = Damage::new(self.seed, faults);
        self
    }

    /// The simulated station.
    pub fn station(&self) -> &Station {
        &self.station
    }

    /// Somebody else has sent `frame`, whose end was at `now` (ns since the beginning).
    pub fn hear(&mut self, now: u64, frame: &CanFrame) {
        if self.role == Role::Hmi {
            return;
        }
        for (delay, answer) in self.controller.hear(frame, &self.station) {
            self.wire.put(now + delay, Sender::Controller, answer);
        }
        *self.station.orders_mut() = orders(&self.controller.settings);
    }

    /// Lets the station live until `now` and puts on the wire what it reports by itself.
    fn live(&mut self, now: u64) {
        let passed = now.saturating_sub(self.lived);
        self.lived = self.lived.max(now);
        self.station.advance(passed as f64 / 1e9 * self.time_scale);
        for event in self.station.take_events() {
            let at = now + self.jitter();
            self.wire.put(at, Sender::Controller, event::frame(event));
        }
        let ports = state::ports(&self.station);
        if ports != self.ports {
            self.ports = ports;
            let at = now + self.jitter();
            self.wire.put(at, Sender::Controller, frame(device::PORTS, 0, 1, &ports));
        }
    }

    /// The next moment at which anybody wants to send, and which group it is (None: the panel).
    fn next_due(&self) -> (u64, Option<usize>) {
        let groups = self.due.iter().enumerate().map(|(i, due)| (*due, Some(i)));
        let panel = (self.panel.due(), None);
        groups.fold(panel, |soonest, other| if other.0 < soonest.0 { other } else { soonest })
    }

    fn send_group(&mut self, index: usize, now: u64) {
        let group = &state::GROUPS[index];
        let start = now + self.jitter();
        for packet in group.packets {
            let Packet { device, number, encode } = packet;
            let data = encode(&self.station, self.controller.controls);
            self.wire.put(start, Sender::Controller, frame(*device, 0, *number, &data));
        }
        // From the planned time, so that jitter does not add up.
        self.due[index] += group.period_ms * MILLISECOND;
    }

    fn send_action(&mut self, now: u64) {
        for (delay, frame) in self.panel.act(&self.station) {
            self.wire.put(now + delay, Sender::Hmi, frame);
        }
    }

    /// How late a controller's task comes, ns: a few hundred microseconds, seldom more.
    fn jitter(&mut self) -> u64 {
        (self.random.wait(180e3).min(2.5e6)) as u64
    }

    /// The next frame that gets onto the wire.
    fn transmit(&mut self) -> (u64, Sender, CanFrame) {
        loop {
            let (due, group) = self.next_due();
            if let Some(sent) = self.wire.take_before(due) {
                return sent;
            }
            self.live(due);
            match group {
                Some(index) => self.send_group(index, due),
                None => self.send_action(due),
            }
        }
    }

    /// The next thing that happens: when (ns since the beginning, never decreasing), and the
    /// frames that are seen then. There are none when a controller that is not played would have
    /// sent, or when a fault swallows the frame, and several when a fault adds some.
    pub fn step(&mut self) -> (u64, Vec<CanFrame>) {
        let (time, sender, frame) = self.transmit();
        let played = match sender {
            Sender::Controller => self.role != Role::Hmi,
            Sender::Hmi => self.role != Role::Controller,
        };
        if !played {
            return (time, Vec::new());
        }
        let sent = self.damage.apply(frame);
        if sender == Sender::Hmi {
            for frame in &sent {
                self.hear(time, frame);
            }
        }
        (time, sent)
    }
}

impl Iterator for HmiCan {
    /// Nanoseconds since the beginning, never decreasing, and the frame. `None` only when nothing
    /// has been sent for very long, because faults swallow everything.
    type Item = (u64, CanFrame);

    fn next(&mut self) -> Option<Self::Item> {
        for _ in 0..1_000_000 {
            if let Some(sent) = self.ready.pop_front() {
                return Some(sent);
            }
            let (time, frames) = self.step();
            self.ready.extend(frames.into_iter().map(|frame| (time, frame)));
        }
        None
    }
}

fn orders(settings: &Settings) -> Orders {
    let generator = Delays {
        start: settings.number(0x13),
        stop: settings.number(0x14),
        run: settings.number(0x19),
        sleep: settings.number(0x1A),
        attempts: settings.number(0x17) as u8,
    };
    Orders { inverter_delays: (settings.number(0x27), settings.number(0x28)), generator }
}

#[cfg(test)]
mod coverage_tests;
#[cfg(test)]
mod encoding_tests;
#[cfg(test)]
mod tests;
