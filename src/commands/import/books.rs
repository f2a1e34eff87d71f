//! What was imported, bus by bus.

use std::sync::Arc;

use crate::capture::BusFacts;
use crate::frame::{CanFlags, Frame, Unit};
use crate::queue::Tally;
use crate::record::{RecordedBus, summary};
use crate::recording::definition::Facts;

/// The books of an import.
#[derive(Default)]
pub struct Books {
    buses: Vec<RecordedBus>,
    /// Frames and reads of serial lines added.
    pub frames: u64,
    /// Of these, error frames.
    pub error_frames: u64,
    /// Of these, remote frames.
    pub remote_frames: u64,
    /// Gaps that the logs tell of.
    pub gaps: u64,
}

impl Books {
    /// Buses known so far.
    pub fn buses(&self) -> usize {
        self.buses.len()
    }

    /// Adds a bus of which `first` is the first frame; gives what is written of it.
    pub fn add_bus(&mut self, name: &str, first: &Frame) -> (String, Facts) {
        let (unit, kind) = match first {
            Frame::Serial(_) => (Unit::Bytes, "serial"),
            Frame::Gap(gap) if gap.unit == Unit::Bytes => (Unit::Bytes, "serial"),
            _ => (Unit::Frames, "can"),
        };
        let more = Facts::from([("kind".to_owned(), kind.to_owned())]);
        let facts = BusFacts { unit: Some(unit), more, ..BusFacts::default() };
        let tally = Arc::new(Tally::default());
        let bus = RecordedBus {
            name: name.to_owned(),
            address: "imported".to_owned(),
            facts,
            tally,
            stream: None,
        };
        let head = bus.head();
        self.buses.push(bus);
        head
    }

    /// Counts what was added to the recording.
    pub fn count(&mut self, bus: usize, frame: &Frame) {
        let tally = &self.buses[bus].tally;
        match frame {
            Frame::Gap(gap) => {
                self.gaps += 1;
                tally.missed(gap.reason, gap.count);
            }
            frame => {
                tally.received(frame.weight());
                tally.written(frame.weight());
                self.frames += 1;
            }
        }
        if let Frame::Can(can) = frame {
            self.error_frames += u64::from(can.flags.has(CanFlags::ERROR));
            self.remote_frames += u64::from(can.flags.has(CanFlags::REMOTE));
        }
    }

    /// Name, unit and totals of each bus.
    pub fn list(&self) -> impl Iterator<Item = &RecordedBus> {
        self.buses.iter()
    }

    /// What stands at the end of the recording.
    pub fn summary(&self) -> Facts {
        let counts: Vec<u64> = self.buses.iter().map(|bus| bus.tally.totals().written).collect();
        summary("import", &self.buses, &counts)
    }
}
