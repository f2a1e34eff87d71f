//! DBC files: what Vector's "DBC File Format Documentation", version 1.0, describes, and what real
//! tools make of it.
//!
//! Files in the field are written by many programs and by hand. The parser therefore goes on after
//! everything it does not understand: it loads what has a meaning, and lists the rest as
//! [`Oddity`]s, each with its line and what was done about it.

mod attributes;
mod lexer;
mod message;
mod model;
mod multiplex;
pub mod names;
mod oddities;
mod parser;
mod signal;
mod statement;
mod texts;

use std::borrow::Cow;

pub use model::{
    ByteOrder, Database, Format, Gate, Labels, MAX_LIST, MAX_SIGNALS, MAX_SIGNALS_PER_MESSAGE,
    Message, Number, Signal,
};
pub use oddities::{Oddities, Oddity};

/// The largest file that is read; the largest known to us has 12 MiB.
pub const MAX_FILE: usize = 64 << 20;

/// Why a file cannot be used at all.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum DbcError {
    /// Larger than [`MAX_FILE`].
    #[error("it is larger than 64 MiB; no database of a bus is")]
    TooLarge,
    /// Holds bytes that no text has.
    #[error("it is not a text file (byte 0 at offset {0})")]
    NotText(usize),
    /// Nothing could be decoded with it.
    #[error("it defines no message (no line \"BO_ ID NAME: LENGTH SENDER\" could be read)")]
    NoMessages,
}

/// A database, and what was odd about its file.
#[derive(Debug)]
pub struct Parsed {
    /// What the file defines.
    pub database: Database,
    /// What was odd, in the order of lines.
    pub oddities: Oddities,
}

/// Reads the bytes of a DBC file.
pub fn parse(bytes: &[u8]) -> Result<Parsed, DbcError> {
    if bytes.len() > MAX_FILE {
        return Err(DbcError::TooLarge);
    }
    let text = text(bytes)?;
    let (database, oddities) = parser::parse(&text);
    if database.messages.is_empty() {
        return Err(DbcError::NoMessages);
    }
    Ok(Parsed { database, oddities })
}

/// The text of a file: UTF-8 where it is valid, else Windows code page 1252, which the classic
/// editor writes.
fn text(bytes: &[u8]) -> Result<Cow<'_, str>, DbcError> {
    if let Some(offset) = bytes.iter().position(|&byte| byte == 0) {
        return Err(DbcError::NotText(offset));
    }
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    Ok(match str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|&byte| cp1252(byte)).collect()),
    })
}

/// A byte of Windows code page 1252. The five bytes that it does not define keep their value, as
/// the WHATWG encoding standard has it.
fn cp1252(byte: u8) -> char {
    const HIGH: [char; 32] = [
        '€', '\u{81}', '‚', 'ƒ', '„', '…', '†', '‡', 'ˆ', '‰', 'Š', '‹', 'Œ', '\u{8D}', 'Ž',
        '\u{8F}', '\u{90}', '‘', '’', '“', '”', '•', '–', '—', '˜', '™', 'š', '›', 'œ', '\u{9D}',
        'ž', 'Ÿ',
    ];
    match byte {
        0x80..=0x9F => HIGH[usize::from(byte - 0x80)],
        _ => char::from(byte),
    }
}
