//! Logs of candump in all its formats, and what `bustape cat` prints.

mod columns;
mod dialect;
pub mod line;
mod printed;

use std::io::Read;

use super::lines::{Line, Lines};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Settings, Skipped};
use crate::frame::{Frame, Gap, GapReason, Stamped, Timestamp, Unit};
use dialect::{Clock, Dialect};

/// Most frames given at once.
const BATCH: usize = 4096;
/// The bus of lines that name none.
const UNNAMED: &str = "can0";

pub use dialect::recognises;

/// Reads a log.
pub struct Reader {
    lines: Lines,
    names: Names,
    skipped: Skipped,
    notes: Vec<String>,
    clock: Clock,
    zone: jiff::tz::TimeZone,
    /// What the last line with a time said.
    last: Timestamp,
    /// Gaps that end with the next frame.
    gaps: Vec<(Option<u16>, u64)>,
    relative: bool,
}

/// A log whose beginning is `head`, which `input` gives again.
pub fn open(input: Box<dyn Read>, head: &[u8], settings: &Settings) -> Reader {
    let Dialect { clock, relative } = dialect::of(head);
    let mut notes = Vec::new();
    match clock {
        Clock::Differences => {
            notes.push("times are differences from line to line (candump -t d)".to_owned());
        }
        Clock::None => notes
            .push("lines have no times: all frames stand at one time, in their order".to_owned()),
        Clock::Moments => {}
    }
    Reader {
        lines: Lines::new(input),
        names: Names::default(),
        skipped: Skipped::default(),
        notes,
        clock,
        zone: settings.zone.clone(),
        last: Timestamp(0),
        gaps: Vec::new(),
        relative,
    }
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let Self { lines, names, skipped, .. } = self;
        let mut frames = 0;
        while frames < BATCH {
            let Some(Line { number, text }) = lines.next_line()? else {
                self.finish(into);
                return Ok(false);
            };
            let cleaned;
            let text = if text.contains(&0x1B) {
                cleaned = without_colours(text);
                &cleaned
            } else {
                text
            };
            let taken = match line::line(text) {
                Ok(line) => names.index(line.bus.unwrap_or(UNNAMED)).map(|bus| {
                    let time = self.clock.time(line.time, &mut self.last, &self.zone);
                    close_gaps(&mut self.gaps, bus, time, into);
                    into.push(LogFrame {
                        bus,
                        frame: Stamped { time, value: Frame::Can(line.frame) },
                    });
                    frames += 1;
                }),
                Err(why) => {
                    let mut beside = Beside {
                        names,
                        into,
                        gaps: &mut self.gaps,
                        clock: &self.clock,
                        last: &mut self.last,
                        zone: &self.zone,
                    };
                    let taken = beside.take(text);
                    frames += usize::from(matches!(taken, Some(Ok(()))));
                    taken.unwrap_or(Err(why))
                }
            };
            if let Err(why) = taken {
                skipped.add(|| format!("line {number}"), || why);
            }
        }
        Ok(true)
    }

    fn buses(&self) -> &[String] {
        self.names.list()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn times_are_relative(&self) -> bool {
        self.relative
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Reader {
    fn finish(&mut self, into: &mut Vec<LogFrame>) {
        if !self.names.list().is_empty() {
            close_gaps(&mut self.gaps, 0, self.last, into);
        }
        self.lines.report_end(&mut self.skipped, &mut self.notes);
    }
}

/// Lines that are no CAN frames.
struct Beside<'a> {
    names: &'a mut Names,
    into: &'a mut Vec<LogFrame>,
    gaps: &'a mut Vec<(Option<u16>, u64)>,
    clock: &'a Clock,
    last: &'a mut Timestamp,
    zone: &'a jiff::tz::TimeZone,
}

impl Beside<'_> {
    /// Takes a line if it is one of those known here; the inner error says what is wrong with it.
    fn take(&mut self, text: &[u8]) -> Option<Result<(), String>> {
        if let Some(rest) = text.strip_prefix(b"DROPCOUNT: ") {
            return Some(self.take_drops(rest));
        }
        if let Some(rest) = text.strip_prefix(b"# ") {
            return Some(self.take_comment(rest));
        }
        // What candump -e says of an error frame stands below it, behind a tab.
        let empty = text.is_empty() || text.starts_with(b"#") || text.starts_with(b"\t");
        // candump -l says this on stdout, which may have gone into the same file.
        if empty || text.starts_with(b"Disabled standard output") {
            return Some(Ok(()));
        }
        if let Some(row) = printed::continued(text) {
            let last = self.into.iter_mut().rev().find_map(|frame| match &mut frame.frame.value {
                Frame::Serial(bytes) => Some(bytes),
                _ => None,
            });
            return Some(match last {
                Some(bytes) => {
                    bytes.data.extend(row);
                    Ok(())
                }
                None => Err("it goes on with bytes whose first line is not there".to_owned()),
            });
        }
        let (time, rest) = line::time_and_rest(text).ok()?;
        let (bus, bytes) = printed::serial(rest)?;
        Some(self.names.index(bus).map(|bus| {
            let time = self.clock.time(time, self.last, self.zone);
            self.into.push(LogFrame { bus, frame: Stamped { time, value: Frame::Serial(bytes) } });
        }))
    }

    /// `dropped 3 CAN frames on 'can0' socket (total drops 3)`.
    fn take_drops(&mut self, text: &[u8]) -> Result<(), String> {
        let wrong = || "it is no DROPCOUNT line that candump writes".to_owned();
        let text = str::from_utf8(text).map_err(|_| wrong())?;
        let (count, rest) = text
            .strip_prefix("dropped ")
            .and_then(|rest| rest.split_once(" CAN frame"))
            .ok_or_else(wrong)?;
        let count = count.parse().map_err(|_| wrong())?;
        let bus = rest.split('\'').nth(1).ok_or_else(wrong)?;
        // The socket as it was asked for, with filters; "any" may be any.
        let bus = bus.split(',').next().filter(|bus| *bus != "any");
        let bus = bus.map(|bus| self.names.index(bus)).transpose()?;
        self.gaps.push((bus, count));
        Ok(())
    }

    /// What `bustape cat` says of gaps and of bytes with errors; all else is a comment.
    fn take_comment(&mut self, text: &[u8]) -> Result<(), String> {
        if let Some((bus, gap)) = printed::gap(text) {
            let bus = self.names.index(bus)?;
            self.into
                .push(LogFrame { bus, frame: Stamped { time: gap.to, value: Frame::Gap(gap) } });
        } else if let Some(error) = printed::line_error(text) {
            let last = self.into.last_mut().map(|frame| &mut frame.frame.value);
            if let Some(Frame::Serial(bytes)) = last {
                bytes.errors.push(error);
            }
        }
        Ok(())
    }
}

/// What was dropped was dropped before `time`.
fn close_gaps(
    gaps: &mut Vec<(Option<u16>, u64)>,
    bus: u16,
    time: Timestamp,
    into: &mut Vec<LogFrame>,
) {
    for (of, count) in gaps.drain(..) {
        let (unit, reason) = (Unit::Frames, GapReason::KernelQueue);
        // candump does not say since when; the frame before it is the least.
        let from = into.last().map_or(time, |before| before.frame.time.min(time));
        let gap = Frame::Gap(Gap { count, unit, reason, from, to: time });
        into.push(LogFrame { bus: of.unwrap_or(bus), frame: Stamped { time, value: gap } });
    }
}

/// The line without the sequences that colour it on a terminal (candump -c).
fn without_colours(text: &[u8]) -> Vec<u8> {
    let mut plain = Vec::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = memchr::memchr(0x1B, rest) {
        plain.extend_from_slice(&rest[..at]);
        let end = rest[at..].iter().position(u8::is_ascii_alphabetic);
        rest = end.map_or(&[][..], |end| &rest[at + end + 1..]);
    }
    plain.extend_from_slice(rest);
    plain
}

#[cfg(test)]
mod tests;
