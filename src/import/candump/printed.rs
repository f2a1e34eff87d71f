//! What `bustape cat` prints beside CAN frames: serial bytes, gaps, line errors.

use crate::frame::{
    Direction, Gap, GapReason, LineError, LineErrorKind, SerialBytes, Timestamp, Unit,
};
use crate::import::digits::{Words, hex_pair};

/// `rect rx  7E 00 01   |~..|`: the name of the line and the bytes.
pub fn serial(text: &[u8]) -> Option<(&str, SerialBytes)> {
    let mut words = Words(text);
    let bus = str::from_utf8(words.next()?).ok()?;
    let direction = match words.next()? {
        b"rx" => Direction::Rx,
        b"tx" => Direction::Tx,
        _ => return None,
    };
    Some((bus, SerialBytes { direction, data: row(words)?, errors: Vec::new() }))
}

/// The bytes of a row that goes on with the one above it.
pub fn continued(text: &[u8]) -> Option<Vec<u8>> {
    // A time of any style, a bus and a direction are longer than this.
    text.starts_with(b"          ").then(|| row(Words(text)))?
}

/// Bytes up to the column that shows them as text.
fn row(words: Words<'_>) -> Option<Vec<u8>> {
    let mut data = Vec::new();
    for word in words {
        match *word {
            [b'|', ..] => return Some(data),
            [high, low] => data.push(hex_pair(high, low)?),
            _ => return None,
        }
    }
    (!data.is_empty()).then_some(data)
}

/// `gap: can0 lost 12 frames (kernel_queue) from A to B`.
pub fn gap(text: &[u8]) -> Option<(&str, Gap)> {
    let text = str::from_utf8(text).ok()?.strip_prefix("gap: ")?;
    let (bus, rest) = text.split_once(" lost ")?;
    let (count, rest) = if let Some(rest) = rest.strip_prefix("an unknown number of ") {
        (0, rest)
    } else {
        let (count, rest) = rest.split_once(' ')?;
        (count.parse().ok()?, rest)
    };
    let (unit, rest) = rest.split_once(" (")?;
    let unit = if unit == "bytes" { Unit::Bytes } else { Unit::Frames };
    let (reason, rest) = rest.split_once(") from ")?;
    let reason = match reason {
        "recorder_queue" => GapReason::RecorderQueue,
        "link_down" => GapReason::LinkDown,
        "overrun" => GapReason::Overrun,
        "adapter" => GapReason::Adapter,
        "disk" => GapReason::Disk,
        "window_memory" => GapReason::WindowMemory,
        _ => GapReason::KernelQueue,
    };
    let (from, to) = rest.split_once(" to ")?;
    let time = |text: &str| crate::text::parse_moment(text, Timestamp(0)).ok();
    Some((bus, Gap { count, unit, reason, from: time(from)?, to: time(to)? }))
}

/// `rect: parity error at byte 1`.
pub fn line_error(text: &[u8]) -> Option<LineError> {
    let text = str::from_utf8(text).ok()?;
    let (_, rest) = text.split_once(": ")?;
    let (kind, offset) = rest.split_once(" at byte ")?;
    let kind = match kind {
        "parity error" => LineErrorKind::Parity,
        "framing error" => LineErrorKind::Framing,
        "parity or framing error" => LineErrorKind::ParityOrFraming,
        "break" => LineErrorKind::Break,
        "overrun" => LineErrorKind::Overrun,
        _ => return None,
    };
    Some(LineError { offset: offset.parse().ok()?, kind })
}
