//! Digits for the formats that are text, without a detour through `fmt`.

/// The two digits of each byte.
const PAIRS: [[u8; 2]; 256] = {
    let mut table = [[0; 2]; 256];
    let mut byte = 0;
    while byte < 256 {
        let digits = b"0123456789ABCDEF";
        table[byte] = [digits[byte >> 4], digits[byte & 15]];
        byte += 1;
    }
    table
};

/// Two hexadecimal digits.
pub fn hex(out: &mut Vec<u8>, byte: u8) {
    out.extend_from_slice(&PAIRS[usize::from(byte)]);
}

/// Bytes as pairs of digits, each behind a blank.
pub fn spaced(out: &mut Vec<u8>, data: &[u8]) {
    for byte in data {
        let [high, low] = PAIRS[usize::from(*byte)];
        out.extend_from_slice(&[b' ', high, low]);
    }
}

/// Exactly `count` hexadecimal digits (at most 8), the highest first.
pub fn hex_digits(out: &mut Vec<u8>, value: u32, count: usize) {
    let mut digits = [0; 8];
    for (pair, byte) in digits.chunks_exact_mut(2).zip(value.to_be_bytes()) {
        pair.copy_from_slice(&PAIRS[usize::from(byte)]);
    }
    out.extend_from_slice(&digits[8 - count.min(8)..]);
}

/// As many hexadecimal digits as the number needs.
pub fn hex_number(out: &mut Vec<u8>, value: u32) {
    hex_digits(out, value, (32 - value.leading_zeros()).div_ceil(4).max(1) as usize);
}

/// A decimal number, filled up to `width` with `fill` in front.
pub fn decimal(out: &mut Vec<u8>, mut value: u64, width: usize, fill: u8) {
    let mut digits = [fill; 20];
    let mut first = digits.len();
    loop {
        first -= 1;
        #[allow(clippy::cast_possible_truncation, reason = "below 10")]
        let digit = (value % 10) as u8;
        digits[first] = b'0' + digit;
        value /= 10;
        if value == 0 {
            break;
        }
    }
    let first = first.min(digits.len().saturating_sub(width));
    out.extend_from_slice(&digits[first..]);
}

/// Fills up with blanks behind what was written since `start`, to `width`.
pub fn pad(out: &mut Vec<u8>, start: usize, width: usize) {
    let end = (start + width).max(out.len());
    out.resize(end, b' ');
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_they_should() {
        let text = |put: &dyn Fn(&mut Vec<u8>)| {
            let mut out = Vec::new();
            put(&mut out);
            String::from_utf8(out).unwrap()
        };
        assert_eq!(text(&|out| decimal(out, 0, 1, b' ')), "0");
        assert_eq!(text(&|out| decimal(out, 42, 6, b'0')), "000042");
        assert_eq!(text(&|out| decimal(out, 1234, 2, b' ')), "1234");
        assert_eq!(text(&|out| decimal(out, u64::MAX, 0, b' ')), u64::MAX.to_string());
        assert_eq!(text(&|out| hex_digits(out, 0x1F, 3)), "01F");
        assert_eq!(text(&|out| hex_number(out, 0)), "0");
        assert_eq!(text(&|out| hex_number(out, 0x18EF_C034)), "18EFC034");
        assert_eq!(text(&|out| spaced(out, &[0, 0xAB])), " 00 AB");
    }
}
