//! Times, sizes and durations as people write and read them.

pub mod candump;
pub mod hex;

use std::time::Duration;

use crate::frame::Timestamp;

/// `20261122T031500Z`: sortable, without colons, for file names.
pub fn compact_utc(time: Timestamp) -> String {
    utc(time).strftime("%Y%m%dT%H%M%SZ").to_string()
}

/// Reads what [`compact_utc`] writes.
pub fn parse_compact_utc(text: &str) -> Option<Timestamp> {
    let time = jiff::civil::DateTime::strptime("%Y%m%dT%H%M%SZ", text).ok()?;
    let time = time.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    u64::try_from(time.as_nanosecond()).ok().map(Timestamp)
}

/// RFC 3339 with nanoseconds: `2026-11-22T03:15:00.123456789Z`.
pub fn rfc3339(time: Timestamp) -> String {
    format!("{:.9}", utc(time))
}

/// RFC 3339 to the millisecond, for tables.
pub fn rfc3339_millis(time: Timestamp) -> String {
    format!("{:.3}", utc(time))
}

/// `2026-11-22 03:15:00`, as candump prints dates.
pub fn date_and_time(time: Timestamp) -> String {
    utc(time).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

/// `Tue Nov 14 10:13:20.000 pm 2023`, as Vector's tools print dates, to the millisecond.
pub fn asc_date(time: Timestamp) -> String {
    let millis = time.nanos() / 1_000_000 % 1000;
    utc(time).strftime(&format!("%a %b %d %I:%M:%S.{millis:03} %P %Y")).to_string()
}

/// A moment: RFC 3339, seconds since 1970, or `+1m30s` after `origin`.
pub fn parse_moment(text: &str, origin: Timestamp) -> Result<Timestamp, String> {
    let nanos = |duration: Duration| u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
    if let Some(offset) = text.strip_prefix('+') {
        return parse_duration(offset).map(|after| origin.plus(nanos(after)));
    }
    if let Some(since_1970) = bare_seconds(text) {
        return Ok(Timestamp(nanos(since_1970)));
    }
    let time: Result<jiff::Timestamp, _> = text.parse();
    time.ok().and_then(|time| u64::try_from(time.as_nanosecond()).ok()).map(Timestamp).ok_or_else(
        || {
            format!(
                "\"{text}\" is not a time; write it like 2026-11-22T03:15:00Z, 1782097200.5 or \
                 +1m30s (after the start of the recording)"
            )
        },
    )
}

fn utc(time: Timestamp) -> jiff::Timestamp {
    // The range ends in the year 2262, inside what the library can show.
    let nanos = i128::from(time.nanos());
    jiff::Timestamp::from_nanosecond(nanos).unwrap_or(jiff::Timestamp::UNIX_EPOCH)
}

/// A duration such as `90s`, `1m30s`, `200ms`, `8h`; a bare number is seconds.
pub fn parse_duration(text: &str) -> Result<Duration, String> {
    let help = || format!("\"{text}\" is not a duration; write it like 200ms, 90s, 1m30s or 8h");
    if let Some(duration) = bare_seconds(text) {
        return Ok(duration);
    }
    let duration: jiff::SignedDuration = text.parse().map_err(|_| help())?;
    Duration::try_from(duration).map_err(|_| help())
}

/// Seconds with up to nine decimals, exactly: a float would lose nanoseconds.
fn bare_seconds(text: &str) -> Option<Duration> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if whole.is_empty() || !digits(whole) || !digits(fraction) || fraction.len() > 9 {
        return None;
    }
    Some(Duration::new(whole.parse().ok()?, format!("{fraction:0<9}").parse().ok()?))
}

/// A size such as `64MiB`, `500MB` or `1GiB`; a bare number is bytes.
pub fn parse_size(text: &str) -> Result<u64, String> {
    text.parse::<bytesize::ByteSize>()
        .map(|size| size.as_u64())
        .map_err(|_| format!("\"{text}\" is not a size; write it like 512KiB, 64MiB or 1GiB"))
}

/// `1.2 MiB`.
pub fn size(bytes: u64) -> String {
    bytesize::ByteSize::b(bytes).display().iec().to_string()
}

/// `1h 02m 03s`, `12.345 s`, `17 ms`.
pub fn duration(nanos: u64) -> String {
    let seconds = nanos / 1_000_000_000;
    let (minutes, hours) = (seconds / 60, seconds / 3600);
    match (hours, minutes, seconds) {
        (0, 0, 0) => format!("{} ms", nanos / 1_000_000),
        (0, 0, s) => format!("{s}.{:03} s", nanos / 1_000_000 % 1000),
        (0, m, s) => format!("{m}m {:02}s", s % 60),
        (h, m, s) => format!("{h}h {:02}m {:02}s", m % 60, s % 60),
    }
}

/// `+1h 02m 03s`, `-17 ms`, `+20000d 1h 02m 03s`.
pub fn signed_duration(nanos: i64) -> String {
    const DAY: u64 = 86_400_000_000_000;
    let (sign, amount) = (if nanos < 0 { '-' } else { '+' }, nanos.unsigned_abs());
    match amount / DAY {
        0 if (1..1_000_000).contains(&amount) => format!("{sign}{amount} ns"),
        0 => format!("{sign}{}", duration(amount)),
        days => format!("{sign}{days}d {}", duration(amount % DAY)),
    }
}

/// 1234567 as `1,234,567`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.char_indices() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Text from outside with every control and direction-changing character escaped, so that it
/// cannot drive a terminal.
pub fn printable(text: &str) -> String {
    escaped(text, |out, c| out.extend(c.escape_unicode()))
}

/// A JSON text in which no such character is left either. Only its strings can have them, so it
/// says the same as before.
pub fn printable_json(text: &str) -> String {
    escaped(text, |out, c| out.extend(format!("\\u{:04x}", u32::from(c)).chars()))
}

fn escaped(text: &str, escape: impl Fn(&mut String, char)) -> String {
    let drives_terminal = |c: char| {
        c.is_control()
            || matches!(c, '\u{200E}'..='\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2066}'..='\u{2069}')
    };
    if text.bytes().all(|byte| (0x20..0x7F).contains(&byte)) {
        return text.to_owned();
    }
    text.chars().fold(String::with_capacity(text.len()), |mut out, c| {
        if drives_terminal(c) {
            escape(&mut out, c);
        } else {
            out.push(c);
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_and_sizes_are_read_as_people_write_them() {
        assert_eq!(parse_duration("1m30s"), Ok(Duration::from_secs(90)));
        assert_eq!(parse_duration("200ms"), Ok(Duration::from_millis(200)));
        assert_eq!(parse_duration("2.5"), Ok(Duration::from_millis(2500)));
        assert!(parse_duration("-1s").is_err());
        assert!(parse_duration("soon").is_err());
        assert_eq!(parse_size("64MiB"), Ok(64 << 20));
        assert!(parse_size("much").is_err());
    }

    #[test]
    fn moments_are_read_to_the_nanosecond() {
        let origin = Timestamp(5_000_000_000);
        assert_eq!(parse_moment("+1m30s", origin), Ok(Timestamp(95_000_000_000)));
        let nanos = Timestamp(1_700_000_000_123_456_789);
        assert_eq!(parse_moment("1700000000.123456789", origin), Ok(nanos));
        assert_eq!(parse_moment("2023-11-14T22:13:20.123456789Z", origin), Ok(nanos));
        for text in ["yesterday", "10s", "1h"] {
            assert!(parse_moment(text, origin).is_err(), "{text}");
        }
    }

    #[test]
    fn numbers_times_and_durations_read_well() {
        assert_eq!(grouped(1_234_567), "1,234,567");
        assert_eq!(grouped(999), "999");
        assert_eq!(compact_utc(Timestamp(1_700_000_000_000_000_000)), "20231114T221320Z");
        assert_eq!(duration(3_723_000_000_000), "1h 02m 03s");
        assert_eq!(duration(12_345_678_901), "12.345 s");
    }

    #[test]
    fn foreign_text_cannot_drive_a_terminal() {
        assert_eq!(printable("a\x1b[2Jb\u{202E}c"), "a\\u{1b}[2Jb\\u{202e}c");
        assert_eq!(printable_json("[\"a\u{9b}\u{7f}\"]"), "[\"a\\u009b\\u007f\"]");
    }
}
