//! What a definition file may say, as it is written. `compile` checks it and resolves the names.
//!
//! Every table refuses keys that it does not know, so that a misspelt one is an error and not a
//! setting that silently does nothing.

#![allow(missing_docs, reason = "docs/protocols-serial.md says what the keys mean")]

pub mod compile;
pub mod framing;
pub mod messages;
pub mod payloads;
pub mod values;
pub mod words;

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ByteOrder {
    /// High byte first.
    #[default]
    Big,
    /// Low byte first.
    Little,
}

/// A whole definition file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definition {
    pub name: String,
    pub title: Option<String>,
    pub source: Option<String>,
    pub line: Option<LineForm>,
    #[serde(default)]
    pub byte_order: ByteOrder,
    pub framing: Spanned<FramingForm>,
    pub crc: Option<Spanned<CrcForm>>,
    #[serde(default)]
    pub header: Vec<Spanned<WordForm>>,
    pub direction: Option<Spanned<DirectionForm>>,
    #[serde(default)]
    pub check: Vec<Spanned<CheckForm>>,
    #[serde(default)]
    pub operation: BTreeMap<String, OperationForm>,
    pub request: Option<Spanned<MessageForm>>,
    pub response: Option<Spanned<MessageForm>>,
    pub report: Option<Spanned<MessageForm>>,
    pub link: Option<Spanned<LinkForm>>,
    pub pairing: Option<Spanned<PairingForm>>,
    #[serde(default)]
    pub values: BTreeMap<String, Spanned<Table>>,
    #[serde(default)]
    pub flags: BTreeMap<String, Spanned<Table>>,
    #[serde(default)]
    pub command: Vec<Spanned<CommandForm>>,
}

/// Numbers (as TOML keys: `0x14` or `20`) and their names.
pub type Table = BTreeMap<String, String>;

/// How the port is set.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LineForm {
    pub baud: u32,
    #[serde(default = "eight")]
    pub data_bits: u8,
    #[serde(default)]
    pub parity: Parity,
    #[serde(default = "one")]
    pub stop_bits: u8,
}

fn eight() -> u8 {
    8
}

fn one() -> u8 {
    1
}

/// Parity of a serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Parity {
    /// No parity bit.
    #[default]
    None,
    /// Even number of ones.
    Even,
    /// Odd number of ones.
    Odd,
}

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

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectionForm {
    pub by: String,
    pub request: Option<Scalar>,
    pub response: Option<Scalar>,
}

/// A number, or its name in a value table.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "a number, or a name from the field's value table")]
pub enum Scalar {
    Number(u64),
    Name(String),
}

/// One or several of them.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "a number or name, or a list of them")]
pub enum OneOrMany<T> {
    One(T),
    Many(Vec<T>),
}

/// Fields and the values they must have.
pub type ConditionForm = BTreeMap<String, OneOrMany<Scalar>>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckForm {
    pub name: String,
    #[serde(default)]
    pub when: ConditionForm,
    #[serde(default)]
    pub unless: ConditionForm,
}

/// What the data of an operation are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Carries {
    /// No data.
    #[default]
    Nothing,
    /// The command's `args`.
    Args,
    /// The command's `fields`.
    Fields,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperationForm {
    #[serde(default)]
    pub request: Carries,
    #[serde(default)]
    pub response: Carries,
}

/// `[request]`, `[response]` and `[report]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MessageForm {
    #[serde(default)]
    pub when: ConditionForm,
    #[serde(default)]
    pub prefix: Vec<Spanned<WordForm>>,
    pub command: Option<String>,
    pub operation: Option<String>,
    #[serde(default)]
    pub ok: ConditionForm,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkForm {
    pub name: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairingForm {
    pub slot: String,
    #[serde(default)]
    pub common: Vec<(u64, u64)>,
    #[serde(default)]
    pub same: Vec<SameForm>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SameForm {
    pub field: String,
    pub reason: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandForm {
    pub id: Option<OneOrMany<u64>>,
    pub name: String,
    pub title: Option<String>,
    #[serde(default)]
    pub operations: Vec<String>,
    pub records: Option<RecordsForm>,
    pub by_data: Option<ByDataForm>,
    #[serde(default)]
    pub args: Vec<Spanned<FieldForm>>,
    #[serde(default)]
    pub fields: Vec<Spanned<FieldForm>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordsForm {
    pub max: Option<usize>,
}

/// A request that says one operation and carries the data of another.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ByDataForm {
    pub from: String,
    pub to: String,
    pub mark: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldForm {
    pub name: String,
    #[serde(rename = "type")]
    pub kind: String,
    pub size: Option<usize>,
    pub count: Option<usize>,
    #[serde(default)]
    pub first: usize,
    pub byte_order: Option<ByteOrder>,
    pub unit: Option<String>,
    pub title: Option<String>,
    pub scale: Option<f64>,
    pub offset: Option<f64>,
    pub values: Option<ValuesForm>,
    pub assumed: Option<ValuesForm>,
    pub flags: Option<ValuesForm>,
}
