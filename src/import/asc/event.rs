//! One event of an ASC log: what stands behind its time.

use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, FD_LENGTHS};
use crate::import::digits::{Words, decimal, hex, shown};

/// `CAN_ERR_BUSERROR` of `linux/can/error.h`: all that is certain of an error frame.
const BUS_ERROR: u32 = 0x80;
/// Flags of the column behind the length of a `CANFD` event (specification 1.4.6, section 3.4.2).
const FLAG_RTR: u32 = 0x10;
const FLAG_EDL: u32 = 0x1000;

/// What a line is.
pub enum Event {
    /// A CAN frame.
    Frame(Taken),
    /// Something else.
    Other,
    /// Should be a CAN frame, but cannot be taken.
    Broken(String),
}

/// A frame and the number of its channel.
pub struct Taken {
    /// From 1.
    pub channel: u64,
    /// The frame.
    pub frame: CanFrame,
}

/// Reads the words behind the time.
pub fn read(mut words: Words<'_>, base10: bool) -> Event {
    let Some(first) = words.next() else { return Event::Other };
    let found = if first.eq_ignore_ascii_case(b"CANFD") {
        let Some(channel) = words.next().and_then(decimal) else {
            return Event::Broken("the channel behind CANFD is missing".to_owned());
        };
        flexible(words, base10).map(|found| found.map(|frame| Taken { channel, frame }))
    } else {
        let Some(channel) = decimal(first) else { return Event::Other };
        classic(words, base10).map(|found| found.map(|frame| Taken { channel, frame }))
    };
    match found {
        Ok(Some(taken)) => Event::Frame(taken),
        Ok(None) => Event::Other,
        Err(why) => Event::Broken(why),
    }
}

fn error_frame() -> CanFrame {
    CanFrame::new(BUS_ERROR, CanFlags::ERROR, &[0; 8])
}

/// `390x Rx d 8 17 00 ...`, `390 Tx r 4`, `ErrorFrame`.
fn classic(mut words: Words<'_>, base10: bool) -> Result<Option<CanFrame>, String> {
    let id = words.next().ok_or("nothing stands behind the channel")?;
    if id.eq_ignore_ascii_case(b"ErrorFrame") {
        return Ok(Some(error_frame()));
    }
    let Some(sent) = direction(words.next().unwrap_or_default()) else {
        // A cut line, where an identifier can be seen; another event (statistics, J1939TP) else.
        let cut = number(id, base10).is_some() && words.next().is_none();
        return if cut { Err("it ends behind the identifier".to_owned()) } else { Ok(None) };
    };
    let Some(tx) = sent else { return Ok(None) };
    let kind = words.next().unwrap_or_default();
    let frame = match kind.to_ascii_lowercase().as_slice() {
        b"r" => {
            // Tools before 2014 leave out the length.
            let dlc = words.peek().and_then(|word| number(word, base10)).filter(|dlc| *dlc <= 15);
            words.next();
            remote(tx, dlc.unwrap_or(0))
        }
        b"d" => data(&mut words, base10, tx)?,
        _ => return Err(format!("\"{}\" is neither d nor r", shown(kind))),
    };
    named(frame, id, words, base10).map(Some)
}

/// `Rx 7d [BrakeSnData_4] 1 0 8 8 01 1b ... duration length flags crc ...`.
fn flexible(mut words: Words<'_>, base10: bool) -> Result<Option<CanFrame>, String> {
    let Some(sent) = direction(words.next().unwrap_or_default()) else {
        return Err("Rx or Tx is missing".to_owned());
    };
    let Some(mut flags) = sent else { return Ok(None) };
    let id = words.next().ok_or("the identifier is missing")?;
    if id.eq_ignore_ascii_case(b"ErrorFrame") {
        return Ok(Some(error_frame()));
    }
    // Between the identifier and the bit rate switch may stand the name of the message.
    let bit = |word: &[u8]| match word {
        b"0" => Some(false),
        b"1" => Some(true),
        _ => None,
    };
    let mut switch = words.next().and_then(bit);
    if switch.is_none() {
        switch = words.next().and_then(bit);
    }
    let switch = switch.ok_or("the bit rate switch is neither 0 nor 1")?;
    let indicator = words.next().and_then(bit).ok_or("the error state is neither 0 nor 1")?;
    let dlc = words.next().and_then(hex).filter(|dlc| *dlc <= 15).ok_or("the DLC is missing")?;
    let length = words.next().and_then(decimal).filter(|length| *length <= 64);
    let length = length.ok_or("the length is not 0 to 64")?;
    #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
    let length = length as usize;
    let mut data = [0; CAN_MAX_DATA];
    take_bytes(&mut words, base10, &mut data[..length])?;
    let about = words.clone().nth(2).and_then(hex);
    // Classic frames of a CAN FD channel are written in this form too.
    let fd = match about {
        _ if switch || indicator || length > 8 => true,
        Some(about) => about & FLAG_EDL != 0,
        None => length > 0 || dlc == 0,
    };
    // Seen in logs: remote requests with the bit rate switch of the channel.
    let asked = !fd && about.is_some_and(|about| about & FLAG_RTR != 0) || length == 0 && dlc > 0;
    if asked {
        return named(remote(flags, dlc), id, words, base10).map(Some);
    }
    for (flag, set) in [(CanFlags::FD, fd), (CanFlags::BRS, switch), (CanFlags::ESI, indicator)] {
        flags |= if set { flag } else { CanFlags::default() };
    }
    let frame = CanFrame::new(0, flags, &data[..length]);
    #[allow(clippy::cast_possible_truncation, reason = "9 to 15")]
    let frame = if !fd && dlc > 8 { frame.with_dlc(dlc as u8) } else { frame };
    named(frame, id, words, base10).map(Some)
}

/// A remote frame that asks for this much.
fn remote(flags: CanFlags, dlc: u32) -> CanFrame {
    let dlc = u8::try_from(dlc).unwrap_or(15).min(15);
    CanFrame::new(0, flags | CanFlags::REMOTE, &[]).with_dlc(dlc)
}

/// What stands behind `d`: length and bytes.
fn data(words: &mut Words<'_>, base10: bool, flags: CanFlags) -> Result<CanFrame, String> {
    let mut bytes = [0; CAN_MAX_DATA];
    let missing = "the length behind d is missing";
    let word = words.next().ok_or(missing)?;
    let said = number(word, base10).ok_or(missing)?;
    let (length, kind, raw) = match said {
        0..=8 => (said as usize, CanFlags::default(), 0),
        _ => long(word, said, followers(words, base10))?,
    };
    take_bytes(words, base10, &mut bytes[..length])?;
    Ok(CanFrame::new(0, flags | kind, &bytes[..length]).with_dlc(raw))
}

/// Length, kind and raw DLC of a frame that says more than 8 and has `there` bytes. Tools that know
/// no `CANFD` events (CSS Electronics' `mdf2asc`, older python-can) write CAN FD frames as classic
/// ones, with the DLC in decimal, or with the length in the base of the log: what is meant is what
/// fits the bytes that are there.
fn long(word: &[u8], said: u32, there: usize) -> Result<(usize, CanFlags, u8), String> {
    let by_dlc = |dlc: u64| FD_LENGTHS.get(usize::try_from(dlc).ok()?).map(|n| usize::from(*n));
    let lengths = [by_dlc(said.into()), decimal(word).and_then(by_dlc), Some(said as usize)];
    let length = lengths.into_iter().flatten().find(|length| *length == there);
    match length {
        Some(length) if FD_LENGTHS.contains(&u8::try_from(length).unwrap_or(u8::MAX)) => {
            Ok((length, CanFlags::FD, 0))
        }
        _ if said <= 15 && there == 8 => {
            Ok((8, CanFlags::default(), u8::try_from(said).unwrap_or(15)))
        }
        _ => Err(format!("its {there} bytes are not as many as {} says", shown(word))),
    }
}

/// How many bytes stand in front, at most as many as a frame can have.
fn followers(words: &Words<'_>, base10: bool) -> usize {
    let is_byte = |word: &&[u8]| number(word, base10).is_some_and(|value| value < 256);
    words.clone().take(CAN_MAX_DATA).take_while(is_byte).count()
}

/// The frame with its identifier: `390`, `18EBFF00x`, or the name of a message, where the number
/// stands at the end of the line (`ID = 291`).
fn named(
    frame: CanFrame,
    id: &[u8],
    mut rest: Words<'_>,
    base10: bool,
) -> Result<CanFrame, String> {
    let found = identifier(id, base10).or_else(|| {
        rest.find(|word| *word == b"ID")?;
        rest.accept(b"=").then(|| identifier(rest.next()?, true)).flatten()
    });
    let (id, extended) = found.ok_or_else(|| format!("\"{}\" is no identifier", shown(id)))?;
    let flags = if extended { frame.flags | CanFlags::EXTENDED } else { frame.flags };
    Ok(CanFrame::new(id, flags, frame.data()).with_dlc(frame.dlc))
}

fn identifier(text: &[u8], base10: bool) -> Option<(u32, bool)> {
    let (digits, extended) = match text {
        [digits @ .., b'x' | b'X'] => (digits, true),
        digits => (digits, false),
    };
    let id = number(digits, base10)?;
    (id <= if extended { 0x1FFF_FFFF } else { 0x7FF }).then_some((id, extended))
}

fn number(text: &[u8], base10: bool) -> Option<u32> {
    if base10 { decimal(text).and_then(|value| u32::try_from(value).ok()) } else { hex(text) }
}

/// `None` for no direction at all, an inner `None` for what was not on the bus.
fn direction(word: &[u8]) -> Option<Option<CanFlags>> {
    match word.to_ascii_lowercase().as_slice() {
        b"rx" => Some(Some(CanFlags::default())),
        b"tx" => Some(Some(CanFlags::TX)),
        // The request to send: the frame itself follows as Tx.
        b"txrq" | b"txrequest" => Some(None),
        _ => None,
    }
}

fn take_bytes(words: &mut Words<'_>, base10: bool, data: &mut [u8]) -> Result<(), String> {
    let wanted = data.len();
    for byte in data {
        let word = words.next().ok_or_else(|| format!("it ends before its {wanted} bytes do"))?;
        let value = number(word, base10).and_then(|value| u8::try_from(value).ok());
        *byte = value.ok_or_else(|| format!("\"{}\" is no byte", shown(word)))?;
    }
    Ok(())
}
