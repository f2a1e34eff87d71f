//! Fields of a record: any bits of it, and the time.

/// How a field's bits are meant (`cn_data_type`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Lowest byte first.
    Intel,
    /// Highest byte first.
    Motorola,
    /// Floating point, lowest byte first.
    RealIntel,
    /// Floating point, highest byte first.
    RealMotorola,
    /// Text.
    Text,
    /// Bytes, or something else.
    Bytes,
}

impl Encoding {
    pub fn of(data_type: u8) -> Self {
        match data_type {
            0 | 2 => Self::Intel,
            1 | 3 => Self::Motorola,
            4 => Self::RealIntel,
            5 => Self::RealMotorola,
            6..=9 | 17 => Self::Text,
            _ => Self::Bytes,
        }
    }
}

/// Where a field is in the record, and how it is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Field {
    /// Byte it begins in.
    pub byte: usize,
    /// Bit of that byte, 0 to 7.
    pub bit: u32,
    /// Bits it has.
    pub bits: u32,
    pub encoding: Encoding,
}

impl Field {
    /// Its bytes in the record; fewer if the record ends.
    pub fn bytes<'a>(&self, record: &'a [u8]) -> &'a [u8] {
        let rest = record.get(self.byte..).unwrap_or_default();
        // A file may say that a field has nearly 2^32 bits.
        let bits = u64::from(self.bit) + u64::from(self.bits);
        let length = usize::try_from(bits.div_ceil(8)).unwrap_or(usize::MAX);
        &rest[..length.min(rest.len())]
    }

    /// Its value as a whole number without sign; 0 if the record ends before.
    pub fn number(&self, record: &[u8]) -> u64 {
        let bytes = self.bytes(record);
        if bytes.len() > 9 {
            return 0;
        }
        let add = |all: u128, byte: &u8| all << 8 | u128::from(*byte);
        let all = match self.encoding {
            Encoding::Motorola | Encoding::RealMotorola => bytes.iter().fold(0, add),
            _ => bytes.iter().rev().fold(0, add),
        };
        let value = all >> self.bit & ((1 << self.bits.min(64)) - 1);
        u64::try_from(value).unwrap_or(u64::MAX)
    }

    /// True for a number that is not 0, or a text that begins with `T`, as in `Tx`.
    pub fn is_sent(&self, record: &[u8]) -> bool {
        match self.encoding {
            Encoding::Text | Encoding::Bytes => {
                self.bytes(record).first().is_some_and(|c| c.eq_ignore_ascii_case(&b't'))
            }
            _ => self.number(record) != 0,
        }
    }
}

/// The time of a record: a field, or its number when there is none; times a factor plus an offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Time {
    pub field: Option<Field>,
    /// Seconds.
    pub offset: f64,
    /// Seconds per unit.
    pub factor: f64,
}

const NANOS: f64 = 1e9;

impl Time {
    /// That of a group without times.
    pub const NONE: Self = Self { field: None, offset: 0.0, factor: 0.0 };

    /// Nanoseconds since the start of the file of record number `index`.
    #[allow(clippy::cast_possible_truncation, reason = "casts of floats stop at the range's ends")]
    pub fn nanos(&self, record: &[u8], index: u64) -> i64 {
        let Some(field) = &self.field else { return self.scaled(index) };
        let raw = field.number(record);
        match (field.encoding, field.bits) {
            (Encoding::RealIntel | Encoding::RealMotorola, 32) => {
                let raw = f32::from_bits(u32::try_from(raw).unwrap_or(0));
                ((self.offset + self.factor * f64::from(raw)) * NANOS).round() as i64
            }
            (Encoding::RealIntel | Encoding::RealMotorola, _) => {
                ((self.offset + self.factor * f64::from_bits(raw)) * NANOS).round() as i64
            }
            _ => self.scaled(raw),
        }
    }

    /// Whole units stay exact when a unit has whole nanoseconds.
    #[allow(clippy::cast_possible_truncation, reason = "casts of floats stop at the range's ends")]
    fn scaled(&self, raw: u64) -> i64 {
        let unit = self.factor * NANOS;
        let whole = unit.round();
        if (1.0..1e15).contains(&whole) && (unit - whole).abs() < 1e-6 * whole {
            let raw = i64::try_from(raw).unwrap_or(i64::MAX);
            let offset = (self.offset * NANOS).round() as i64;
            return raw.saturating_mul(whole as i64).saturating_add(offset);
        }
        ((self.offset + self.factor * raw as f64) * NANOS).round() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_found_in_both_byte_orders() {
        let field = |byte, bit, bits, encoding| Field { byte, bit, bits, encoding };
        let record = [0xFF, 0x34, 0x12, 0x80, 0x01];
        assert_eq!(field(1, 0, 16, Encoding::Intel).number(&record), 0x1234);
        assert_eq!(field(1, 0, 16, Encoding::Motorola).number(&record), 0x3412);
        assert_eq!(field(1, 4, 12, Encoding::Intel).number(&record), 0x123);
        assert_eq!(field(3, 7, 1, Encoding::Intel).number(&record), 1);
        // A length that no field has.
        assert_eq!(field(0, 7, u32::MAX, Encoding::Bytes).bytes(&record), record);
        assert_eq!(field(4, 0, 64, Encoding::Intel).number(&record), 1, "the record ends");
        assert_eq!(field(900, 0, 8, Encoding::Intel).number(&record), 0);
    }

    #[test]
    fn times_are_exact_where_units_are_whole_nanoseconds() {
        let intel = Field { byte: 0, bit: 0, bits: 64, encoding: Encoding::Intel };
        let time = Time { field: Some(intel), offset: 0.0, factor: 1e-9 };
        let raw = 123_456_789_012_345_678_u64;
        assert_eq!(time.nanos(&raw.to_le_bytes(), 0), raw as i64);
        let real = Field { encoding: Encoding::RealIntel, ..intel };
        let time = Time { field: Some(real), offset: 0.5, factor: 1.0 };
        assert_eq!(time.nanos(&0.000_001_f64.to_le_bytes(), 0), 500_001_000);
        let time = Time { field: None, offset: 0.0, factor: 0.1 };
        assert_eq!(time.nanos(&[], 7), 700_000_000);
    }
}
