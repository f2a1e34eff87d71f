//! Entries as bytes, little endian: a tag, then what the tag says. Nothing of this leaves the process.

use crate::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes, Stamped, Timestamp};
use crate::queue::{BusIndex, Item};
use crate::record::entry::Entry;

/// Set in the tag of what is in a window already.
const MARKED: u8 = 0x80;
/// bus (u16), time (u64), id (u32), flags, DLC, length, data.
const CAN: u8 = 1;
/// bus (u16), time (u64), direction, length (u32), data; without line errors.
const SERIAL: u8 = 2;
/// Stands elsewhere.
const OTHER: u8 = 3;

/// What was found.
pub enum Unpacked {
    /// The entry.
    Entry(Entry),
    /// It stands elsewhere.
    Other,
}

/// Appends `entry`. False if only its place is taken, and it has to stand elsewhere.
pub fn pack(entry: &Entry, out: &mut Vec<u8>) -> bool {
    if let Entry::Frame(Item { bus, frame: Stamped { time, value } }) = entry {
        match value {
            Frame::Can(frame) => {
                head(CAN, *bus, *time, out);
                out.extend_from_slice(&frame.id.to_le_bytes());
                #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
                out.extend_from_slice(&[frame.flags.0, frame.dlc, frame.data().len() as u8]);
                out.extend_from_slice(frame.data());
                return true;
            }
            Frame::Serial(bytes) if bytes.errors.is_empty() => {
                if let Ok(length) = u32::try_from(bytes.data.len()) {
                    head(SERIAL, *bus, *time, out);
                    out.push(u8::from(bytes.direction == Direction::Tx));
                    out.extend_from_slice(&length.to_le_bytes());
                    out.extend_from_slice(&bytes.data);
                    return true;
                }
            }
            Frame::Serial(_) | Frame::Gap(_) | Frame::Notice(_) => {}
        }
    }
    out.push(OTHER);
    false
}

fn head(tag: u8, bus: BusIndex, time: Timestamp, out: &mut Vec<u8>) {
    out.push(tag);
    out.extend_from_slice(&bus.to_le_bytes());
    out.extend_from_slice(&time.nanos().to_le_bytes());
}

/// The first entry, whether it is marked, and how many bytes it takes.
pub fn unpack(bytes: &[u8]) -> Option<(Unpacked, bool, usize)> {
    let mut rest = bytes;
    let tag = u8::from_le_bytes(take(&mut rest)?);
    if tag & !MARKED == OTHER {
        return Some((Unpacked::Other, tag & MARKED != 0, 1));
    }
    let bus = u16::from_le_bytes(take(&mut rest)?);
    let time = Timestamp(u64::from_le_bytes(take(&mut rest)?));
    let value = if tag & !MARKED == CAN {
        let id = u32::from_le_bytes(take(&mut rest)?);
        let [flags, dlc, length] = take(&mut rest)?;
        let data = rest.split_off(..usize::from(length))?;
        Frame::Can(CanFrame::new(id, CanFlags(flags), data).with_dlc(dlc))
    } else {
        let [direction] = take(&mut rest)?;
        let length = usize::try_from(u32::from_le_bytes(take(&mut rest)?)).ok()?;
        let direction = if direction == 1 { Direction::Tx } else { Direction::Rx };
        let data = rest.split_off(..length)?.to_vec();
        Frame::Serial(SerialBytes { direction, data, errors: Vec::new() })
    };
    let entry = Entry::Frame(Item { bus, frame: Stamped { time, value } });
    Some((Unpacked::Entry(entry), tag & MARKED != 0, bytes.len() - rest.len()))
}

/// Marks the entry that begins at `at`, or takes its mark away.
pub fn mark(bytes: &mut [u8], at: usize, on: bool) {
    if let Some(tag) = bytes.get_mut(at) {
        *tag = if on { *tag | MARKED } else { *tag & !MARKED };
    }
}

fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*first)
}
