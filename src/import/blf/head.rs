//! The file's statistics: 144 bytes in front of the objects.

use jiff::civil::{Date, Time};
use jiff::tz::TimeZone;

use crate::import::ImportError;
use crate::import::little_endian::{u16_at, u32_at, u64_at};

/// What all files have of it; the rest is reserved.
pub(super) const LEAST: usize = 72;
/// What all known writers write of it.
const USUAL: u32 = 144;
/// Longer than any known.
const MOST: u32 = 1 << 20;

/// What the statistics say. Only the start is needed; recorders that were cut off leave the rest as
/// it was at the beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    /// Where the objects begin, bytes.
    pub objects_at: u64,
    /// How long the file should be, bytes.
    pub file_size: u64,
    /// How many objects it should have.
    pub objects: u32,
    /// Start of the measurement, nanoseconds since 1970 (UTC); `None` when it is not set.
    pub start: Option<u64>,
}

/// Reads the first bytes of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<Head, ImportError> {
    let fields = || {
        let size = u32_at(bytes, 4)?;
        let known = (u32::try_from(LEAST).ok()?..=MOST).contains(&size);
        Some(Head {
            objects_at: u64::from(if known { size } else { USUAL }),
            file_size: u64_at(bytes, 16)?,
            objects: u32_at(bytes, 32)?,
            start: system_time(bytes.get(40..56)?),
        })
    };
    if !bytes.starts_with(b"LOGG") {
        return Err(ImportError::Format("it is no BLF log: it does not begin with LOGG".into()));
    }
    fields().ok_or_else(|| {
        let length = bytes.len();
        let text = format!("it is no whole BLF log: it has {length} bytes, the head alone has 144");
        ImportError::Format(text)
    })
}

/// A SYSTEMTIME: year, month, day of the week, day, hour, minute, second, millisecond. The format
/// does not say in which time zone; it is read as UTC, as other readers do.
fn system_time(bytes: &[u8]) -> Option<u64> {
    let field = |index: usize| u16_at(bytes, 2 * index);
    let small = |index: usize| i8::try_from(field(index)?).ok();
    let year = i16::try_from(field(0)?).ok().filter(|year| *year >= 1970)?;
    let nanos = i32::from(field(7)?.min(999)) * 1_000_000;
    let date = Date::new(year, small(1)?, small(3)?).ok()?;
    let time = Time::new(small(4)?, small(5)?, small(6)?, nanos).ok()?;
    let stamp = date.to_datetime(time).to_zoned(TimeZone::UTC).ok()?.timestamp();
    u64::try_from(stamp.as_nanosecond()).ok()
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    fn head(start: [u16; 8]) -> Vec<u8> {
        let mut bytes = b"LOGG\x90\0\0\0".to_vec();
        bytes.resize(40, 0);
        bytes.extend(start.into_iter().flat_map(u16::to_le_bytes));
        bytes.resize(144, 0);
        bytes
    }

    #[test]
    fn the_start_is_read_as_utc_and_an_odd_one_is_none() {
        let start = parse(&head([2026, 11, 0, 22, 3, 15, 0, 250])).unwrap().start;
        let expected = date(2026, 11, 22).at(3, 15, 0, 250_000_000).to_zoned(TimeZone::UTC);
        let expected = expected.unwrap().timestamp().as_nanosecond();
        assert_eq!(start.map(i128::from), Some(expected));
        for odd in [[0; 8], [2026, 13, 0, 1, 0, 0, 0, 0], [65535; 8], [1601, 1, 1, 1, 0, 0, 0, 0]] {
            assert_eq!(parse(&head(odd)).unwrap().start, None);
        }
    }

    #[test]
    fn a_head_that_lies_about_its_size_has_the_usual_one() {
        let mut bytes = head([0; 8]);
        bytes[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(parse(&bytes).unwrap().objects_at, 144);
        assert!(parse(&bytes[..30]).is_err());
    }
}
