//! Days and hours, by which an export may begin new files.

use crate::frame::Timestamp;

const HOUR: u64 = 3_600_000_000_000;

/// How an export is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Not at all.
    Never,
    /// At midnight, UTC.
    Day,
    /// At each full hour.
    Hour,
}

impl Split {
    /// Number of the day or hour since 1970.
    pub fn number(self, time: Timestamp) -> u64 {
        match self {
            Self::Never => 0,
            Self::Day => time.nanos() / (24 * HOUR),
            Self::Hour => time.nanos() / HOUR,
        }
    }

    /// Its name in file names, `2026-11-22` or `2026-11-22T03`; empty when nothing is cut.
    pub fn name(self, number: u64) -> String {
        let length = match self {
            Self::Never => return String::new(),
            Self::Day => 24 * HOUR,
            Self::Hour => HOUR,
        };
        let text = crate::text::rfc3339(Timestamp(number.saturating_mul(length)));
        let end = if self == Self::Day { 10 } else { 13 };
        text.get(..end).unwrap_or_default().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_are_those_of_utc() {
        let time = Timestamp(1_700_006_399_999_999_999);
        assert_eq!(Split::Day.name(Split::Day.number(time)), "2023-11-14");
        assert_eq!(Split::Hour.name(Split::Hour.number(time)), "2023-11-14T23");
        assert_eq!(Split::Day.name(Split::Day.number(time.plus(1))), "2023-11-15");
        assert_eq!(Split::Never.name(Split::Never.number(time)), "");
    }
}
