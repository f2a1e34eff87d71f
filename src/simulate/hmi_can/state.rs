//! The station's state as frames, controller to HMI (HMI CAN protocol, section 4.1).
//!
//! Structures are packed, bit fields from the least significant bit, numbers little-endian.

use super::controller::Controls;
use super::device;
use crate::simulate::station::generator::Stage;
use crate::simulate::station::inverter::Inverter;
use crate::simulate::station::solar::Mode;
use crate::simulate::station::transfer::Supply;
use crate::simulate::station::{Station, generator::Generator};

/// Packets that a task of the controller sends together.
pub struct Group {
    /// Every so many milliseconds (HMI CAN protocol, question 22; where it knows no period, a
    /// likely one).
    pub period_ms: u64,
    /// In the order they are sent.
    pub packets: &'static [Packet],
}

/// One packet: its identifier and how its data are made, given the station and what a person has
/// commanded.
pub struct Packet {
    /// ID_DEV.
    pub device: u8,
    /// SUB_PACK_ID.
    pub number: u8,
    /// The data, 1 to 8 bytes.
    pub encode: fn(&Station, Controls) -> Vec<u8>,
}

const fn packet(device: u8, number: u8, encode: fn(&Station, Controls) -> Vec<u8>) -> Packet {
    Packet { device, number, encode }
}

/// All state packets.
#[rustfmt::skip]
pub const GROUPS: [Group; 11] = [
    Group { period_ms: 1000, packets: &[packet(device::PORTS, 1, |s, _| ports(s).to_vec())] },
    Group { period_ms: 1000, packets: &[packet(device::RTC, 1, |s, _| clock(s))] },
    // The battery monitor sends two blocks of text a second.
    Group { period_ms: 500, packets: &[
        packet(device::BATMON, 1, |s, _| battery_flags(s)),
        packet(device::BATMON, 2, |s, _| pair(s.monitor().voltage(), s.monitor().current())),
        packet(device::BATMON, 3, |s, _| pair(consumed(s), s.monitor().soc(s.battery()))),
        packet(device::BATMON, 4, |s, _| pair(s.monitor().history.deepest, s.monitor().history.last)),
        packet(device::BATMON, 5, |s, _| pair(s.monitor().history.average, s.monitor().history.drawn)),
        packet(device::BATMON, 6, |s, _| pair(s.monitor().history.lowest, s.monitor().history.highest)),
        packet(device::BATMON, 7, |s, _| battery_days(s)),
    ] },
    Group { period_ms: 500, packets: &[
        packet(device::MPPT, 1, charge_controller),
        packet(device::MPPT, 2, |s, _| pair(s.solar().voltage(), s.solar().panel_current())),
        packet(device::MPPT, 3, |s, _| pair(s.solar().out_voltage(), s.solar().current())),
        packet(device::MPPT, 4, |s, _| float(s.battery().current()).to_vec()),
        packet(device::MPPT, 5, |s, _| solar_energy(s)),
        packet(device::MPPT, 6, |s, _| pair(s.battery().temperature(), s.solar().temperature())),
    ] },
    Group { period_ms: 1000, packets: &[packet(device::CHARGER, 1, |s, _| charger(s))] },
    // "At least once in about a second": both are asked in turn all the time.
    Group { period_ms: 250, packets: &[
        packet(device::INV1, 1, |s, _| inverter(&s.inverters()[0])),
        packet(device::INV1, 2, |s, _| inverter_values(s, &s.inverters()[0])),
    ] },
    Group { period_ms: 250, packets: &[
        packet(device::INV2, 1, |s, _| inverter(&s.inverters()[1])),
        packet(device::INV2, 2, |s, _| inverter_values(s, &s.inverters()[1])),
    ] },
    Group { period_ms: 500, packets: &[
        packet(device::ALT, 1, |s, _| transfer(s)),
        packet(device::GEN, 1, |s, _| generator(s.generator())),
        packet(device::GEN, 2, |s, _| generator_timers(s.generator())),
    ] },
    Group { period_ms: 500, packets: &[
        packet(device::TRACKER, 1, |s, _| tracker(s)),
        packet(device::TRACKER, 2, |s, _| tracker_position(s)),
    ] },
    Group { period_ms: 3000, packets: &[
        packet(device::SPA, 1, |s, _| pair(s.day().sunrise, s.day().sunset)),
        packet(device::SPA, 2, |s, _| pair(90.0 - s.sun().elevation, s.sun().azimuth)),
        packet(device::SPA, 3, |s, _| [&float(s.day().duration())[..], &[0]].concat()),
    ] },
    Group { period_ms: 1000, packets: &[packet(device::VOICE, 1, |_, c| vec![1, 0x12, 0, c.volume])] },
];

/// PORTS_1: battery, supply and mode flags, then 32 discrete inputs.
pub fn ports(station: &Station) -> [u8; 5] {
    let [small, large] = station.inverters();
    let supply = station.transfer().supply();
    let generator = station.generator().running();
    let tracker = station.tracker();
    let loaded = |inverter: &Inverter| inverter.watts() > 10.0;
    let inputs = [
        (31, station.monitor().alarm()),
        (30, station.charger().ended()),
        (29, station.charger().powered()),
        (28, station.solar().connected()),
        (26, true),
        (25, generator),
        (24, generator),
        (23, supply == Supply::Mains),
        (22, true),
        (18, true),
        (15, tracker.moving),
        (13, true),
        (12, true),
        (11, tracker.moving),
        (10, large.contactor()),
        (9, small.contactor()),
        (4, loaded(small)),
        (3, loaded(large)),
        (2, true),
        (1, station.solar().connected()),
        (0, supply == Supply::Generator),
    ];
    let state = inputs.iter().fold(0, |word, (bit, on)| word | u32::from(*on) << bit);
    let [a, b, c, d] = state.to_le_bytes();
    // 24 V supply, battery connected, 12 V supply; both mode inputs open.
    [0b0_0111, a, b, c, d]
}

/// RTC_1, and RTC_0 in the other direction.
pub fn clock(station: &Station) -> Vec<u8> {
    let now = station.date_time();
    let weekday = now.weekday().to_sunday_zero_offset();
    let time = [weekday, now.hour(), now.minute(), now.second()].map(i8::unsigned_abs);
    [date(station), time].concat()
}

/// Day, month, year low byte first (section 2).
pub fn date(station: &Station) -> [u8; 4] {
    let now = station.date_time();
    let [year_low, year_high] = now.year().to_le_bytes();
    [now.day().unsigned_abs(), now.month().unsigned_abs(), year_low, year_high]
}

fn battery_flags(station: &Station) -> Vec<u8> {
    let (monitor, battery) = (station.monitor(), station.battery());
    let alarm = monitor.alarm();
    // Reason bit 0: low voltage.
    let flags = bit(0, true) | bit(1, alarm) | bit(2, alarm) | bit(3, alarm);
    let history = monitor.history;
    let words = [whole(monitor.minutes_to_go(battery)), history.cycles, history.full_discharges];
    [&[flags][..], &words.map(u16::to_le_bytes).concat()].concat()
}

/// Ah taken out, negative; as shown, to 0.1 Ah.
fn consumed(station: &Station) -> f64 {
    let battery = station.battery();
    ((battery.soc() - 1.0) * battery.capacity() * 10.0).round() / 10.0
}

fn battery_days(station: &Station) -> Vec<u8> {
    let history = station.monitor().history;
    [whole((history.since_full / 86_400.0).floor()), history.low_alarms]
        .map(u16::to_le_bytes)
        .concat()
}

fn charge_controller(station: &Station, controls: Controls) -> Vec<u8> {
    let solar = station.solar();
    let on = solar.connected();
    let flags =
        bit(0, true) | bit(1, true) | bit(2, true) | bit(3, on) | bit(4, controls.pv_mode != 0);
    let (charging, floating) = solar.seconds();
    let soc = byte(station.battery().soc() * 100.0);
    let minutes = [floating, charging].map(|s| whole((s / 60.0).floor()).to_le_bytes()).concat();
    [&[flags, solar.mode() as u8, soc][..], &minutes].concat()
}

fn solar_energy(station: &Station) -> Vec<u8> {
    let (watt_hours, ampere_hours) = station.solar().today();
    [watt_hours, ampere_hours].map(|x| (x as u32).to_le_bytes()).concat()
}

fn charger(station: &Station) -> Vec<u8> {
    let charger = station.charger();
    // Mode 2 of the field stands for the charger's Mode-3 (three stages).
    let mode = if charger.on() { 2 << 3 } else { 0 };
    let flags = bit(0, charger.powered()) | bit(1, true) | bit(2, charger.ended()) | mode;
    [&[flags][..], &float(charger.current()), &[0]].concat()
}

fn inverter(inverter: &Inverter) -> Vec<u8> {
    let (watts, percent) = inverter.reading();
    let flags =
        bit(0, inverter.contactor()) | (inverter.mode() as u8) << 1 | inverter.cycle_step() << 4;
    // Overload is reported from 100 % on.
    let error = if percent > 115.0 { 5 } else { 4 * u8::from(percent > 100.0) };
    let words = [inverter.ac_voltage(), watts].map(|x| whole(x).to_le_bytes()).concat();
    [&[flags, 0, error][..], &words, &[byte(percent)]].concat()
}

fn inverter_values(station: &Station, inverter: &Inverter) -> Vec<u8> {
    // A few millivolts per ampere are lost in cables and contactor.
    let volts = station.battery().voltage();
    let input =
        if inverter.contactor() { volts - 0.0015 * inverter.dc_power() / volts } else { 0.0 };
    pair((input * 10.0).round() / 10.0, inverter.temperature())
}

fn transfer(station: &Station) -> Vec<u8> {
    let transfer = station.transfer();
    let flags = bit(0, true)
        | bit(1, station.mains().present())
        | bit(2, station.generator().running())
        | (transfer.supply() as u8) << 3;
    [&[flags][..], &whole(transfer.seconds_left()).to_le_bytes()].concat()
}

/// GEN_1. `mode` and `stat` share byte 1, `cycle1` and `cycle2` byte 2; `auto_mode` stays 0, as
/// with the real sender.
fn generator(generator: &Generator) -> Vec<u8> {
    const NOT_COUNTING: u16 = 65_535;
    let failed = generator.start_failed();
    let (mode, status, attempt, run, left) = match generator.stage() {
        Stage::Off | Stage::Waiting(_) => (4, 0, 0, NOT_COUNTING, 0),
        Stage::Starting(attempt, _) => (1, 10, attempt, NOT_COUNTING, 0),
        Stage::Running(run, left) => (2, 0, 0, whole(run), whole(left)),
        Stage::Stopping(run, left) => (2, 0, 0, whole(run), whole(left)),
        Stage::Resting(_) => (3, if failed { 13 } else { 11 }, 0, NOT_COUNTING, 0),
    };
    let error = if failed { 7 } else { 0 };
    let head = [bit(0, true) | bit(1, true), mode | status << 4, attempt & 0xF | 3 << 4, error];
    [&head[..], &run.to_le_bytes(), &left.to_le_bytes()].concat()
}

fn generator_timers(generator: &Generator) -> Vec<u8> {
    let (lost, restored, rest) = match generator.stage() {
        Stage::Waiting(left) => (left, 0.0, 0.0),
        Stage::Stopping(_, left) => (0.0, left, 0.0),
        Stage::Resting(left) => (0.0, 0.0, left),
        _ => (0.0, 0.0, 0.0),
    };
    [lost, restored, rest].map(|x| whole(x).to_le_bytes()).concat()
}

fn tracker(station: &Station) -> Vec<u8> {
    let tracker = station.tracker();
    let flags = bit(0, true) | bit(1, true) | bit(2, tracker.moving);
    // The bits of the status are not public: command mode, 24 V there, night position.
    let night = station.solar().mode() == Mode::Off;
    let status = 0x0005_u16 | u16::from(night) << 8;
    [&[flags][..], &status.to_le_bytes(), &whole(tracker.worked % 65_536.0).to_le_bytes()].concat()
}

fn tracker_position(station: &Station) -> Vec<u8> {
    /// Pulses of the position sensor per millimetre.
    const PULSES: f64 = 3.2;
    let tracker = station.tracker();
    let (vertical, horizontal) = tracker.saved;
    [tracker.vertical, tracker.horizontal, vertical * PULSES, horizontal * PULSES]
        .map(|x| whole(x).to_le_bytes())
        .concat()
}

fn bit(number: u8, on: bool) -> u8 {
    u8::from(on) << number
}

/// f32, little-endian.
fn float(value: f64) -> [u8; 4] {
    (value as f32).to_le_bytes()
}

fn pair(first: f64, second: f64) -> Vec<u8> {
    [float(first), float(second)].concat()
}

/// The nearest u16; `as` keeps within the range.
fn whole(value: f64) -> u16 {
    value.round() as u16
}

/// The nearest u8.
fn byte(value: f64) -> u8 {
    value.round() as u8
}
