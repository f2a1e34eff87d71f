//! What an adapter says while its channel is open.

use std::cell::RefCell;

use super::address::SlcanAddress;
use super::codec::{Line, decode, is_overflow, status};
use super::lines::{Cut, Lines};
use super::spacing::Spacing;
use crate::capture::CaptureError;
use crate::frame::{CanFrame, Frame, GapReason, Level, Stamped, Timestamp};
use crate::queue::Inlet;

/// After so many questions for the status without an answer, no more are asked.
const UNANSWERED: u32 = 3;

/// What the next acknowledgement (or refusal) belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Awaiting {
    Open,
    Status,
    Close,
    Nothing,
}

/// From opening the channel to closing it.
pub(crate) struct Session<'a> {
    address: &'a SlcanAddress,
    inlet: &'a RefCell<Inlet>,
    lines: Lines,
    spacing: Spacing,
    awaiting: Awaiting,
    refused: bool,
    closed: bool,
    /// How many questions for the status had no answer; `None` when none are asked.
    unanswered: Option<u32>,
    /// When the adapter's loss flags were last known to be clear.
    sound: Timestamp,
    /// Lines that are not of the protocol, and refusals of nothing we asked.
    garbage: u64,
    frames: Vec<(CanFrame, Option<u16>)>,
}

impl<'a> Session<'a> {
    /// A session that begins now. Adapters that do not answer are not asked for their status.
    pub fn new(address: &'a SlcanAddress, answers: bool, inlet: &'a RefCell<Inlet>) -> Self {
        let now = inlet.borrow().timeline().now();
        Self {
            address,
            inlet,
            lines: Lines::default(),
            spacing: Spacing::new(now),
            awaiting: Awaiting::Open,
            refused: false,
            closed: false,
            unanswered: answers.then_some(0),
            sound: now,
            garbage: 0,
            frames: Vec::new(),
        }
    }

    /// Where frames go.
    pub fn inlet(&self) -> &'a RefCell<Inlet> {
        self.inlet
    }

    /// Opens the channel: `L` hears only, `O` also acknowledges frames on the bus. Neither
    /// transmits.
    pub fn open_command(&self) -> &'static [u8] {
        if self.address.listen { b"L\r" } else { b"O\r" }
    }

    /// Asks for the status flags, once a second, as long as the adapter answers.
    pub fn poll_command(&mut self) -> Option<&'static [u8]> {
        let unanswered = self.unanswered.filter(|&u| u < UNANSWERED)?;
        self.unanswered = Some(unanswered + 1);
        self.awaiting = Awaiting::Status;
        Some(b"F\r")
    }

    /// The channel is being closed.
    pub fn expect_close(&mut self) {
        self.awaiting = Awaiting::Close;
    }

    /// True when the adapter has acknowledged closing.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// True when the adapter refused to open the channel.
    pub fn is_refused(&self) -> bool {
        self.refused
    }

    /// How the session ended.
    pub fn outcome(&self) -> Result<(), CaptureError> {
        if !self.refused {
            return Ok(());
        }
        let port = self.address.path.display();
        Err(CaptureError(if self.address.listen {
            format!(
                "the adapter at {port} refused L (open listening only); leave out `listen` if it \
                 may acknowledge frames on the bus"
            )
        } else {
            format!("the adapter at {port} refused O (open the channel); unplug it and try again")
        }))
    }

    /// Takes what one read returned and says when that was.
    pub fn take(&mut self, read: &[u8]) -> Timestamp {
        let time = self.inlet.borrow().timeline().now();
        let mut lines = std::mem::take(&mut self.lines);
        lines.feed(read, |cut| self.take_line(cut, time));
        self.lines = lines;
        self.push(time);
        time
    }

    fn take_line(&mut self, cut: Cut<'_>, time: Timestamp) {
        let line = match cut {
            Cut::Refused => return self.refusal(),
            Cut::TooLong => return self.strange("a line longer than any of the protocol"),
            Cut::Line(line) => line,
        };
        match decode(line) {
            Line::Frame(frame, stamp) => {
                if is_overflow(&frame) {
                    self.overflow(time);
                }
                self.frames.push((frame, stamp));
            }
            Line::Status(flags) => {
                if self.awaiting == Awaiting::Status {
                    self.awaiting = Awaiting::Nothing;
                }
                self.unanswered = self.unanswered.map(|_| 0);
                if flags & (status::RX_FULL | status::OVERRUN) != 0 {
                    self.overflow(time);
                }
                self.sound = time;
            }
            Line::Acknowledged => {
                self.closed |= self.awaiting == Awaiting::Close;
                self.awaiting = Awaiting::Nothing;
            }
            Line::Information => {}
            Line::Garbage => self.strange(&format!("`{}`", line.escape_ascii())),
        }
    }

    fn refusal(&mut self) {
        match std::mem::replace(&mut self.awaiting, Awaiting::Nothing) {
            Awaiting::Open => self.refused = true,
            // It has no such command.
            Awaiting::Status => self.unanswered = None,
            Awaiting::Close => self.closed = true,
            Awaiting::Nothing => self.garbage += 1,
        }
    }

    /// The adapter lost frames, nobody knows how many, since all was last well.
    fn overflow(&mut self, time: Timestamp) {
        self.inlet.borrow_mut().gap(GapReason::Adapter, 0, self.sound, time);
        self.sound = time;
    }

    fn strange(&mut self, what: &str) {
        self.garbage += 1;
        if self.garbage == 1 {
            let text = format!(
                "the adapter at {} sent {what}, which is not slcan; such lines are counted and \
                 left out",
                self.address.path.display()
            );
            self.inlet.borrow_mut().notice(Level::Warning, text);
        }
    }

    fn push(&mut self, read: Timestamp) {
        if self.frames.is_empty() {
            return;
        }
        let stamps: Vec<_> = self.frames.iter().map(|f| f.1).collect();
        let times = self.spacing.times(read, &stamps);
        let frames = self.frames.drain(..).zip(times);
        let mut frames: Vec<_> =
            frames.map(|((f, _), time)| Stamped { time, value: Frame::Can(f) }).collect();
        self.inlet.borrow_mut().push(&mut frames);
    }

    /// Says at the end how many lines were left out.
    pub fn report(&self) {
        if self.garbage > 0 {
            let text = format!(
                "{} lines of the adapter at {} were not slcan",
                self.garbage,
                self.address.path.display()
            );
            self.inlet.borrow_mut().notice(Level::Warning, text);
        }
    }
}
