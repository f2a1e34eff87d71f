//! How rules are written. Every table refuses keys that it does not know.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use crate::protocol::DefinitionError;
use crate::protocol::definition::{
    ByteOrder, FieldForm, LengthForm, OneOrMany, Table, compile::LONGEST,
};
use crate::protocol::error::Fault;

/// Whether the text of a TOML file is about CAN: it names a database, or has tables that only
/// protocols for CAN have.
pub fn is_can(text: &str) -> bool {
    let keys = ["dbc", "remote", "context", "assembly", "answer", "log"];
    let table = text.parse::<toml::Table>();
    table.is_ok_and(|table| keys.iter().any(|key| table.contains_key(*key)))
}

/// A file of rules, read but not yet joined to its database.
#[derive(Debug)]
pub struct Rules {
    pub(super) file: String,
    pub(super) text: String,
    pub(super) form: RulesForm,
}

impl Rules {
    /// Reads the text of `file`, which is its name in error messages.
    pub fn read(file: &str, text: &str) -> Result<Self, DefinitionError> {
        let form = Self::form(text).map_err(|fault| fault.in_file(file, text))?;
        Ok(Self { file: file.to_owned(), text: text.to_owned(), form })
    }

    fn form(text: &str) -> Result<RulesForm, Fault> {
        if text.len() > LONGEST {
            let text = format!("rules of {} bytes; expected {LONGEST} at most", text.len());
            return Err(Fault { span: None, text });
        }
        Ok(toml::from_str(text)?)
    }

    /// The DBC file that the rules belong to, relative to their own file.
    pub fn dbc(&self) -> &str {
        self.form.dbc.get_ref()
    }

    /// The protocol's name.
    pub fn name(&self) -> &str {
        &self.form.name
    }
}

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RulesForm {
    pub name: String,
    pub title: Option<String>,
    #[serde(rename = "source")]
    pub _source: Option<String>,
    pub dbc: Spanned<String>,
    #[serde(default)]
    pub j1939: bool,
    #[serde(default)]
    pub byte_order: ByteOrder,
    #[serde(default)]
    pub remote: Vec<Spanned<RemoteForm>>,
    #[serde(default)]
    pub context: Vec<Spanned<ContextForm>>,
    #[serde(default)]
    pub assembly: Vec<Spanned<AssemblyForm>>,
    #[serde(default)]
    pub answer: Vec<Spanned<AnswerForm>>,
    #[serde(default)]
    pub log: Vec<Spanned<LogForm>>,
    #[serde(default)]
    pub values: BTreeMap<String, Spanned<Table>>,
    #[serde(default)]
    pub flags: BTreeMap<String, Spanned<Table>>,
}

/// `[[answer]]`: messages that answer others.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnswerForm {
    pub request: Spanned<OneOrMany<String>>,
    pub answer: Spanned<OneOrMany<String>>,
}

/// `[[remote]]`: a remote frame that is a message.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteForm {
    pub id: Spanned<u32>,
    pub extended: Option<bool>,
    pub name: Spanned<String>,
    pub title: Option<String>,
    pub sender: Option<Spanned<String>>,
}

/// `[[context]]`: another meaning of an identifier.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextForm {
    pub id: Spanned<u32>,
    pub extended: Option<bool>,
    pub message: Spanned<String>,
    pub like: Option<Spanned<String>>,
    pub title: Option<String>,
    pub length: Option<OneOrMany<usize>>,
    pub after: Option<Spanned<OneOrMany<String>>>,
    pub among: Option<Spanned<AmongForm>>,
    pub within_ms: Option<u64>,
}

/// Identifiers that agree in the bits of `mask`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AmongForm {
    pub id: u32,
    pub mask: u32,
}

/// `[[log]]`: messages that are events, for the log of a recording.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogForm {
    pub messages: Spanned<Vec<String>>,
    #[serde(default)]
    pub level: LevelForm,
    pub text: Option<String>,
}

/// How much an event matters.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LevelForm {
    #[default]
    Info,
    Warning,
    Error,
}

/// `[[assembly]]`: a message of several frames.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssemblyForm {
    pub name: Spanned<String>,
    pub kind: Spanned<String>,
    pub title: Option<String>,
    #[serde(default)]
    pub messages: Vec<Spanned<String>>,
    pub first: Option<Spanned<String>>,
    pub number: Option<Spanned<u32>>,
    pub length: Option<Spanned<LengthForm>>,
    pub timeout_ms: Option<u64>,
    #[serde(default)]
    pub constants: BTreeMap<String, String>,
    #[serde(default)]
    pub fields: Vec<Spanned<FieldForm>>,
    #[serde(default)]
    pub labels: BTreeMap<String, Spanned<String>>,
    pub raw: Option<Spanned<String>>,
}
