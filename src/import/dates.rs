//! Dates as tools write them into the heads of their logs, in the language of the machine.

use jiff::civil;
use jiff::tz::TimeZone;

use crate::frame::Timestamp;

/// Beginnings of the months' names: English, German, French, Italian, Spanish, Portuguese, Dutch.
/// Only ASCII letters are compared, since the head of a log may be in any encoding: `Mär` is `mr`.
const MONTHS: [&[&str]; 12] = [
    &["jan", "gen", "ene"],
    &["feb", "fev", "fv"],
    &["mar", "mr", "maa", "mrt"],
    &["apr", "avr", "abr"],
    &["may", "mai", "mag", "mei"],
    &["jun", "juin", "giu"],
    &["jul", "juil", "lug"],
    &["aug", "aou", "aot", "ago"],
    &["sep", "set"],
    &["oct", "okt", "ott", "out"],
    &["nov"],
    &["dec", "dez", "dc", "dic"],
];

/// The moment a date and time of day without a zone stands for in `zone`. The moment is given as
/// if the zone were UTC.
pub fn in_zone(local: Timestamp, zone: &TimeZone) -> Timestamp {
    let Ok(utc) = jiff::Timestamp::from_nanosecond(i128::from(local.nanos())) else { return local };
    let civil = utc.to_zoned(TimeZone::UTC).datetime();
    let Ok(zoned) = civil.to_zoned(zone.clone()) else { return local };
    u64::try_from(zoned.timestamp().as_nanosecond()).map_or(local, Timestamp)
}

/// A date with time of day, as if it were UTC: `Sam Sep 30 15:06:13.191 2017`,
/// `Wed Apr 16 09:21:13.159 am 2014`, `18.12.2021 14:28:07.062.0`, `12/18/2021 2:28:07 PM`.
pub fn parse(text: &[u8]) -> Option<Timestamp> {
    let text = String::from_utf8_lossy(text);
    let (mut month, mut day, mut year, mut time, mut half) = (None, None, None, None, None);
    for word in text.split([' ', '\t', ',']).filter(|word| !word.is_empty()) {
        let letters: String =
            word.chars().filter(char::is_ascii_alphabetic).collect::<String>().to_lowercase();
        if word.contains(':') {
            time = Some(clock(word)?);
        } else if let Some(found) = numeric_date(word) {
            (year, month, day) = (Some(found.0), Some(found.1), Some(found.2));
        } else if let Ok(number) =
            word.trim_end_matches(['.', 't', 'h', 's', 'n', 'd', 'r']).parse::<i16>()
        {
            match number {
                1..=31 if day.is_none() => day = Some(number),
                1970..=2261 => year = Some(number),
                _ => return None,
            }
        } else if matches!(letters.as_str(), "am" | "vorm") || word == "上午" {
            half = Some(0);
        } else if matches!(letters.as_str(), "pm" | "nachm") || word == "下午" {
            half = Some(12);
        } else if let Some(found) = month_of(word, &letters) {
            month = Some(found);
        }
    }
    let (mut hour, minute, second, nanos) = time?;
    if let Some(half) = half.filter(|_| hour <= 12) {
        hour = hour % 12 + half;
    }
    let (month, day) = (i8::try_from(month?).ok()?, i8::try_from(day?).ok()?);
    let civil = civil::DateTime::new(year?, month, day, hour, minute, second, nanos).ok()?;
    let utc = civil.to_zoned(TimeZone::UTC).ok()?.timestamp();
    u64::try_from(utc.as_nanosecond()).ok().map(Timestamp)
}

fn month_of(word: &str, letters: &str) -> Option<i16> {
    // East Asian locales write a number before the sign for month.
    if let Some(number) = word.strip_suffix('月') {
        return number.parse().ok();
    }
    // Weekdays come first and look alike (Mar, Mär; Mer); a month that follows overrides them.
    let found =
        MONTHS.iter().position(|names| names.iter().any(|name| letters.starts_with(name)))?;
    i16::try_from(found + 1).ok()
}

/// Year, month and day of `2021-12-18`, `18.12.2021` or `12/18/2021`.
fn numeric_date(word: &str) -> Option<(i16, i16, i16)> {
    let parts: Vec<i16> =
        word.split(['-', '.', '/']).map(|part| part.parse().ok()).collect::<Option<_>>()?;
    match parts[..] {
        [year, month, day] if year > 31 => Some((year, month, day)),
        [month, day, year] if word.contains('/') && month <= 12 => Some((year, month, day)),
        [day, month, year] => Some((year, month, day)),
        _ => None,
    }
}

/// Hour, minute, second and nanoseconds of `15:06:13.191` or `14:28:07.062.8`: PEAK's tools put the
/// microseconds' hundreds behind another point.
fn clock(word: &str) -> Option<(i8, i8, i8, i32)> {
    let mut parts = word.splitn(3, ':');
    let (hour, minute) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let rest = parts.next().unwrap_or("0");
    let (second, fraction) = rest.split_once(['.', ',', ':']).unwrap_or((rest, ""));
    let digits: String = fraction.chars().filter(char::is_ascii_digit).take(9).collect();
    let nanos = format!("{digits:0<9}").parse().ok()?;
    Some((hour, minute, second.parse().ok()?, nanos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_read_in_the_languages_of_many_machines() {
        let utc = |text: &str| crate::text::parse_moment(text, Timestamp(0)).unwrap();
        for (text, expected) in [
            ("Sam Sep 30 15:06:13.191 2017", "2017-09-30T15:06:13.191Z"),
            ("Sat Sep 30 10:06:13.191 PM 2017", "2017-09-30T22:06:13.191Z"),
            ("Wed Apr 16 12:21:13 am 2014", "2014-04-16T00:21:13Z"),
            ("Mit M\u{e4}r 1 09:21:13 2023", "2023-03-01T09:21:13Z"),
            ("Mar. mars 12 9:21:13 2019", "2019-03-12T09:21:13Z"),
            ("Mar Dez 12 9:21:13 2019", "2019-12-12T09:21:13Z"),
            ("jeu. d\u{e9}c. 12 9:21:13 2019", "2019-12-12T09:21:13Z"),
            ("周三 4月 16 09:21:13.159 下午 2014", "2014-04-16T21:21:13.159Z"),
            ("18.12.2021 14:28:07.062.8", "2021-12-18T14:28:07.0628Z"),
            ("12/18/2021 2:28:07 PM", "2021-12-18T14:28:07Z"),
            ("2021-12-18 14:28:07", "2021-12-18T14:28:07Z"),
        ] {
            assert_eq!(parse(text.as_bytes()), Some(utc(expected)), "{text}");
        }
        assert_eq!(parse(b"Mit M\xe4r 1 09:21:13 2023"), Some(utc("2023-03-01T09:21:13Z")));
        for bad in
            ["", "Sam Sep 31 15:06:13 2017", "yesterday", "Sep 30 2017", "Sep 30 25:00:00 2017"]
        {
            assert_eq!(parse(bad.as_bytes()), None, "{bad}");
        }
        let berlin = TimeZone::get("Europe/Berlin").unwrap();
        assert_eq!(in_zone(utc("2023-07-01T12:00:00Z"), &berlin), utc("2023-07-01T10:00:00Z"));
    }
}
