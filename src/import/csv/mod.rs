//! CSV of frames: the columns of `bustape export --format frames-csv`, those of python-can
//! (`can.io.csv`), those of CSS Electronics' `mdf2csv`, or any of their names in any order.

mod field;

use std::io::Read;

use super::digits::{decimal, hex, shown};
use super::lines::{Line, Lines};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Skipped};
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, Frame, Stamped, fd_dlc};
use field::{base64, hex_bytes, moment, unquoted};

/// Most frames given at once.
const BATCH: usize = 4096;
/// The bus of frames that name none.
const UNNAMED: &str = "can0";

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Time,
    Bus,
    Id,
    /// A property that is there when the field is 1 or true.
    Flag(CanFlags),
    Direction,
    Dlc,
    Hex,
    Base64,
    Unknown,
}

impl Column {
    fn of(name: &[u8]) -> Self {
        match name.to_ascii_lowercase().as_slice() {
            b"time" | b"timestamp" | b"timestampepoch" => Self::Time,
            b"bus" | b"channel" | b"buschannel" => Self::Bus,
            b"id" | b"arbitration_id" => Self::Id,
            b"ext" | b"extended" | b"ide" => Self::Flag(CanFlags::EXTENDED),
            b"rtr" | b"remote" => Self::Flag(CanFlags::REMOTE),
            b"error" => Self::Flag(CanFlags::ERROR),
            b"fd" | b"edl" => Self::Flag(CanFlags::FD),
            b"brs" => Self::Flag(CanFlags::BRS),
            b"esi" => Self::Flag(CanFlags::ESI),
            b"dir" | b"direction" => Self::Direction,
            b"dlc" => Self::Dlc,
            b"data" | b"data_hex" | b"databytes" => Self::Hex,
            _ => Self::Unknown,
        }
    }
}

/// The columns, by the first line of a file.
fn columns(head: &[u8]) -> Option<(Vec<Column>, u8)> {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
    let line = head.split(|&byte| byte == b'\n').next()?.trim_ascii();
    let separator = if line.contains(&b';') { b';' } else { b',' };
    let mut columns: Vec<Column> =
        line.split(|&byte| byte == separator).map(|name| Column::of(unquoted(name))).collect();
    let has = |column| columns.contains(&column);
    if !(has(Column::Time) && has(Column::Id) && has(Column::Hex)) {
        return None;
    }
    // python-can's own columns have its own data.
    if line.starts_with(b"timestamp,arbitration_id,extended,remote,error,dlc,data") {
        columns
            .iter_mut()
            .filter(|column| **column == Column::Hex)
            .for_each(|column| *column = Column::Base64);
    }
    Some((columns, separator))
}

/// True for a text whose first line names the columns of frames.
pub fn recognises(head: &[u8]) -> bool {
    columns(head).is_some()
}

/// Reads a log.
pub struct Reader {
    lines: Lines,
    columns: Vec<Column>,
    separator: u8,
    names: Names,
    skipped: Skipped,
    notes: Vec<String>,
    /// Times count from the log's own start; not known before the first row.
    relative: Option<bool>,
}

/// A log whose beginning is `head`, which `input` gives again.
pub fn open(input: Box<dyn Read>, head: &[u8]) -> Result<Reader, ImportError> {
    let (columns, separator) = columns(head).ok_or_else(|| {
        ImportError::Format(
            "it is no CSV of frames: its first line does not name the columns time, id and data"
                .to_owned(),
        )
    })?;
    let mut lines = Lines::new(input);
    lines.next_line()?;
    let (names, skipped) = (Names::default(), Skipped::default());
    Ok(Reader { lines, columns, separator, names, skipped, notes: Vec::new(), relative: None })
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let Self { lines, columns, separator, names, skipped, .. } = self;
        let enough = into.len() + BATCH;
        while into.len() < enough {
            let Some(Line { number, text }) = lines.next_line()? else {
                lines.report_end(skipped, &mut self.notes);
                return Ok(false);
            };
            if text.is_empty() {
                continue;
            }
            match row(text, columns, *separator, names) {
                Ok(frame) => {
                    // Seconds since 1970 are above a billion since 2001. The first row says it for
                    // all: times of one log that were meant differently would lie decades apart.
                    let nanos = frame.frame.time.nanos();
                    self.relative.get_or_insert(nanos < 100_000_000_000_000_000);
                    into.push(frame);
                }
                Err(why) => skipped.add(|| format!("line {number}"), || why),
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
        self.relative == Some(true)
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

fn row(
    text: &[u8],
    columns: &[Column],
    separator: u8,
    names: &mut Names,
) -> Result<LogFrame, String> {
    let (mut time, mut id, mut flags, mut dlc) = (None, None, CanFlags::default(), None);
    let mut bus = None;
    let (mut data, mut length) = ([0; CAN_MAX_DATA], 0);
    let mut fields = text.split(|&byte| byte == separator);
    for column in columns {
        let field = unquoted(fields.next().ok_or("it has fewer fields than the first line")?);
        let wrong = |what: &str| format!("\"{}\" is no {what}", shown(field));
        match column {
            Column::Time => time = Some(moment(field).ok_or_else(|| wrong("time"))?),
            Column::Bus if field.is_empty() => {}
            Column::Bus => bus = Some(str::from_utf8(field).map_err(|_| wrong("name of a bus"))?),
            Column::Id => {
                let digits = field.strip_prefix(b"0x").or_else(|| field.strip_prefix(b"0X"));
                id = Some(hex(digits.unwrap_or(field)).ok_or_else(|| wrong("identifier"))?);
            }
            Column::Flag(flag) => match field.to_ascii_lowercase().as_slice() {
                b"1" | b"true" => flags |= *flag,
                b"0" | b"false" | b"" => {}
                _ => return Err(wrong("flag (0 or 1)")),
            },
            Column::Direction => match field.to_ascii_lowercase().as_slice() {
                b"tx" | b"1" => flags |= CanFlags::TX,
                b"rx" | b"0" | b"" => {}
                _ => return Err(wrong("direction (rx or tx)")),
            },
            Column::Dlc if field.is_empty() => {}
            Column::Dlc => {
                let number = decimal(field).filter(|dlc| *dlc <= CAN_MAX_DATA as u64);
                #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
                let number = number.ok_or_else(|| wrong("length"))? as u8;
                dlc = Some(number);
            }
            Column::Hex => length = hex_bytes(field, &mut data).ok_or_else(|| wrong("data"))?,
            Column::Base64 => length = base64(field, &mut data).ok_or_else(|| wrong("data"))?,
            Column::Unknown => {}
        }
    }
    let (time, id) = (time.unwrap_or_default(), id.unwrap_or_default());
    let wide = flags.has(CanFlags::EXTENDED) || flags.has(CanFlags::ERROR);
    if id > if wide { 0x1FFF_FFFF } else { 0x7FF } {
        return Err(format!("its identifier {id:X} is too large"));
    }
    let fd = flags.has(CanFlags::FD) || length > 8;
    if fd {
        flags |= CanFlags::FD;
    }
    // CAN FD has no remote frames: what is called both is one without data, or else none.
    if fd && flags.has(CanFlags::REMOTE) {
        let of_fd = CanFlags::FD | CanFlags::BRS | CanFlags::ESI;
        let wrong = if length > 0 { CanFlags::REMOTE } else { of_fd };
        flags = CanFlags(flags.0 & !wrong.0);
    }
    if flags.has(CanFlags::ERROR) {
        flags = CanFlags(flags.0 & !CanFlags::EXTENDED.0);
    }
    if let Some(dlc) = dlc.filter(|dlc| !has_length(*dlc, flags, length)) {
        return Err(format!("it has {length} bytes of data, but its length is {dlc}"));
    }
    // Other lengths than that of the data have a meaning for two kinds of frames only.
    let raw = match dlc.unwrap_or(0) {
        dlc if flags.has(CanFlags::REMOTE) => dlc.min(15),
        dlc @ 9..=15 if !fd && length == 8 => dlc,
        _ => 0,
    };
    let data = if flags.has(CanFlags::REMOTE) { &[] } else { &data[..length] };
    let value = Frame::Can(CanFrame::new(id, flags, data).with_dlc(raw));
    let bus = names.index(bus.unwrap_or(UNNAMED))?;
    Ok(LogFrame { bus, frame: Stamped { time, value } })
}

/// True if a frame with this DLC, or length, may have so many bytes of data.
fn has_length(dlc: u8, flags: CanFlags, length: usize) -> bool {
    let raw = !flags.has(CanFlags::FD) && length == 8 && (9..=15).contains(&dlc);
    // Of CAN FD some write the code, some the length that it means.
    let code = flags.has(CanFlags::FD) && fd_dlc(length) == dlc;
    flags.has(CanFlags::REMOTE) || raw || code || usize::from(dlc) == length
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Timestamp;

    fn read(text: &str) -> (Vec<LogFrame>, Skipped) {
        assert!(recognises(text.as_bytes()), "{text}");
        let input = Box::new(std::io::Cursor::new(text.to_owned()));
        let mut reader = open(input, text.as_bytes()).unwrap();
        let mut frames = Vec::new();
        while reader.read(&mut frames).unwrap() {}
        (frames, reader.skipped)
    }

    #[test]
    fn both_dialects_say_the_same() {
        let ours = "time,bus,id,ext,rtr,error,fd,brs,esi,dir,dlc,data\n\
            1483389946.197,can0,DADADA,1,0,0,0,0,0,rx,6,5b34322c205d\n\
            1483389946.197,can0,7FF,0,1,0,0,0,0,rx,3,\n\"x\",can0,1,0,0,0,0,0,0,rx,0,\n1,can0\n";
        let python = "timestamp,arbitration_id,extended,remote,error,dlc,data\n\
            1483389946.197,0x00dadada,1,0,0,6,WzQyLCBd\n1483389946.197,0x7ff,0,1,0,3,\n\
            x,0x1,0,0,0,0,\n1,0x1\n";
        let (frames, skipped) = read(ours);
        assert_eq!(read(python).0, frames);
        assert_eq!((frames.len(), skipped.count), (2, 2));
        let data = CanFrame::new(0xDA_DADA, CanFlags::EXTENDED, b"[42, ]");
        assert_eq!(frames[0].frame.value, Frame::Can(data));
        let remote = CanFrame::new(0x7FF, CanFlags::REMOTE, &[]).with_dlc(3);
        assert_eq!(frames[1].frame.value, Frame::Can(remote));
    }

    #[test]
    fn the_csv_of_a_logger_is_read() {
        let text = "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\r\n\
            1581670628.161550;1;123;0;4;4;0;0;0;12345678\r\n\
            1581670628.212000;2;12345678;1;9;12;1;1;1;1234567890ABCDEF12345678\r\n";
        let (frames, skipped) = read(text);
        assert_eq!(skipped.count, 0);
        let classic = CanFrame::new(0x123, CanFlags::default(), &[0x12, 0x34, 0x56, 0x78]);
        assert_eq!(frames[0].frame.value, Frame::Can(classic));
        assert_eq!(frames[0].frame.time, Timestamp(1_581_670_628_161_550_000));
        let flags = CanFlags::EXTENDED | CanFlags::FD | CanFlags::BRS | CanFlags::TX;
        let Frame::Can(fd) = &frames[1].frame.value else { panic!("{frames:?}") };
        assert_eq!((fd.id, fd.flags, fd.data().len(), fd.dlc), (0x1234_5678, flags, 12, 0));
        assert_eq!(frames[1].bus, 1);
    }
}
