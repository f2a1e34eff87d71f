//! What any life of the station has to keep to.

use super::*;

fn orders() -> Orders {
    let generator = Delays { start: 60, stop: 120, run: 7200, sleep: 1800, attempts: 3 };
    Orders { inverter_delays: (30, 60), generator }
}

const DAYS: u64 = 10;
const SEEDS: u64 = 20;

/// Fails unless everything measurable is within what such a station can show.
fn check_ranges(station: &Station, context: &str) {
    let ranges = [
        ("soc", station.battery().soc(), 0.10, 1.0),
        ("battery V", station.battery().voltage(), 20.5, 30.0),
        ("battery A", station.battery().current(), -170.0, 90.0),
        ("battery °C", station.battery().temperature(), 2.0, 40.0),
        ("panel V", station.solar().voltage(), 0.0, 100.0),
        ("panel A", station.solar().panel_current(), 0.0, 25.0),
        ("MPPT A", station.solar().current(), 0.0, 50.0),
        ("MPPT °C", station.solar().temperature(), -5.0, 75.0),
        ("charger A", station.charger().current(), 0.0, 35.0),
        ("air °C", station.weather().temperature(), -8.0, 38.0),
        ("small W", station.inverters()[0].watts(), 0.0, 1000.0),
        ("large W", station.inverters()[1].watts(), 0.0, 3000.0),
        ("small °C", station.inverters()[0].temperature(), -5.0, 80.0),
        ("large °C", station.inverters()[1].temperature(), -5.0, 80.0),
        ("vertical mm", station.tracker().vertical, 0.0, tracker::STROKE),
        ("horizontal mm", station.tracker().horizontal, 0.0, tracker::STROKE),
    ];
    for (name, value, low, high) in ranges {
        assert!((low..=high).contains(&value), "{name} is {value} {context}");
    }
}

#[test]
fn ten_days_of_twenty_seeds_stay_within_what_a_station_can_show_and_show_all_of_it() {
    let mut seen: Vec<Event> = Vec::new();
    for seed in 0..SEEDS {
        let mut station = Station::new(seed, orders());
        for _ in 0..DAYS * 24 * 60 {
            station.advance(60.0);
            check_ranges(&station, &format!("at {} of seed {seed}", station.date_time()));
        }
        seen.extend(station.take_events());
        check_balance(&station, seed);
    }
    check_variety(&seen);
}

/// What flowed in has flowed out, and the battery gave back most of what it got.
fn check_balance(station: &Station, seed: u64) {
    let ledger = station.ledger();
    let sources = ledger.solar + ledger.charger;
    let uses = ledger.inverters + ledger.controllers + ledger.charged - ledger.discharged;
    assert!((sources - uses).abs() < 0.001 * sources, "seed {seed}: {ledger:?}");
    let capacity = station.battery().capacity() * 24.0;
    let stored =
        (station.battery().soc() - Station::new(seed, orders()).battery().soc()) * capacity;
    let back = (ledger.discharged + stored) / ledger.charged;
    assert!((0.70..0.97).contains(&back), "seed {seed}: battery gives back {back}, {ledger:?}");
    let efficiency = ledger.loads / ledger.inverters;
    assert!((0.6..0.93).contains(&efficiency), "seed {seed}: inverters give {efficiency}");
    let daily = ledger.solar / DAYS as f64;
    assert!((1200.0..9500.0).contains(&daily), "seed {seed}: {daily} Wh a day from the sun");
}

#[test]
fn the_cut_of_the_calls_does_not_matter() {
    let (mut coarse, mut fine) = (Station::new(5, orders()), Station::new(5, orders()));
    coarse.advance(4.0 * 3600.0);
    for _ in 0..4 * 3600 * 4 {
        fine.advance(0.25);
    }
    assert_eq!(format!("{coarse:?}"), format!("{fine:?}"));
    let mut other = Station::new(6, orders());
    other.advance(4.0 * 3600.0);
    assert_ne!(coarse.battery().soc(), other.battery().soc());
}

#[test]
fn nothing_jumps_that_nature_moves_slowly() {
    let mut station = Station::new(2, orders());
    let look = |s: &Station| {
        let light = s.weather().light(s.sun().elevation);
        [
            ("soc", s.battery().soc() * 100.0, 0.02),
            ("battery °C", s.battery().temperature(), 0.01),
            ("air °C", s.weather().temperature(), 0.02),
            ("MPPT °C", s.solar().temperature(), 0.1),
            ("inverter °C", s.inverters()[1].temperature(), 0.4),
            ("beam", light.beam, 60.0),
            (
                "mains V",
                if s.mains().present() { s.mains().voltage(0, s.hour()) } else { 220.0 },
                14.0,
            ),
        ]
    };
    let mut before = look(&station);
    for _ in 0..2 * 86_400 {
        station.advance(1.0);
        let now = look(&station);
        for ((name, was, most), (_, is, _)) in before.into_iter().zip(now) {
            assert!((is - was).abs() <= most, "{name} {was} -> {is} at {}", station.date_time());
        }
        before = now;
    }
}

/// Everything that can happen has happened to one station or another.
fn check_variety(seen: &[Event]) {
    for event in [
        Event::LoadOnMains,
        Event::LoadOnInverters,
        Event::MainsLost,
        Event::MainsRestored,
        Event::BatteryLowMains,
        Event::BatteryLowGeneratorStarts,
        Event::ChargingFromMains,
        Event::ChargingFromGenerator,
        Event::ChargeFinished,
        Event::PanelsConnected,
        Event::PanelsDisconnected,
        Event::ActuatorsOn,
        Event::ActuatorsOff,
        Event::Generator,
        Event::Small(0),
        Event::Small(3),
        Event::Large(1),
        Event::Large(2),
    ] {
        assert!(seen.contains(&event), "{event:?} never happened");
    }
}
