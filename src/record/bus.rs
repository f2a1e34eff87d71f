//! A bus being recorded: what is said of it at the head of a file, once a second, and at the end.

use std::sync::Arc;

use crate::capture::BusFacts;
use crate::channels::Stream;
use crate::frame::{GapReason, Unit};
use crate::queue::{Tally, Totals};
use crate::recording::definition::Facts;
use crate::recording::schema::bustape::BusStats;

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
    /// Its decoded channels, if it is decoded.
    pub stream: Option<Stream>,
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
        if let Some(stream) = &self.stream {
            facts.extend(stream.facts().clone());
        }
        (self.name.clone(), facts)
    }

    /// Its state now, against that of `seconds` ago.
    pub fn stats(&self, now: &Totals, before: &Totals, seconds: f64) -> BusStats {
        let bits = now.bits - before.bits;
        BusStats {
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

/// `bustape.summary`: the books so far, and what of them is in this segment.
pub fn summary(reason: &str, buses: &[RecordedBus], segment_counts: &[u64]) -> Facts {
    let mut facts = Facts::from([("reason".to_owned(), reason.to_owned())]);
    for (bus, in_segment) in buses.iter().zip(segment_counts) {
        let totals = bus.tally.totals();
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
        for reason in GapReason::ALL {
            if totals.lost_to(reason) > 0 {
                let key = format!("dropped.{}", reason.name());
                put(&key, totals.lost_to(reason).to_string());
            }
        }
        if let Some(stream) = &bus.stream {
            stream.sum_up(&mut facts);
        }
    }
    facts
}
