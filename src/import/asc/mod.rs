//! Vector ASC (Vector, "CAN, Log & Trigger ASC Logging Format", versions 1.3.5 and 1.4.6), in the
//! dialects of CANoe, CANalyzer, can-utils, python-can and loggers.

mod event;

use std::io::Read;

use jiff::tz::TimeZone;

use super::digits::{Words, seconds};
use super::lines::{Line, Lines};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Settings, Skipped, dates};
use crate::frame::{Frame, Stamped, Timestamp};
use event::{Event, Taken};

/// Most frames given at once.
const BATCH: usize = 4096;

/// The finest that dates have, nanoseconds.
const DATE_STEP: u64 = 1_000_000;

/// Reads a log.
pub struct Reader {
    lines: Lines,
    clock: Clock,
    decimal: bool,
    names: Names,
    /// Names that bustape wrote for the channels, as it numbered them.
    channels: Vec<(u64, String)>,
    skipped: Skipped,
    notes: Vec<String>,
    /// Lines with a time that are no CAN frames.
    others: u64,
}

/// What the times of a log are counted from.
struct Clock {
    zone: TimeZone,
    /// Of the `date` line: when the measurement began.
    date: Option<Timestamp>,
    /// Of the last `Begin Triggerblock`, until its first event.
    block: Option<Timestamp>,
    /// Where events without differences count from.
    base: Timestamp,
    /// Times are differences from event to event.
    differences: bool,
    /// The time of the last event: since `base`.
    last: u64,
}

impl Clock {
    fn date(&mut self, text: &[u8]) -> Option<Timestamp> {
        dates::parse(text).map(|date| dates::in_zone(date, &self.zone))
    }

    /// The moment of an event that says `nanos`.
    fn time(&mut self, nanos: u64) -> Timestamp {
        if let Some(block) = self.block.take() {
            // Times count on from the date of the head, from block to block. Tools that start over
            // at each block, or whose head has the date of the file, mean the block's own date.
            let counted = nanos.saturating_add(if self.differences { self.last } else { 0 });
            let goes_on = self.date.is_some_and(|date| {
                block >= date && counted.saturating_add(DATE_STEP) >= block.since(date)
            });
            if !goes_on {
                self.base = block;
                self.date.get_or_insert(block);
                self.last = 0;
            }
        }
        self.last = if self.differences { self.last.saturating_add(nanos) } else { nanos };
        self.base.plus(self.last)
    }
}

/// A log.
pub fn open(input: Box<dyn Read>, settings: &Settings) -> Reader {
    let clock = Clock {
        zone: settings.zone.clone(),
        date: None,
        block: None,
        base: Timestamp(0),
        differences: false,
        last: 0,
    };
    Reader {
        lines: Lines::new(input),
        clock,
        decimal: false,
        names: Names::default(),
        channels: Vec::new(),
        skipped: Skipped::default(),
        notes: Vec::new(),
        others: 0,
    }
}

/// True for a text whose first lines are those of an ASC log.
pub fn recognises(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
    let mut lines = head.split(|&byte| byte == b'\n').take(50).map(|line| Words(line.trim_ascii()));
    lines.any(|mut words| {
        let Some(first) = words.next() else { return false };
        match first.to_ascii_lowercase().as_slice() {
            b"base" => words.accept(b"hex") || words.accept(b"dec"),
            b"date" => dates::parse(words.0).is_some(),
            b"begin" => words.accept(b"triggerblock"),
            b"no" => words.accept(b"internal") && words.accept(b"events"),
            // A log without its head.
            _ => {
                seconds(first).is_some()
                    && first.contains(&b'.')
                    && matches!(event::read(words, false), Event::Frame(Taken { .. }))
            }
        }
    })
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let Self { lines, clock, names, skipped, channels, .. } = self;
        let enough = into.len() + BATCH;
        while into.len() < enough {
            let Some(Line { number, text, .. }) = lines.next_line()? else {
                self.finish();
                return Ok(false);
            };
            let mut words = Words(text);
            let Some(first) = words.next() else { continue };
            let Some(nanos) = seconds(first) else {
                // Times before the measurement began are of frames as well.
                if let Some(later) = first.strip_prefix(b"-").and_then(seconds) {
                    if let Event::Frame(_) = event::read(words, self.decimal) {
                        let why = || format!("its time is {later} ns before the log begins");
                        skipped.add(|| format!("line {number}"), why);
                    }
                } else {
                    head(first, words, clock, &mut self.decimal, channels);
                }
                continue;
            };
            let time = clock.time(nanos);
            let taken = match event::read(words, self.decimal) {
                Event::Frame(Taken { channel, frame }) => {
                    let known = channels.iter().find(|(number, _)| *number == channel);
                    let bus = match known {
                        Some((_, name)) => names.index(name),
                        None => names.numbered(channel),
                    };
                    bus.map(|bus| {
                        let value = Frame::Can(frame);
                        into.push(LogFrame { bus, frame: Stamped { time, value } });
                    })
                }
                Event::Other => {
                    // Every log has this one, at its beginning.
                    self.others += u64::from(!text.ends_with(b"Start of measurement"));
                    Ok(())
                }
                Event::Broken(why) => Err(why),
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
        self.clock.date.is_none()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Reader {
    fn finish(&mut self) {
        if self.others > 0 {
            let count = self.others;
            self.notes.push(format!(
                "{count} line(s) are of other events than CAN frames (statistics, states, other \
                 buses) and are not taken"
            ));
        }
        self.lines.report_end(&mut self.skipped, &mut self.notes);
    }
}

/// A line without a time: the head, a comment, the bounds of a block.
fn head(
    first: &[u8],
    mut words: Words<'_>,
    clock: &mut Clock,
    decimal: &mut bool,
    channels: &mut Vec<(u64, String)>,
) {
    let first = first.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(first);
    match first.to_ascii_lowercase().as_slice() {
        b"date" => {
            if let Some(date) = clock.date(words.0) {
                (clock.date, clock.base) = (Some(date), date);
            }
        }
        b"base" => {
            *decimal = words.accept(b"dec");
            words.accept(b"hex");
            clock.differences = words.accept(b"timestamps") && words.accept(b"relative");
        }
        b"begin" if words.accept(b"triggerblock") => clock.block = clock.date(words.0),
        // `// bus 1 = can0`, which bustape writes.
        b"//" if words.accept(b"bus") && channels.len() < 256 => {
            let number = words.next().and_then(super::digits::decimal);
            let name =
                words.accept(b"=").then(|| str::from_utf8(words.0.trim_ascii()).ok()).flatten();
            if let (Some(number), Some(name)) = (number, name) {
                channels.push((number, name.to_owned()));
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests;
