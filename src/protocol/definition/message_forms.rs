//! How directions, messages, pairing and commands are written.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use super::{ByteOrder, ValuesForm, WordForm};

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

/// `[error_answer]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorAnswerForm {
    #[serde(default)]
    pub set: BTreeMap<String, Scalar>,
    #[serde(default)]
    pub data: Vec<u8>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SameForm {
    pub field: String,
    pub reason: String,
    #[serde(default)]
    pub sequence: bool,
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
