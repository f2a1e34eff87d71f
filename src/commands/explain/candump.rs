//! Reads frames as candump writes them (can-utils, `lib.c`, `parse_canframe`).

use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, Timestamp};
use crate::text::parse_moment;

/// `CAN_ERR_FLAG` of `linux/can.h`, in the identifier of an error frame.
const ERROR_FLAG: u32 = 0x2000_0000;
/// Largest 29-bit identifier.
const MAX_EXTENDED: u32 = 0x1FFF_FFFF;

/// One line of a log.
#[derive(Debug, PartialEq)]
pub struct Line<'a> {
    /// When, if the line says so.
    pub time: Option<Timestamp>,
    /// Which bus, if the line says so.
    pub bus: Option<&'a str>,
    /// The frame; `TX` is set when the line ends in `T`.
    pub frame: CanFrame,
    /// The line says which way the frame went.
    pub has_direction: bool,
}

/// Reads `FRAME`, `BUS FRAME`, `(TIME) BUS FRAME` or `(TIME) BUS FRAME R`, or a line of candump's
/// other format, `(TIME) BUS ID [LENGTH] BYTES`.
pub fn line(text: &str) -> Result<Line<'_>, String> {
    let (time, rest) = match text.strip_prefix('(').and_then(|rest| rest.split_once(')')) {
        Some((time, rest)) => (Some(moment(time.trim())?), rest),
        None => (None, text),
    };
    let mut words = rest.split_ascii_whitespace().peekable();
    let mut first = words.next().ok_or("there is nothing")?;
    let mut bus = None;
    if !first.contains('#') {
        bus = Some(first);
        first = words.next().ok_or("it has no #; write ID#DATA, e.g. 123#DEADBEEF")?;
    }
    let mut frame = if first.contains('#') { frame(first)? } else { columns(first, &mut words)? };
    let direction = words.next();
    match direction {
        Some("T") => frame.flags |= CanFlags::TX,
        Some("R") | None => {}
        Some(word) => return Err(format!("\"{word}\" behind the data means nothing")),
    }
    Ok(Line { time, bus, frame, has_direction: direction.is_some() })
}

fn moment(text: &str) -> Result<Timestamp, String> {
    // candump -tA: a date and a time with a blank between them, without a zone.
    let dated = text.contains('-').then(|| format!("{}Z", text.replacen(' ', "T", 1)));
    parse_moment(dated.as_deref().unwrap_or(text), Timestamp(0))
}

/// `ID#DATA`, `ID#R`, `ID#R4`, `ID##<flags>DATA`, `ID#DATA_<dlc>`.
pub fn frame(text: &str) -> Result<CanFrame, String> {
    let (id, rest) = text.split_once('#').ok_or("it has no #")?;
    let (id, mut flags) = identifier(id)?;
    if let Some(length) = rest.strip_prefix(['R', 'r']) {
        let dlc = if length.is_empty() { 0 } else { digit(length, "length")? };
        if dlc > 8 {
            return Err(format!("a remote frame cannot ask for {dlc} bytes"));
        }
        return Ok(CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc));
    }
    let Some(rest) = rest.strip_prefix('#') else {
        let (data, dlc) = match rest.split_once('_') {
            Some((data, dlc)) => (data, digit(dlc, "DLC")?),
            None => (rest, 0),
        };
        let data = bytes(data, 8)?;
        if dlc != 0 && (dlc < 9 || data.len() != 8) {
            return Err("a raw DLC is 9 to F, behind 8 bytes".to_owned());
        }
        return Ok(CanFrame::new(id, flags, &data).with_dlc(dlc));
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
    Ok(CanFrame::new(id, flags, &bytes(data, CAN_MAX_DATA)?))
}

/// `ID [LENGTH] BYTES` or `ID [LENGTH] remote request`; a length of two digits is CAN FD.
fn columns<'a>(
    id: &str,
    words: &mut std::iter::Peekable<impl Iterator<Item = &'a str>>,
) -> Result<CanFrame, String> {
    let (id, mut flags) = identifier(id)?;
    let length = words.next().and_then(|word| word.strip_prefix('[')?.strip_suffix(']'));
    let length = length.ok_or("it has no #; write ID#DATA, e.g. 123#DEADBEEF")?;
    let declared: usize = length.parse().map_err(|_| format!("[{length}] is no length"))?;
    if words.next_if_eq(&"remote").is_some() {
        words.next_if_eq(&"request");
        let dlc = u8::try_from(declared.min(8)).unwrap_or(8);
        return Ok(CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc));
    }
    if length.len() == 2 {
        flags |= CanFlags::FD;
    }
    let mut hex = String::new();
    while hex.len() < 2 * declared.min(CAN_MAX_DATA) {
        hex.push_str(words.next().ok_or("there are fewer bytes than it says")?);
    }
    // candump -a, -e: the data as text, or what an error frame means.
    while words.next_if(|word| !matches!(*word, "R" | "T")).is_some() {}
    Ok(CanFrame::new(id, flags, &bytes(&hex, CAN_MAX_DATA)?))
}

fn identifier(text: &str) -> Result<(u32, CanFlags), String> {
    let hex = text.bytes().all(|byte| byte.is_ascii_hexdigit());
    let number = u32::from_str_radix(text, 16).ok().filter(|_| hex);
    match (text.len(), number) {
        (3, Some(id)) if id <= 0x7FF => Ok((id, CanFlags::default())),
        (8, Some(id)) if id <= MAX_EXTENDED => Ok((id, CanFlags::EXTENDED)),
        (8, Some(id)) if id & ERROR_FLAG != 0 && id & !ERROR_FLAG <= MAX_EXTENDED => {
            Ok((id & !ERROR_FLAG, CanFlags::ERROR))
        }
        _ => {
            Err(format!("\"{text}\" is no identifier; write 3 hex digits (11 bits) or 8 (29 bits)"))
        }
    }
}

fn digit(text: &str, what: &str) -> Result<u8, String> {
    u8::from_str_radix(text, 16)
        .ok()
        .filter(|_| text.len() == 1)
        .ok_or_else(|| format!("\"{text}\" is no {what}"))
}

fn bytes(text: &str, most: usize) -> Result<Vec<u8>, String> {
    let digits: Vec<u8> = text.bytes().filter(|byte| *byte != b'.').collect();
    let pairs = digits.chunks(2).map(|pair| {
        let pair = str::from_utf8(pair).ok().filter(|pair| pair.len() == 2)?;
        let hex = pair.bytes().all(|byte| byte.is_ascii_hexdigit());
        u8::from_str_radix(pair, 16).ok().filter(|_| hex)
    });
    let data: Option<Vec<u8>> = pairs.collect();
    let data = data.ok_or("its data are not pairs of hex digits")?;
    if data.len() > most {
        return Err(format!("{} bytes are too many; the most are {most}", data.len()));
    }
    Ok(data)
}
