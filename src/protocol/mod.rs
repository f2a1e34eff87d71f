//! Serial protocols as data: a definition in TOML says how bytes become frames, frames messages
//! and messages fields. Nothing here knows a device, reads a file or looks at a clock.
//!
//! The language is described in `docs/protocols-serial.md`.

pub mod condition;
pub mod crc;
pub mod decoder;
pub mod definition;
pub mod deframer;
pub mod encoder;
pub mod error;
pub mod framing;
pub mod item;
pub mod json;
pub mod message;
pub mod pairing;
pub mod payload;
#[cfg(test)]
mod tests;
pub mod word;

use std::collections::HashMap;
use std::sync::Arc;

pub use condition::Side;
pub use decoder::Decoder;
pub use definition::{ByteOrder, LineForm, Parity};
pub use error::DefinitionError;
pub use item::{FrameItem, Item, ItemKind};
pub use message::Command;

use condition::Condition;
use definition::{Carries, compile};
use framing::Framing;
use pairing::PairingRules;
use word::{Block, Quantity};

use crate::frame::Direction;

/// The definitions that come with the program: name and text.
pub const BUILT_IN: &[(&str, &str)] =
    &[("zhongheng-09", include_str!("../../schemas/zhongheng-09.toml"))];

/// What a user may change without writing a definition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// `byte_order=big|little`: of the fields of commands; the definition's when `None`.
    pub byte_order: Option<ByteOrder>,
    /// `assume=true`: also use value tables that are assumed, not printed in the source.
    pub assume: bool,
}

impl Settings {
    /// Reads `byte_order=little,assume=true`. The error is the whole sentence.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut settings = Self::default();
        for setting in text.split(',').filter(|setting| !setting.is_empty()) {
            match setting {
                "byte_order=big" => settings.byte_order = Some(ByteOrder::Big),
                "byte_order=little" => settings.byte_order = Some(ByteOrder::Little),
                "assume=true" => settings.assume = true,
                "assume=false" => settings.assume = false,
                other => {
                    return Err(format!(
                        "protocol setting \"{other}\" is not known; there are byte_order=big, \
                         byte_order=little, assume=true and assume=false"
                    ));
                }
            }
        }
        Ok(settings)
    }
}

/// What the data of an operation are, both ways.
#[derive(Clone, Copy, Debug)]
pub struct Operation {
    /// In a request.
    pub request: Carries,
    /// In a good response.
    pub response: Carries,
}

/// A protocol, ready to decode with.
#[derive(Debug)]
pub struct Protocol {
    /// Its name.
    pub name: String,
    /// What people call it.
    pub title: Option<String>,
    /// How the port is set, if the definition says so.
    pub line: Option<LineForm>,
    /// The commands, in the definition's order.
    pub commands: Vec<Arc<Command>>,
    framing: Arc<Framing>,
    direction: Option<DirectionRule>,
    checks: Vec<CheckRule>,
    operations: HashMap<Arc<str>, Operation>,
    /// Set when there is one operation only, which then need not be said.
    only_operation: Option<Arc<str>>,
    request: Option<MessageRules>,
    response: Option<MessageRules>,
    report: Option<MessageRules>,
    /// The header's number that tells kinds of frames apart.
    link: Option<usize>,
    pairing: Option<PairingRules>,
    error_answer: Option<encoder::ErrorAnswer>,
    by_id: HashMap<u64, Arc<Command>>,
}

impl Protocol {
    /// Compiles a definition; `file` is its name in error messages.
    pub fn parse(file: &str, text: &str, settings: Settings) -> Result<Self, DefinitionError> {
        compile::protocol(text, settings).map_err(|fault| fault.in_file(file, text))
    }

    /// The numbers in the header of a frame.
    pub fn header(&self) -> &[Arc<Quantity>] {
        &self.framing.layout.header.quantities
    }

    /// The numbers in front of the data of a response.
    pub fn status(&self) -> &[Arc<Quantity>] {
        self.response.as_ref().map_or(&[], |rules| &rules.prefix.quantities)
    }

    /// A protocol that comes with the program; `None` if there is none of that name.
    pub fn built_in(name: &str, settings: Settings) -> Option<Result<Self, DefinitionError>> {
        let (name, text) = BUILT_IN.iter().find(|(known, _)| *known == name)?;
        Some(Self::parse(&format!("{name}.toml"), text, settings))
    }
}

/// How to know who sent a frame.
#[derive(Clone, Copy, Debug)]
enum DirectionRule {
    /// The host asks.
    Line,
    /// A number of the header: its place, the value of requests, the value of responses.
    Number(usize, u64, u64),
}

impl DirectionRule {
    fn side(&self, way: Direction, header: &[u64]) -> Option<Side> {
        match (self, way) {
            (Self::Line, Direction::Tx) => Some(Side::Request),
            (Self::Line, Direction::Rx) => Some(Side::Response),
            (Self::Number(index, request, response), _) => match header.get(*index) {
                Some(value) if value == request => Some(Side::Request),
                Some(value) if value == response => Some(Side::Response),
                _ => None,
            },
        }
    }
}

/// A frame with `when` and without `unless` is wrong.
#[derive(Clone, Debug)]
struct CheckRule {
    name: Arc<str>,
    when: Condition,
    unless: Condition,
}

/// One kind of message. Numbers are places among those of the header and, behind them, those of
/// the prefix.
#[derive(Clone, Debug)]
struct MessageRules {
    when: Condition,
    /// What stands in front of a command's data.
    prefix: Block,
    /// The command's number.
    command: Option<usize>,
    /// The number whose label names the operation.
    operation: Option<usize>,
    /// What the data are when the protocol has no operations.
    unnamed: Option<Carries>,
    /// When a response is a good one.
    ok: Condition,
}
