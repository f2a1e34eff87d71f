//! Unsigned numbers in a frame's header or in front of a command's data, whole or cut into bits.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::definition::{ByteOrder, Format};

/// Numbers and their names.
pub type Values = BTreeMap<u64, Arc<str>>;

/// One number: where it is, and how it is shown.
#[derive(Debug)]
pub struct Quantity {
    /// Its name.
    pub name: Arc<str>,
    /// First byte of the word it is part of, counted from the start of the frame or of the data.
    pub at: usize,
    /// Bytes of that word, 1 to 4.
    pub size: usize,
    /// Byte order of that word.
    pub order: ByteOrder,
    /// Lowest bit.
    pub shift: u32,
    /// Number of bits, 1 to 32.
    pub width: u32,
    /// Names of its values.
    pub values: Option<Arc<Values>>,
    /// How it is shown.
    pub format: Format,
    /// Under which name the value's name is shown.
    pub label: Arc<str>,
    /// Not shown.
    pub hidden: bool,
}

impl Quantity {
    /// The number in `bytes`; 0 where bytes are missing (callers check the length first).
    pub fn read(&self, bytes: &[u8]) -> u64 {
        let word = bytes.get(self.at..self.end()).unwrap_or_default();
        (unsigned(word, self.order) >> self.shift) & ((1 << self.width) - 1)
    }

    /// Behind the last byte.
    pub fn end(&self) -> usize {
        self.at + self.size
    }

    /// The name of `value`, if it has one.
    pub fn label_of(&self, value: u64) -> Option<&Arc<str>> {
        self.values.as_ref()?.get(&value)
    }

    /// `value` as `0x` and as many digits as the number can need.
    pub fn hex(&self, value: u64) -> String {
        hex(value, self.width)
    }
}

/// A number of `width` bits as `0x` and all its digits.
pub fn hex(value: u64, width: u32) -> String {
    format!("0x{value:0digits$x}", digits = width.div_ceil(4) as usize)
}

/// Up to 8 bytes as an unsigned number.
pub fn unsigned(bytes: &[u8], order: ByteOrder) -> u64 {
    let join = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
    match order {
        ByteOrder::Big => bytes.iter().fold(0, join),
        ByteOrder::Little => bytes.iter().rev().fold(0, join),
    }
}

/// Writes the low bytes of a number over `place`, as many as it has (8 at most).
pub fn put_unsigned(number: u64, order: ByteOrder, place: &mut [u8]) {
    let bytes = number.to_le_bytes();
    match order {
        ByteOrder::Little => place.iter_mut().zip(bytes).for_each(|(to, from)| *to = from),
        ByteOrder::Big => place.iter_mut().rev().zip(bytes).for_each(|(to, from)| *to = from),
    }
}

/// A number that was read.
#[derive(Clone, Debug)]
pub struct Reading {
    /// What it is.
    pub quantity: Arc<Quantity>,
    /// Its value.
    pub value: u64,
}

impl Reading {
    /// The value's name, if it has one.
    pub fn label(&self) -> Option<&Arc<str>> {
        self.quantity.label_of(self.value)
    }
}

/// Several numbers in a row.
#[derive(Clone, Debug, Default)]
pub struct Block {
    /// Bytes up to the end of the last word, counted from where `Quantity::at` counts.
    pub end: usize,
    /// The numbers, in order.
    pub quantities: Vec<Arc<Quantity>>,
}

impl Block {
    /// All numbers of the block.
    pub fn read(&self, bytes: &[u8]) -> Vec<Reading> {
        self.quantities
            .iter()
            .map(|quantity| Reading { quantity: quantity.clone(), value: quantity.read(bytes) })
            .collect()
    }
}
