//! The format that candump prints for people: `can0  123   [3]  11 22 33   '.."'` and its relatives
//! (can-utils, `lib.c`, `sprint_long_canframe`, releases from 2007 to 2025).

use super::line::MAX_EXTENDED;
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame};
use crate::import::digits::{Words, decimal, hex, hex_digit, hex_pair, shown};

/// Columns of an identifier of 29 bits; one of 11 bits has three. Before 2010 candump filled them
/// with blanks, not with zeros.
const LONG: usize = 8;
const ERROR_FLAG: u32 = 0x2000_0000;

/// Reads what stands behind the bus; also the direction if `-x` wrote one.
pub fn frame(words: &mut Words<'_>) -> Result<(CanFrame, Option<bool>), String> {
    let mut direction = None;
    let mut said = CanFlags::default();
    let mut columns = words.0;
    if let Some(word @ (b"TX" | b"RX")) = words.peek() {
        words.next();
        direction = Some(word == b"TX");
        for (letter, flag) in [(b"B", CanFlags::BRS), (b"E", CanFlags::ESI)] {
            if words.accept(letter) {
                said |= flag;
            } else if !words.accept(b"-") {
                return Err("behind RX or TX stand B or -, and E or -".to_owned());
            }
        }
        columns = words.0;
    }
    let id = words.next().unwrap_or_default();
    let blanks = columns.len() - columns.trim_ascii_start().len();
    let (id, mut flags) = identifier(id, blanks)?;
    let length = words.next().unwrap_or_default();
    let (length, kind) = match length {
        [b'[', inner @ .., b']'] if inner.len() == 2 => (inner, CanFlags::FD),
        [b'[', inner @ .., b']'] => (inner, CanFlags::default()),
        [b'{', inner @ .., b'}'] if inner.len() == 1 => {
            return raw_dlc(id, flags, inner, words, direction);
        }
        _ => return Err("it has no #; write ID#DATA, e.g. 123#DEADBEEF".to_owned()),
    };
    let declared = decimal(length).and_then(|count| usize::try_from(count).ok());
    let declared = declared.filter(|count| *count <= CAN_MAX_DATA);
    let declared = declared.ok_or_else(|| format!("[{}] is no length", shown(length)))?;
    if words.accept(b"remote") {
        words.accept(b"request");
        let dlc = u8::try_from(declared.min(8)).unwrap_or(8);
        return Ok((CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc), direction));
    }
    flags |= kind;
    if kind == CanFlags::FD {
        flags |= said;
    } else if declared > 8 {
        return Err(format!("{declared} bytes are too many; the most are 8"));
    }
    let mut data = [0; CAN_MAX_DATA];
    bytes(words, &mut data[..declared])?;
    Ok((CanFrame::new(id, flags, &data[..declared]), direction))
}

/// `123  {C}  11 22 33 44 55 66 77 88`: candump -8 shows a raw DLC of 9 to 15.
fn raw_dlc(
    id: u32,
    flags: CanFlags,
    dlc: &[u8],
    words: &mut Words<'_>,
    direction: Option<bool>,
) -> Result<(CanFrame, Option<bool>), String> {
    let dlc = hex_digit(dlc[0]).filter(|dlc| *dlc > 8).ok_or("a raw DLC is 9 to F")?;
    if words.accept(b"remote") {
        words.accept(b"request");
        return Ok((CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc), direction));
    }
    let mut data = [0; 8];
    bytes(words, &mut data)?;
    Ok((CanFrame::new(id, flags, &data).with_dlc(dlc), direction))
}

fn identifier(text: &[u8], blanks: usize) -> Result<(u32, CanFlags), String> {
    let value = hex(text).ok_or_else(|| {
        format!("\"{}\" is no identifier; write 3 hex digits (11 bits) or 8 (29 bits)", shown(text))
    })?;
    // Two blanks part the columns.
    let width = (blanks + text.len()).saturating_sub(2);
    let long = text.len() == LONG || width == LONG;
    match value {
        _ if long && value & ERROR_FLAG != 0 && value & !ERROR_FLAG <= MAX_EXTENDED => {
            Ok((value & !ERROR_FLAG, CanFlags::ERROR))
        }
        0..=MAX_EXTENDED if long => Ok((value, CanFlags::EXTENDED)),
        0..=0x7FF => Ok((value, CanFlags::default())),
        _ => Err(format!("\"{}\" is no identifier of 11 bits", shown(text))),
    }
}

/// Data in hexadecimal, in binary digits (`-i`), or from last to first (`-S`), then what people may
/// like to see beside them (`-a`, `-e`).
fn bytes(words: &mut Words<'_>, data: &mut [u8]) -> Result<(), String> {
    let fewer = || "there are fewer bytes than it says".to_owned();
    let mut found = 0;
    while found < data.len() {
        let word = words.next().ok_or_else(fewer)?;
        let swapped = word.contains(&b'`');
        for part in word.split(|&byte| byte == b'`') {
            let value = match *part {
                [high, low] => hex_pair(high, low),
                [_, _, _, _, _, _, _, _] => binary(part),
                _ => None,
            };
            let value = value.ok_or_else(|| format!("\"{}\" is no byte", shown(part)))?;
            *data.get_mut(found).ok_or_else(fewer)? = value;
            found += 1;
        }
        if swapped {
            data.reverse();
        }
    }
    // What stands behind the data is a comment, unless it is the direction.
    let last = words.0.rsplit(|&byte| byte == b' ').next();
    words.0 = last.filter(|word| matches!(*word, b"R" | b"T")).unwrap_or_default();
    Ok(())
}

fn binary(digits: &[u8]) -> Option<u8> {
    digits.iter().try_fold(0, |value: u8, digit| match digit {
        b'0' => Some(value << 1),
        b'1' => Some(value << 1 | 1),
        _ => None,
    })
}
