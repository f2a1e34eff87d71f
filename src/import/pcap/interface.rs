//! Interfaces of a capture: their link type, name and unit of time.

/// The longest name that is kept.
const NAME_MAX: usize = 64;

/// Where packets come from.
#[derive(Clone, Debug)]
pub struct Interface {
    /// Link type.
    pub link: u32,
    /// `if_name`.
    pub name: Option<String>,
    /// Units of time in a second (`if_tsresol`).
    resolution: Resolution,
    /// `if_tsoffset`, seconds, which may be negative.
    offset: i64,
}

#[derive(Clone, Copy, Debug)]
enum Resolution {
    Decimal(u32),
    Binary(u32),
}

impl Resolution {
    fn nanos(self, units: u64) -> u64 {
        match self {
            Self::Decimal(power) if power <= 9 => units.saturating_mul(10u64.pow(9 - power)),
            Self::Decimal(power) => units / 10u64.saturating_pow(power - 9),
            Self::Binary(power) => {
                let nanos = (u128::from(units) * 1_000_000_000) >> power;
                u64::try_from(nanos).unwrap_or(u64::MAX)
            }
        }
    }
}

impl Interface {
    /// The only one of a pcap file.
    pub fn plain(link: u32, nanos: bool) -> Self {
        let resolution = Resolution::Decimal(if nanos { 9 } else { 6 });
        Self { link, name: None, resolution, offset: 0 }
    }

    /// As the options of its block describe it.
    pub fn of(link: u32, described: &[u8], big: bool) -> Self {
        let mut found = Self::plain(link, false);
        options(described, big, |code, value| match (code, value) {
            (2, name) => {
                let name = String::from_utf8_lossy(&name[..name.len().min(NAME_MAX)]);
                let name = name.trim_end_matches('\0');
                found.name = (!name.is_empty()).then(|| name.to_owned());
            }
            (9, [power @ 0..=19]) => found.resolution = Resolution::Decimal((*power).into()),
            (9, [power @ 0x80..=0xBF]) => {
                found.resolution = Resolution::Binary((power & 0x7F).into());
            }
            (14, [_, _, _, _, _, _, _, _]) => {
                let (first, second) = (u32_at(value, 0, big).into(), u32_at(value, 4, big).into());
                let (high, low): (u64, u64) = if big { (first, second) } else { (second, first) };
                found.offset = (high << 32 | low).cast_signed();
            }
            _ => {}
        });
        found
    }

    /// Nanoseconds since 1970 of a time in its units.
    pub fn nanos(&self, units: u64) -> u64 {
        let nanos = self.resolution.nanos(units);
        nanos.saturating_add_signed(self.offset.saturating_mul(1_000_000_000))
    }
}

/// Gives code and value of each option to `take`.
pub fn options(mut bytes: &[u8], big: bool, mut take: impl FnMut(u16, &[u8])) {
    while let [a, b, c, d, rest @ ..] = bytes {
        let number = |pair| if big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
        let (code, length) = (number([*a, *b]), usize::from(number([*c, *d])));
        let Some(value) = rest.get(..length).filter(|_| code != 0) else { return };
        take(code, value);
        bytes = rest.get(length.next_multiple_of(4)..).unwrap_or_default();
    }
}

/// A number; bytes that are not there are 0.
pub fn u32_at(bytes: &[u8], at: usize, big: bool) -> u32 {
    let four = std::array::from_fn(|index| bytes.get(at + index).copied().unwrap_or(0));
    if big { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
}
