//! PEAK TRC, versions 1.0 to 2.1 (PEAK-System, "PEAK CAN TRC File Format", 2020-07-27).

mod row;

use std::io::Read;

use jiff::tz::TimeZone;

use super::digits::{Words, decimal};
use super::lines::{Line, Lines};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Settings, Skipped, dates};
use crate::frame::{Frame, Stamped, Timestamp};
use row::{Layout, Row, Taken};

/// Most frames given at once.
const BATCH: usize = 4096;
/// 1970-01-01 in days since 1899-12-30, from where `$STARTTIME` counts.
const EPOCH_DAYS: u64 = 25_569;
const DAY_NANOS: u64 = 86_400_000_000_000;

/// Reads a log.
pub struct Reader {
    lines: Lines,
    zone: TimeZone,
    layout: Layout,
    start: Option<Timestamp>,
    names: Names,
    /// Names that bustape wrote for the buses, as it numbered them.
    buses: Vec<(u64, String)>,
    skipped: Skipped,
    notes: Vec<String>,
    others: u64,
}

/// A log.
pub fn open(input: Box<dyn Read>, settings: &Settings) -> Reader {
    Reader {
        lines: Lines::new(input),
        zone: settings.zone.clone(),
        layout: Layout::V1_0,
        start: None,
        names: Names::default(),
        buses: Vec::new(),
        skipped: Skipped::default(),
        notes: Vec::new(),
        others: 0,
    }
}

/// True for a text whose first lines are those of a PEAK trace of CAN (those of LIN look alike).
pub fn recognises(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
    let mut lines = head.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii).take(100);
    let mut comments = 0;
    let first = lines.find(|line| {
        comments += u32::from(line.starts_with(b";"));
        line.starts_with(b";$FILEVERSION=") || !line.is_empty() && !line.starts_with(b";")
    });
    match first {
        Some(line) if line.starts_with(b";$FILEVERSION=") => {
            // The versions of LIN traces have these columns.
            !lines.any(|line| {
                line.windows(16).any(|part| part == b"PLIN-Net:       ")
                    || line.ends_with(b"Pub   = Publisher Frame")
            })
        }
        // Version 1.0 has no version.
        Some(line) => {
            let mut words = Words(line);
            let number = words.next().and_then(|word| word.strip_suffix(b")"));
            comments > 0 && number.and_then(decimal).is_some()
        }
        None => comments > 3 && head.windows(8).any(|part| part.eq_ignore_ascii_case(b"PCAN-Net")),
    }
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let enough = into.len() + BATCH;
        while into.len() < enough {
            let Some(Line { number, text, .. }) = self.lines.next_line()? else {
                self.finish();
                return Ok(false);
            };
            if let Some(comment) = text.trim_ascii_start().strip_prefix(b";") {
                let comment = comment.to_vec();
                self.comment(&comment);
                continue;
            }
            if text.is_empty() {
                continue;
            }
            let taken = match row::read(text, &self.layout) {
                Row::Frame(Taken { bus, nanos, frame }) => {
                    let known = self.buses.iter().find(|(number, _)| *number == bus);
                    let index = match known {
                        Some((_, name)) => self.names.index(name),
                        None => self.names.numbered(bus),
                    };
                    index.map(|bus| {
                        let time = self.start.unwrap_or_default().plus(nanos);
                        let value = Frame::Can(frame);
                        into.push(LogFrame { bus, frame: Stamped { time, value } });
                    })
                }
                Row::Other => {
                    self.others += 1;
                    Ok(())
                }
                Row::Broken(why) => Err(why),
            };
            if let Err(why) = taken {
                self.skipped.add(|| format!("line {number}"), || why);
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
        self.start.is_none()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl Reader {
    fn comment(&mut self, text: &[u8]) {
        let Some(keyword) = text.strip_prefix(b"$") else {
            self.plain_comment(text);
            return;
        };
        let Some(at) = keyword.iter().position(|&byte| byte == b'=') else { return };
        let (keyword, value) = (&keyword[..at], keyword[at + 1..].trim_ascii());
        match keyword {
            b"FILEVERSION" => self.layout = Layout::of(value),
            b"COLUMNS" => self.layout = self.layout.with_columns(value),
            b"STARTTIME" => {
                let value = value.strip_suffix(b";").unwrap_or(value);
                if let Some(time) = days(value) {
                    self.start = Some(dates::in_zone(time, &self.zone));
                } else {
                    let text = super::digits::shown(value);
                    self.notes.push(format!("its $STARTTIME \"{text}\" is no number of days"));
                }
            }
            _ => {}
        }
    }

    fn plain_comment(&mut self, text: &[u8]) {
        let text = text.trim_ascii();
        if let Some(rest) = text.strip_prefix(b"Start time:") {
            // Where there is a $STARTTIME, that is exact.
            if let Some(time) = dates::parse(rest).filter(|_| self.start.is_none()) {
                self.start = Some(dates::in_zone(time, &self.zone));
            }
        } else if let Some(rest) = text.strip_prefix(b"Bus ") {
            // `Bus 1 = can0`, which bustape writes.
            let mut words = Words(rest);
            let number = words.next().and_then(decimal);
            let name =
                words.accept(b"=").then(|| str::from_utf8(words.0.trim_ascii()).ok()).flatten();
            if let (Some(number), Some(name)) = (number, name.filter(|_| self.buses.len() < 256)) {
                self.buses.push((number, name.to_owned()));
            }
        }
    }

    fn finish(&mut self) {
        if self.others > 0 {
            let count = self.others;
            self.notes.push(format!(
                "{count} line(s) are of other events than CAN frames (states, counters, warnings) \
                 and are not taken"
            ));
        }
        self.lines.report_end(&mut self.skipped, &mut self.notes);
    }
}

/// Days since 1899-12-30 with a fraction, to the nanosecond.
fn days(text: &[u8]) -> Option<Timestamp> {
    let point = text.iter().position(|&byte| byte == b'.' || byte == b',').unwrap_or(text.len());
    let whole = decimal(&text[..point])?.checked_sub(EPOCH_DAYS)?.checked_mul(DAY_NANOS)?;
    let fraction = text.get(point + 1..).unwrap_or_default();
    let fraction = &fraction[..fraction.len().min(18)];
    if fraction.is_empty() {
        return Some(Timestamp(whole));
    }
    let scale = 10u128.pow(u32::try_from(fraction.len()).ok()?);
    let nanos = (u128::from(decimal(fraction)?) * u128::from(DAY_NANOS) + scale / 2) / scale;
    Some(Timestamp(whole.checked_add(u64::try_from(nanos).ok()?)?))
}

#[cfg(test)]
mod tests;
