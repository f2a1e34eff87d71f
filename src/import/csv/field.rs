//! What stands between two separators.

use crate::frame::Timestamp;
use crate::import::digits::{hex_pair, seconds};

/// A time: seconds since 1970 (with an exponent, as Python may write them) or a date (RFC 3339, a
/// blank for its `T` too).
pub(super) fn moment(field: &[u8]) -> Option<Timestamp> {
    if let Some(nanos) = seconds(field) {
        return Some(Timestamp(nanos));
    }
    let text = str::from_utf8(field).ok()?;
    // Python writes small and large numbers with an exponent.
    if let Some((number, _)) =
        text.split_once(['e', 'E']).filter(|(number, _)| !number.contains(':'))
    {
        let value: f64 = text.parse().ok().filter(|_| !number.is_empty())?;
        #[allow(clippy::cast_possible_truncation, reason = "a float's cast stays in the range")]
        return (value >= 0.0).then_some(Timestamp((value * 1e9) as u64));
    }
    crate::text::parse_moment(&text.replacen(' ', "T", 1), Timestamp(0)).ok()
}

/// Without blanks and quotation marks around it.
pub(super) fn unquoted(field: &[u8]) -> &[u8] {
    let field = field.trim_ascii();
    field.strip_prefix(b"\"").and_then(|rest| rest.strip_suffix(b"\"")).unwrap_or(field)
}

/// Pairs of digits, with or without blanks between them.
pub(super) fn hex_bytes(field: &[u8], data: &mut [u8]) -> Option<usize> {
    let digits = field.strip_prefix(b"0x").unwrap_or(field);
    let mut digits = digits.iter().copied().filter(|byte| *byte != b' ');
    let mut length = 0;
    while let Some(high) = digits.next() {
        *data.get_mut(length)? = hex_pair(high, digits.next()?)?;
        length += 1;
    }
    Some(length)
}

/// RFC 4648, section 4.
pub(super) fn base64(field: &[u8], data: &mut [u8]) -> Option<usize> {
    let digits = field.trim_ascii_end();
    let digits = digits.strip_suffix(b"==").or_else(|| digits.strip_suffix(b"=")).unwrap_or(digits);
    let (mut bits, mut count, mut length) = (0u32, 0, 0);
    for &digit in digits {
        let value = match digit {
            b'A'..=b'Z' => digit - b'A',
            b'a'..=b'z' => digit - b'a' + 26,
            b'0'..=b'9' => digit - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            *data.get_mut(length)? = (bits >> count).to_le_bytes()[0];
            length += 1;
            bits &= (1 << count) - 1;
        }
    }
    Some(length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CAN_MAX_DATA;

    #[test]
    fn base64_is_read_as_it_is_written() {
        let mut data = [0; CAN_MAX_DATA];
        for (text, bytes) in [
            ("", &b""[..]),
            ("Zg==", b"f"),
            ("Zm8=", b"fo"),
            ("Zm9vYmFy", b"foobar"),
            ("//8=", b"\xff\xff"),
        ] {
            assert_eq!(base64(text.as_bytes(), &mut data), Some(bytes.len()), "{text}");
            assert_eq!(&data[..bytes.len()], bytes);
        }
        assert_eq!(base64(b"Zm9*", &mut data), None);
        assert_eq!(base64("A".repeat(200).as_bytes(), &mut data), None);
    }
}
