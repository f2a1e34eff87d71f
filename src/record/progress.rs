//! What the writer is doing, for the status line.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::frame::{Level, Notice, Timestamp};
use crate::recording::event::Event;

/// Most sentences kept until somebody shows them.
const NOTICES_KEPT: usize = 100;
/// Most events that wait for the writer.
const EVENTS_KEPT: usize = 1000;

/// Shared between the writer, which changes it, and whoever shows it.
#[derive(Default)]
pub struct Progress(Mutex<State>);

/// The writer's state at one moment.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// The open segment, under the name it will have.
    pub file: PathBuf,
    /// Bytes written to finished segments.
    pub earlier_bytes: u64,
    /// Bytes written to the open segment.
    pub file_bytes: u64,
    /// Everything up to here would survive a power cut.
    pub synced: Option<Timestamp>,
    /// Bytes waiting for the writer.
    pub queued: usize,
    /// Windows around triggers begun so far.
    pub windows: u64,
    /// The latest of them, under the name it will have.
    pub window: Option<PathBuf>,
    /// Writing has ended for good.
    pub failed: bool,
    /// The recording was finished because there is no more room.
    pub full: bool,
    /// Somebody asked for a new segment.
    split: bool,
    /// Sentences from outside that are not in the file yet.
    remarks: Vec<Notice>,
    /// Events that are not in the file yet.
    events: Vec<Event>,
    /// Grows whenever the writer has gone round once.
    pub rounds: u64,
    /// Sentences not shown yet.
    pub notices: Vec<Notice>,
}

impl Progress {
    /// The state now; takes the notices.
    pub fn take(&self) -> State {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let notices = std::mem::take(&mut state.notices);
        State { notices, ..state.clone() }
    }

    /// The state now; takes nothing.
    pub fn look(&self) -> State {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// An event for the file. False when too many wait already.
    pub fn event(&self, event: Event) -> bool {
        let mut taken = false;
        self.change(|state| {
            taken = state.events.len() < EVENTS_KEPT;
            if taken {
                state.events.push(event);
            }
        });
        taken
    }

    pub(super) fn take_events(&self) -> Vec<Event> {
        let mut events = Vec::new();
        self.change(|state| events = std::mem::take(&mut state.events));
        events
    }

    pub(super) fn gone_round(&self) {
        self.change(|state| state.rounds += 1);
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    pub(super) fn file(&self, path: &Path, bytes: u64) {
        self.change(|state| {
            path.clone_into(&mut state.file);
            state.earlier_bytes += state.file_bytes;
            state.file_bytes = bytes;
        });
    }

    pub(super) fn window(&self, path: &Path) {
        self.change(|state| {
            state.windows += 1;
            state.window = Some(path.to_owned());
        });
    }

    pub(super) fn written(&self, bytes: u64) {
        self.change(|state| state.file_bytes = bytes);
    }

    pub(super) fn synced(&self, time: Timestamp) {
        self.change(|state| state.synced = Some(time));
    }

    pub(super) fn queued(&self, bytes: usize) {
        self.change(|state| state.queued = bytes);
    }

    /// A sentence for the file and for the person, from somebody beside the recording.
    pub fn remark(&self, level: Level, text: String) {
        self.change(|state| {
            if state.remarks.len() < NOTICES_KEPT {
                state.remarks.push(Notice { level, text });
            }
        });
    }

    /// Asks for a new segment.
    pub fn split(&self) {
        self.change(|state| state.split = true);
    }

    /// True once after each [`Progress::split`].
    pub(super) fn take_split(&self) -> bool {
        let mut split = false;
        self.change(|state| split = std::mem::take(&mut state.split));
        split
    }

    pub(super) fn take_remarks(&self) -> Vec<Notice> {
        let mut remarks = Vec::new();
        self.change(|state| remarks = std::mem::take(&mut state.remarks));
        remarks
    }

    pub(super) fn full(&self) {
        self.change(|state| state.full = true);
    }

    pub(super) fn failed(&self) {
        self.change(|state| state.failed = true);
    }

    pub(super) fn notice(&self, level: Level, text: String) {
        self.change(|state| {
            // Somebody who does not look must not cost memory; the file has them all.
            if state.notices.len() < NOTICES_KEPT {
                state.notices.push(Notice { level, text });
            }
        });
    }
}
