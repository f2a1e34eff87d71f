//! The values of an enum, made of the texts of a value table.

use super::names::{Scope, identifier};

/// The name of every generated enum. It stands alone in a message of its own, because protobuf puts
/// the names of values beside the enum, where two enums with `Off` would clash.
pub const ENUM: &str = "Label";

/// The values of an enum.
#[derive(Debug, Default)]
pub struct Values {
    /// Number and name; 0 comes first, as proto3 demands.
    pub named: Vec<(i32, String)>,
    /// Texts that are not the name, and those of numbers that no enum can have.
    pub texts: Vec<(i128, String)>,
}

impl Values {
    /// Those of a value table, whose numbers may repeat: the first text counts.
    pub fn of(labels: &[(i128, String)]) -> Self {
        let mut values = Self::default();
        let mut scope = Scope::of_enum(ENUM);
        let mut before = None;
        for (number, text) in labels {
            if before.replace(*number) == Some(*number) {
                continue;
            }
            let Ok(small) = i32::try_from(*number) else {
                values.texts.push((*number, text.clone()));
                continue;
            };
            let mut name = identifier(text);
            if name.is_empty() {
                name = format!("VALUE_{}{}", if small < 0 { "NEG_" } else { "" }, number.abs());
            }
            let name = scope.take(&name);
            if name != *text {
                values.texts.push((*number, text.clone()));
            }
            values.named.push((small, name));
        }
        match values.named.iter().position(|(number, _)| *number == 0) {
            Some(at) => values.named[..=at].rotate_right(1),
            None => values.named.insert(0, (0, scope.take("RAW_0"))),
        }
        values
    }
}

/// The raw values that an enum has a name for, for a quick look.
#[derive(Debug)]
pub enum Known {
    /// All between 0 and 63: a bit each.
    Few(u64),
    /// Sorted.
    Many(Box<[i32]>),
}

impl Known {
    /// Those of a sorted value table.
    pub fn of(labels: impl Iterator<Item = i128>) -> Self {
        let numbers: Box<[i32]> = labels.filter_map(|number| i32::try_from(number).ok()).collect();
        if numbers.iter().all(|number| (0..64).contains(number)) {
            return Self::Few(numbers.iter().fold(0, |bits, number| bits | 1 << number));
        }
        Self::Many(numbers)
    }

    /// True if `number` has a name.
    #[inline]
    pub fn has(&self, number: i64) -> bool {
        match self {
            Self::Few(bits) => (0..64).contains(&number) && bits >> number & 1 == 1,
            Self::Many(numbers) => {
                i32::try_from(number).is_ok_and(|number| numbers.binary_search(&number).is_ok())
            }
        }
    }
}
