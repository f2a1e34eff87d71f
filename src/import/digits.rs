//! Numbers in the bytes of a text, without copying them.

/// The value of each hexadecimal digit, 0xFF for every other byte.
const HEX: [u8; 256] = {
    let mut table = [0xFF; 256];
    let mut digit = 0;
    while digit < 16 {
        let byte = b"0123456789abcdef"[digit as usize];
        table[byte as usize] = digit;
        table[byte.to_ascii_uppercase() as usize] = digit;
        digit += 1;
    }
    table
};

/// The value of one hexadecimal digit.
pub fn hex_digit(byte: u8) -> Option<u8> {
    let value = HEX[usize::from(byte)];
    (value != 0xFF).then_some(value)
}

/// A byte written as two hexadecimal digits.
pub fn hex_pair(high: u8, low: u8) -> Option<u8> {
    let (high, low) = (HEX[usize::from(high)], HEX[usize::from(low)]);
    // Values are below 16, so only 0xFF has bits of the upper half.
    ((high | low) & 0xF0 == 0).then_some(high << 4 | low)
}

/// One to eight hexadecimal digits and nothing else.
pub fn hex(text: &[u8]) -> Option<u32> {
    if text.is_empty() || text.len() > 8 {
        return None;
    }
    text.iter().try_fold(0, |value, &byte| Some(value << 4 | u32::from(hex_digit(byte)?)))
}

/// Decimal digits and nothing else.
pub fn decimal(text: &[u8]) -> Option<u64> {
    if text.is_empty() {
        return None;
    }
    text.iter().try_fold(0u64, |value, &byte| {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        value.checked_mul(10)?.checked_add(u64::from(digit))
    })
}

/// Digits, and a fraction behind a point (or comma, where a tool followed its locale), in units of
/// the 10th power `places` below one: `12.345` with 9 places is 12,345,000,000. What is finer is
/// cut off.
pub fn fixed(text: &[u8], places: u32) -> Option<u64> {
    let point = text.iter().position(|&byte| byte == b'.' || byte == b',');
    let (whole, fraction) = text.split_at(point.unwrap_or(text.len()));
    let fraction = fraction.get(1..).unwrap_or_default();
    let kept = &fraction[..fraction.len().min(places as usize)];
    if !fraction[kept.len()..].iter().all(u8::is_ascii_digit) {
        return None;
    }
    let missing = places.checked_sub(u32::try_from(kept.len()).ok()?)?;
    let low = if kept.is_empty() { 0 } else { decimal(kept)? }.checked_mul(10u64.pow(missing))?;
    decimal(whole)?.checked_mul(10u64.checked_pow(places)?)?.checked_add(low)
}

/// Seconds as nanoseconds.
pub fn seconds(text: &[u8]) -> Option<u64> {
    fixed(text, 9)
}

/// The words of a line, parted by blanks and tabs.
#[derive(Clone, Debug)]
pub struct Words<'a>(pub &'a [u8]);

impl<'a> Words<'a> {
    /// The next word without taking it.
    pub fn peek(&self) -> Option<&'a [u8]> {
        self.clone().next()
    }

    /// Takes the next word if it is this one, in letters of any size.
    pub fn accept(&mut self, word: &[u8]) -> bool {
        let found = self.peek().is_some_and(|next| next.eq_ignore_ascii_case(word));
        if found {
            self.next();
        }
        found
    }
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let blank = |byte: &u8| matches!(byte, b' ' | b'\t');
        let start = self.0.iter().position(|byte| !blank(byte))?;
        let rest = &self.0[start..];
        let end = rest.iter().position(blank).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        self.0 = rest;
        Some(word)
    }
}

/// Text for a person, whatever bytes it is.
pub fn shown(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(40)]);
    crate::text::printable(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_exactly_or_not_at_all() {
        assert_eq!(seconds(b"1700000000.123456789"), Some(1_700_000_000_123_456_789));
        assert_eq!(seconds(b"0.5"), Some(500_000_000));
        assert_eq!(seconds(b"7"), Some(7_000_000_000));
        assert_eq!(seconds(b"1.1234567891"), Some(1_123_456_789));
        assert_eq!(fixed(b"7,2", 6), Some(7_200_000));
        for bad in ["", ".", "1.2.3", "-1", "1e5", "99999999999999999999", "1.x", "1.123456789x"] {
            assert_eq!(seconds(bad.as_bytes()), None, "{bad}");
        }
        assert_eq!(
            (hex(b"1fFFffff"), hex(b"123456789"), hex(b"0x1")),
            (Some(0x1FFF_FFFF), None, None)
        );
        assert_eq!((hex_pair(b'7', b'e'), hex_pair(b'7', b' ')), (Some(0x7E), None));
    }
}
