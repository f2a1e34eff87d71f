//! How framing, header and check are written.

use serde::Deserialize;
use toml::Spanned;

use super::{ByteOrder, Table};

/// `[framing]`: which keys a kind takes is checked in `framing`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FramingForm {
    pub kind: Spanned<String>,
    pub start: Option<Spanned<Vec<u8>>>,
    pub end: Option<Spanned<Vec<u8>>>,
    pub escape: Option<Spanned<EscapeForm>>,
    pub length: Option<Spanned<LengthForm>>,
    pub size: Option<Spanned<usize>>,
    pub max: Option<Spanned<usize>>,
    pub gap_us: Option<Spanned<u64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EscapeForm {
    pub byte: u8,
    pub xor: u8,
    pub follows: Option<Vec<(u8, u8)>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LengthForm {
    pub field: String,
    #[serde(default)]
    pub add: i64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrcForm {
    pub name: String,
    #[serde(default)]
    pub byte_order: ByteOrder,
    #[serde(default)]
    pub from: usize,
}

/// An unsigned number in a header or a prefix, whole or cut into bits.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WordForm {
    pub name: String,
    #[serde(rename = "type")]
    pub kind: String,
    #[serde(default)]
    pub byte_order: ByteOrder,
    #[serde(default)]
    pub hidden: bool,
    #[serde(default)]
    pub format: Format,
    pub values: Option<ValuesForm>,
    pub label: Option<String>,
    #[serde(default)]
    pub bits: Vec<Spanned<BitsForm>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BitsForm {
    pub name: String,
    pub bits: String,
    #[serde(default)]
    pub hidden: bool,
    #[serde(default)]
    pub format: Format,
    pub values: Option<ValuesForm>,
    pub label: Option<String>,
}

/// A table by its name, or written where it is used.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "the name of a table in [values], or a table like { 0x14 = \"on\" }")]
pub enum ValuesForm {
    Name(String),
    Table(Table),
}

/// How a number is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// As a number.
    #[default]
    Number,
    /// As `0x` and hexadecimal digits.
    Hex,
    /// By its name in the value table only.
    Label,
}
