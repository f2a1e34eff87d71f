//! One line of candump's (can-utils, `candump.c`, `lib.c`), in any of its formats.

use super::columns;
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, Timestamp};
use crate::import::digits::{Words, decimal, hex, hex_digit, hex_pair, shown};

/// `CAN_ERR_FLAG` of `linux/can.h`, in the identifier of an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// Largest 29-bit identifier.
pub const MAX_EXTENDED: u32 = 0x1FFF_FFFF;
/// candump writes times since 1970 with ten digits (`-t a`), those since its start or the line
/// before with three or as many as it takes (`-t z`, `-t d`): nine are thirty years.
const DATE_DIGITS: usize = 9;

/// What a line says of its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// Since 1970.
    Absolute(Timestamp),
    /// A date and time of day without a zone, as if it were UTC.
    Local(Timestamp),
    /// Since the first line or the line before, nanoseconds.
    Relative(u64),
}

impl Time {
    /// The number itself.
    pub fn stamp(self) -> Timestamp {
        match self {
            Self::Absolute(time) | Self::Local(time) => time,
            Self::Relative(nanos) => Timestamp(nanos),
        }
    }
}

/// One line of a log.
#[derive(Debug, PartialEq)]
pub struct Line<'a> {
    /// When, if the line says so.
    pub time: Option<Time>,
    /// Which bus, if the line says so.
    pub bus: Option<&'a str>,
    /// The frame; `TX` is set when the line says that it was sent.
    pub frame: CanFrame,
    /// The line says which way the frame went.
    pub has_direction: bool,
}

/// Reads `FRAME`, `BUS FRAME`, `(TIME) BUS FRAME` or `(TIME) BUS FRAME R`, or a line of candump's
/// other format, `(TIME) BUS [RX - -] ID [LENGTH] BYTES`.
pub fn line(text: &[u8]) -> Result<Line<'_>, String> {
    match logged(text) {
        Some(line) => Ok(line),
        None => any(text),
    }
}

/// The line as `candump -l` and `-L` write it: nearly all lines, so without a detour.
fn logged(text: &[u8]) -> Option<Line<'_>> {
    let rest = text.strip_prefix(b"(")?;
    let point = rest.iter().take(12).position(|&byte| byte == b'.')?;
    let seconds = decimal(&rest[..point])?;
    let end = point + 1 + rest[point + 1..].iter().take(10).position(|&byte| byte == b')')?;
    let fraction = &rest[point + 1..end];
    let scale = 10u64.pow(9u32.checked_sub(u32::try_from(fraction.len()).ok()?)?);
    let nanos = seconds.checked_mul(1_000_000_000)?.checked_add(decimal(fraction)? * scale)?;
    let rest = rest[end + 1..].trim_ascii_start();
    let gap = rest.iter().position(|&byte| byte == b' ')?;
    let bus = str::from_utf8(&rest[..gap]).ok()?;
    let rest = rest[gap..].trim_ascii_start();
    let hash = rest.iter().take(9).position(|&byte| byte == b'#')?;
    let frame = if rest.get(hash + 1).is_some_and(|byte| matches!(byte, b'#' | b'R' | b'r')) {
        return None;
    } else {
        let (id, flags) = identifier(&rest[..hash]).ok()?;
        let end = rest.iter().position(|&byte| byte == b' ').unwrap_or(rest.len());
        let (digits, tail) = (&rest[hash + 1..end], &rest[end..]);
        let mut data = [0; 8];
        let length = digits.len() / 2;
        let (pairs, odd) = digits.as_chunks::<2>();
        if !odd.is_empty() || length > 8 {
            return None;
        }
        for (byte, [high, low]) in data.iter_mut().zip(pairs) {
            *byte = hex_pair(*high, *low)?;
        }
        let (flags, has_direction) = match tail {
            b"" => (flags, false),
            b" R" => (flags, true),
            b" T" => (flags | CanFlags::TX, true),
            _ => return None,
        };
        (CanFrame::new(id, flags, &data[..length]), has_direction)
    };
    let time =
        if point >= DATE_DIGITS { Time::Absolute(Timestamp(nanos)) } else { Time::Relative(nanos) };
    Some(Line { time: Some(time), bus: Some(bus), frame: frame.0, has_direction: frame.1 })
}

fn any(text: &[u8]) -> Result<Line<'_>, String> {
    let (time, rest) = time_and_rest(text)?;
    let mut words = Words(rest);
    let first = words.peek().ok_or("there is nothing")?;
    let mut bus = None;
    if !first.contains(&b'#') {
        words.next();
        bus = Some(str::from_utf8(first).map_err(|_| "its bus has no readable name")?);
    }
    let mut said = None;
    let Some(next) = words.peek() else {
        return Err("it has no #; write ID#DATA, e.g. 123#DEADBEEF".to_owned());
    };
    let mut frame = if next.contains(&b'#') {
        words.next();
        frame(next)?
    } else {
        let (frame, direction) = columns::frame(&mut words)?;
        said = direction;
        frame
    };
    if let Some(word) = words.next() {
        said = Some(word == b"T");
        if !matches!(word, b"T" | b"R") {
            return Err(format!("\"{}\" behind the data means nothing", shown(word)));
        }
    }
    if said == Some(true) {
        frame.flags |= CanFlags::TX;
    }
    Ok(Line { time, bus, frame, has_direction: said.is_some() })
}

/// The time in parentheses that a line may begin with, and what follows.
pub fn time_and_rest(text: &[u8]) -> Result<(Option<Time>, &[u8]), String> {
    let Some(rest) = text.trim_ascii_start().strip_prefix(b"(") else { return Ok((None, text)) };
    let Some(end) = rest.iter().take(64).position(|&byte| byte == b')') else {
        return Ok((None, text));
    };
    Ok((Some(moment(rest[..end].trim_ascii())?), &rest[end + 1..]))
}

fn moment(text: &[u8]) -> Result<Time, String> {
    if let Some(nanos) = crate::import::digits::seconds(text) {
        let whole = text.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let absolute = whole >= DATE_DIGITS;
        return Ok(if absolute { Time::Absolute(Timestamp(nanos)) } else { Time::Relative(nanos) });
    }
    let text = String::from_utf8_lossy(text);
    if text.contains('T') {
        return crate::text::parse_moment(&text, Timestamp(0)).map(Time::Absolute);
    }
    // candump -tA: a date and a time with a blank between them, without a zone.
    let dated = format!("{}Z", text.replacen(' ', "T", 1));
    let read = crate::text::parse_moment(&dated, Timestamp(0));
    read.map(Time::Local).map_err(|_| format!("\"{}\" is no time", text.escape_debug()))
}

/// `ID#DATA`, `ID#R`, `ID#R4`, `ID##<flags>DATA`, `ID#DATA_<dlc>`.
pub fn frame(text: &[u8]) -> Result<CanFrame, String> {
    let hash = text.iter().position(|&byte| byte == b'#').ok_or("it has no #")?;
    let (id, mut flags) = identifier(&text[..hash])?;
    let rest = &text[hash + 1..];
    if let Some(length) = rest.strip_prefix(b"R").or_else(|| rest.strip_prefix(b"r")) {
        // can-utils since 2021 write a raw DLC behind the length of eight: R8_C.
        let (length, raw) = split_raw(length)?;
        let dlc = if length.is_empty() { 0 } else { digit(length, "length")? };
        if dlc > 8 || raw.is_some() && dlc != 8 {
            return Err(format!("a remote frame cannot ask for {dlc} bytes"));
        }
        let flags = flags | CanFlags::REMOTE;
        return Ok(CanFrame::new(id, flags, &[]).with_dlc(raw.unwrap_or(dlc)));
    }
    let Some(rest) = rest.strip_prefix(b"#") else {
        let (data, raw) = split_raw(rest)?;
        let mut bytes = [0; CAN_MAX_DATA];
        let length = data_bytes(data, &mut bytes[..8])?;
        if raw.is_some() && length != 8 {
            return Err("a raw DLC is 9 to F, behind 8 bytes".to_owned());
        }
        return Ok(CanFrame::new(id, flags, &bytes[..length]).with_dlc(raw.unwrap_or(0)));
    };
    let (fd, data) = rest.split_at_checked(1).ok_or("the flags behind ## are missing")?;
    let fd = digit(fd, "flag")?;
    flags |= CanFlags::FD;
    if fd & 1 != 0 {
        flags |= CanFlags::BRS;
    }
    if fd & 2 != 0 {
        flags |= CanFlags::ESI;
    }
    let mut bytes = [0; CAN_MAX_DATA];
    let length = data_bytes(data, &mut bytes)?;
    Ok(CanFrame::new(id, flags, &bytes[..length]))
}

/// What stands before `_`, and the raw DLC of a classic frame behind it.
fn split_raw(text: &[u8]) -> Result<(&[u8], Option<u8>), String> {
    let Some(at) = text.iter().position(|&byte| byte == b'_') else { return Ok((text, None)) };
    let dlc = digit(&text[at + 1..], "DLC")?;
    if dlc < 9 {
        return Err("a raw DLC is 9 to F, behind 8 bytes".to_owned());
    }
    Ok((&text[..at], Some(dlc)))
}

/// Identifier and kind, as the number of digits says.
pub fn identifier(text: &[u8]) -> Result<(u32, CanFlags), String> {
    match (text.len(), hex(text)) {
        (3, Some(id)) if id <= 0x7FF => Ok((id, CanFlags::default())),
        (8, Some(id)) if id <= MAX_EXTENDED => Ok((id, CanFlags::EXTENDED)),
        (8, Some(id)) if id & ERROR_FLAG != 0 && id & !ERROR_FLAG <= MAX_EXTENDED => {
            Ok((id & !ERROR_FLAG, CanFlags::ERROR))
        }
        _ => Err(format!(
            "\"{}\" is no identifier; write 3 hex digits (11 bits) or 8 (29 bits)",
            shown(text)
        )),
    }
}

fn digit(text: &[u8], what: &str) -> Result<u8, String> {
    let value = text.first().filter(|_| text.len() == 1).and_then(|&byte| hex_digit(byte));
    value.ok_or_else(|| format!("\"{}\" is no {what}", shown(text)))
}

/// Pairs of digits, with or without points between them, into `bytes`. Returns how many.
fn data_bytes(text: &[u8], bytes: &mut [u8]) -> Result<usize, String> {
    let mut digits = text.iter().copied().filter(|byte| *byte != b'.');
    let mut length = 0;
    while let Some(high) = digits.next() {
        let pair = digits.next().and_then(|low| hex_pair(high, low));
        let value = pair.ok_or("its data are not pairs of hex digits")?;
        if let Some(byte) = bytes.get_mut(length) {
            *byte = value;
        }
        length += 1;
    }
    if length > bytes.len() {
        return Err(format!("{length} bytes are too many; the most are {}", bytes.len()));
    }
    Ok(length)
}
