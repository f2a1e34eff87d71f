//! What a definition file may say, as it is written. `compile` checks it and resolves the names.
//!
//! Every table refuses keys that it does not know, so that a misspelt one is an error and not a
//! setting that silently does nothing.

#![allow(missing_docs, reason = "docs/protocols-serial.md says what the keys mean")]

pub mod compile;
pub mod frame_forms;
pub mod framing;
pub mod message_forms;
pub mod messages;
pub mod payloads;
pub mod values;
pub mod words;

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

pub use frame_forms::{
    BitsForm, CrcForm, EscapeForm, Format, FramingForm, LengthForm, ValuesForm, WordForm,
};
pub use message_forms::{
    ByDataForm, Carries, CheckForm, CommandForm, ConditionForm, DirectionForm, ErrorAnswerForm,
    FieldForm, LinkForm, MessageForm, OneOrMany, OperationForm, PairingForm, Scalar,
};

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
    pub error_answer: Option<Spanned<ErrorAnswerForm>>,
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
