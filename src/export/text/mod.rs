//! Text formats: CSV, JSON lines, InfluxDB line protocol.

pub mod csv;
pub mod csv_folder;
pub mod influx;
pub mod jsonl;
mod prepared;

use std::borrow::Cow;

use crate::export::table::{Row, Value};
use crate::frame::Timestamp;
use crate::text::rfc3339;

const SECOND: u64 = 1_000_000_000;
const DIGITS: &[u8; 16] = b"0123456789ABCDEF";
const BASE64: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// How times are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeStyle {
    /// RFC 3339, nanoseconds, UTC.
    Iso,
    /// Seconds since 1970, nine decimals.
    Epoch,
}

/// Writes times; remembers the text of the last second.
#[derive(Debug)]
pub struct Clock {
    style: TimeStyle,
    second: u64,
    text: String,
}

impl Clock {
    /// In this style.
    pub fn new(style: TimeStyle) -> Self {
        Self { style, second: u64::MAX, text: String::new() }
    }

    /// Appends a time.
    pub fn put(&mut self, out: &mut Vec<u8>, time: Timestamp) {
        let (second, nanos) = (time.nanos() / SECOND, time.nanos() % SECOND);
        if second != self.second {
            self.second = second;
            self.text = match self.style {
                TimeStyle::Iso => {
                    let mut text = rfc3339(Timestamp(second * SECOND));
                    text.truncate("2026-11-22T03:15:00".len());
                    text
                }
                TimeStyle::Epoch => second.to_string(),
            };
        }
        out.extend_from_slice(self.text.as_bytes());
        let mut fraction = *b".000000000Z";
        let mut rest = nanos;
        for digit in fraction[1..10].iter_mut().rev() {
            // A digit.
            *digit = b'0' + u8::try_from(rest % 10).unwrap_or(0);
            rest /= 10;
        }
        let length = if self.style == TimeStyle::Iso { 11 } else { 10 };
        out.extend_from_slice(&fraction[..length]);
    }
}

/// Texts that stand in many rows, as they are written.
#[derive(Debug, Default)]
pub struct Known(Vec<Box<[u8]>>);

impl Known {
    /// Remembers a text; its number.
    pub fn add(&mut self, written: Vec<u8>) -> u32 {
        self.0.push(written.into());
        u32::try_from(self.0.len() - 1).unwrap_or(u32::MAX)
    }

    /// A text by its number.
    #[inline]
    pub fn get(&self, number: u32) -> &[u8] {
        self.0.get(number as usize).map_or(&[], |text| text)
    }
}

/// Appends an integer.
pub fn put_integer(out: &mut Vec<u8>, number: impl itoa::Integer) {
    out.extend_from_slice(itoa::Buffer::new().format(number).as_bytes());
}

/// Appends the shortest text that means this finite number, without a trailing `.0`.
pub fn put_float(out: &mut Vec<u8>, number: f64, single: bool) {
    let mut buffer = zmij::Buffer::new();
    #[allow(clippy::cast_possible_truncation, reason = "it was 32 bits before")]
    let text =
        if single { buffer.format_finite(number as f32) } else { buffer.format_finite(number) };
    out.extend_from_slice(text.strip_suffix(".0").unwrap_or(text).as_bytes());
}

/// Appends bytes as hexadecimal digits.
pub fn put_hex(out: &mut Vec<u8>, bytes: &[u8]) {
    let digit = |half: u8| DIGITS[usize::from(half)];
    out.extend(bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]));
}

/// Appends bytes in base64 (RFC 4648, section 4).
pub fn put_base64(out: &mut Vec<u8>, bytes: &[u8]) {
    for three in bytes.chunks(3) {
        let word = three.iter().fold(0_usize, |word, byte| word << 8 | usize::from(*byte));
        let word = word << (8 * (3 - three.len()));
        for place in 0..4 {
            let digit = BASE64[word >> (18 - 6 * place) & 63];
            out.push(if place > three.len() { b'=' } else { digit });
        }
    }
}

/// The text of a text value; bytes as hexadecimal digits when `hex`.
pub fn text_of(row: &Row, value: Value, hex: bool) -> Cow<'_, str> {
    let bytes = row.bytes(value);
    if !hex {
        return String::from_utf8_lossy(bytes);
    }
    let mut digits = Vec::new();
    put_hex(&mut digits, bytes);
    String::from_utf8(digits).unwrap_or_default().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_as_short_as_they_can_be_and_mean_the_same() {
        let text = |number: f64, single| {
            let mut out = Vec::new();
            put_float(&mut out, number, single);
            String::from_utf8(out).unwrap()
        };
        assert_eq!(text(40.0, false), "40");
        assert_eq!(text(0.1 + 0.2, false), "0.30000000000000004");
        assert_eq!(text(f64::from(0.1_f32), true), "0.1");
        for number in [1e300, 5e-324, -0.0, 123_456_789.125, 1e15, 1e16, 1e-7] {
            assert_eq!(text(number, false).parse::<f64>().unwrap().to_bits(), number.to_bits());
        }
    }

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (text, expected) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foobar", "Zm9vYmFy")] {
            let mut out = Vec::new();
            put_base64(&mut out, text.as_bytes());
            assert_eq!(out, expected.as_bytes());
        }
    }

    #[test]
    fn times_keep_their_nanoseconds() {
        let text = |style| {
            let mut clock = Clock::new(style);
            let mut out = Vec::new();
            for nanos in [1_700_000_000_000_000_001, 1_700_000_000_999_999_999] {
                clock.put(&mut out, Timestamp(nanos));
                out.push(b' ');
            }
            String::from_utf8(out).unwrap()
        };
        let iso = "2023-11-14T22:13:20.000000001Z 2023-11-14T22:13:20.999999999Z ";
        assert_eq!(text(TimeStyle::Iso), iso);
        assert_eq!(text(TimeStyle::Epoch), "1700000000.000000001 1700000000.999999999 ");
    }
}
