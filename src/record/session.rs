//! What all files of a recording have in common.

use std::path::PathBuf;
use std::sync::Arc;

use super::bus::RecordedBus;
use super::pace::Pace;
use super::progress::Progress;
use super::retention::{Open, Retention, Room};
use super::segments::Segment;
use crate::clock::Timeline;
use crate::frame::{Level, Notice, Timestamp};
use crate::recording::definition::{Attachment, Facts};
use crate::recording::event::Event;
use crate::recording::writer::Head;

/// Most sentences that wait for the files.
const WAITING: usize = 1000;

/// What all files of a recording have in common.
pub struct Session {
    /// Its buses.
    pub buses: Vec<RecordedBus>,
    /// Its timeline.
    pub timeline: Timeline,
    /// When things reach the disk.
    pub pace: Pace,
    /// `bustape.recording`, but for what each file adds.
    pub recording: Facts,
    /// Definitions and configuration.
    pub attachments: Vec<Attachment>,
    /// Who deletes segments, where there may be too many.
    pub retention: Option<Retention>,
    /// What others see of it.
    pub progress: Arc<Progress>,
    open: OpenSegment,
    remarks: Vec<Notice>,
    events: u64,
}

/// The open segment of the continuous recording, for the retention.
#[derive(Default)]
struct OpenSegment {
    path: PathBuf,
    bytes: u64,
    holds_event: bool,
}

impl Session {
    /// A recording of `buses`. `recording` goes into the metadata `bustape.recording` of each file.
    pub fn new(
        buses: Vec<RecordedBus>,
        timeline: Timeline,
        pace: Pace,
        (recording, attachments): (Facts, Vec<Attachment>),
        retention: Option<Retention>,
        progress: Arc<Progress>,
    ) -> Self {
        let open = OpenSegment::default();
        let remarks = Vec::new();
        Self {
            buses,
            timeline,
            pace,
            recording,
            attachments,
            retention,
            progress,
            open,
            remarks,
            events: 0,
        }
    }

    /// The head of a file: number `segment` of the session with number `session`.
    pub fn head(&self, session: u32, segment: u32, more: Vec<(String, Facts)>) -> Head {
        let (time, reading) = self.timeline.read();
        let clock = Facts::from([
            ("log_time_ns".to_owned(), time.nanos().to_string()),
            ("steady_clock".to_owned(), "CLOCK_BOOTTIME".to_owned()),
            ("steady_ns".to_owned(), reading.steady.to_string()),
            ("wall_ns".to_owned(), reading.wall.to_string()),
        ]);
        let mut recording = self.recording.clone();
        recording.insert("segment".to_owned(), segment.to_string());
        recording.insert("session".to_owned(), session.to_string());
        let buses = self.buses.iter().map(RecordedBus::head).collect();
        Head { recording, clock, buses, more, attachments: self.attachments.clone(), time }
    }

    /// Gives an event its name.
    pub fn name(&mut self, event: &mut Event) {
        self.events += 1;
        let fact = |name: &str| self.recording.get(name).cloned().unwrap_or_default();
        event.id = format!("{}/{}", fact("session_id"), self.events);
        event.device = fact("host");
    }

    /// A sentence about the recorder itself, for the files and the person.
    pub fn remark(&mut self, level: Level, text: String) {
        self.progress.notice(level, text.clone());
        if self.remarks.len() < WAITING {
            self.remarks.push(Notice { level, text });
        }
    }

    /// The sentences that are not in a file yet.
    pub fn take_remarks(&mut self) -> Vec<Notice> {
        for Notice { level, text } in self.progress.take_remarks() {
            self.remark(level, text);
        }
        std::mem::take(&mut self.remarks)
    }

    /// What is to be known of the open segment of the continuous recording.
    pub fn note_open(&mut self, segment: Option<&Segment>) {
        self.open = segment.map_or_else(OpenSegment::default, |segment| OpenSegment {
            path: segment.path.clone(),
            bytes: segment.writer.position(),
            holds_event: segment.writer.holds_event(),
        });
    }

    /// Makes room for `need` bytes about to be written. False when there is none, which is said.
    pub fn make_room(&mut self, need: u64) -> bool {
        let Err(text) = self.try_room(need) else { return true };
        self.remark(Level::Warning, text);
        false
    }

    /// Makes room for `need` bytes about to be written; the error says why there is none.
    pub fn try_room(&mut self, need: u64) -> Result<(), String> {
        let now: Timestamp = self.timeline.now();
        let Some(retention) = &mut self.retention else { return Ok(()) };
        let OpenSegment { path, bytes, holds_event } = &self.open;
        let open = Open { path, bytes: *bytes, holds_event: *holds_event };
        let Room { said, full } = retention.make_room(need, open, now);
        for text in said {
            self.remark(Level::Info, text);
        }
        full.map_or(Ok(()), Err)
    }
}
