//! A bus being recorded: what is said of it at the head of a file, once a second, and at the end.

use std::sync::Arc;

use crate::capture::BusFacts;
use crate::channels::Stream;
use crate::frame::error::BusState;
use crate::frame::{GapReason, Unit};
use crate::queue::{Controller, Tally, Totals};
use crate::recording::definition::Facts;
use crate::recording::schema::bustape::{BusStats, bus_stats};

/// A bus being recorded.
pub struct RecordedBus {
    /// The name the user gave it.
    pub name: String,
    /// Its address, as the user wrote it.
    pub address: String,
    /// What its source knows of it.
    pub facts: BusFacts,
    /// Its books.
    pub tally: Arc<Tally>,
}

impl RecordedBus {
    /// What stands at the head of each segment.
    pub fn head(&self) -> (String, Facts) {
        let mut facts = self.facts.more.clone();
        facts.insert("address".to_owned(), self.address.clone());
        let rates = [("bitrate", self.facts.bitrate), ("data_bitrate", self.facts.data_bitrate)];
        for (name, rate) in rates {
            if let Some(rate) = rate {
                facts.insert(name.to_owned(), rate.to_string());
            }
        }
        (self.name.clone(), facts)
    }

    /// Its state now, against that of `seconds` ago.
    pub fn stats(&self, now: &Totals, before: &Totals, seconds: f64) -> BusStats {
        let bits = now.bits - before.bits;
        let Controller { state, errors } = self.tally.controller();
        BusStats {
            state: state.map(|state| state_of(state) as i32),
            tx_errors: errors.map(|(tx, _)| tx),
            rx_errors: errors.map(|(_, rx)| rx),
            received: now.received,
            written: now.written,
            dropped_kernel_queue: now.lost_to(GapReason::KernelQueue),
            dropped_recorder_queue: now.lost_to(GapReason::RecorderQueue),
            dropped_overrun: now.lost_to(GapReason::Overrun),
            dropped_adapter: now.lost_to(GapReason::Adapter),
            dropped_disk: now.lost_to(GapReason::Disk),
            rate: (now.received - before.received) as f64 / seconds,
            load: self.facts.bitrate.map(|rate| bits as f64 / seconds / f64::from(rate)),
        }
    }
}

fn state_of(state: BusState) -> bus_stats::State {
    match state {
        BusState::Active => bus_stats::State::ErrorActive,
        BusState::Warning => bus_stats::State::ErrorWarning,
        BusState::Passive => bus_stats::State::ErrorPassive,
        BusState::BusOff => bus_stats::State::BusOff,
    }
}

/// One bus's lines in `bustape.summary`.
pub struct Account<'a> {
    /// The bus.
    pub bus: &'a RecordedBus,
    /// Its books.
    pub totals: Totals,
    /// What of it is in this file.
    pub in_segment: u64,
    /// Its decoded channels, if it is decoded.
    pub stream: Option<&'a Stream>,
}

/// `bustape.summary`: the books, and what of them is in this segment.
pub fn summary<'a>(reason: &str, accounts: impl Iterator<Item = Account<'a>>) -> Facts {
    let mut facts = Facts::from([("reason".to_owned(), reason.to_owned())]);
    for Account { bus, totals, in_segment, stream } in accounts {
        let unit = bus.facts.unit.unwrap_or(Unit::Frames).name();
        let mut put = |key: &str, value: String| {
            facts.insert(format!("{}.{key}", bus.name), value);
        };
        put("unit", unit.to_owned());
        put("received", totals.received.to_string());
        put("written", totals.written.to_string());
        put("dropped", totals.lost().to_string());
        put("segment_written", in_segment.to_string());
        put("outages", totals.outages.to_string());
        if totals.outside > 0 {
            put("outside", totals.outside.to_string());
        }
        for reason in GapReason::ALL {
            if totals.lost_to(reason) > 0 {
                let key = format!("dropped.{}", reason.name());
                put(&key, totals.lost_to(reason).to_string());
            }
        }
        if let Some(stream) = stream {
            stream.sum_up(&mut facts);
        }
    }
    facts
}
