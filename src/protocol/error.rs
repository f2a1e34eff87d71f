//! What is wrong with a definition, and where.

use std::ops::Range;

/// A definition that cannot be used: the file, the line, what is wrong and what is expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {text}", line.map_or(String::new(), |line| format!(", line {line}")))]
pub struct DefinitionError {
    /// The file, as the user named it.
    pub file: String,
    /// Line, counted from 1; `None` when the whole file is meant.
    pub line: Option<usize>,
    /// What is wrong and what is expected.
    pub text: String,
}

/// Longest text of an error, in characters; what it quotes may be longer.
const LONGEST: usize = 2000;

/// The same while compiling, when only the place in the text is known.
#[derive(Debug)]
pub struct Fault {
    /// Bytes of the text, `None` for the whole file.
    pub span: Option<Range<usize>>,
    /// What is wrong and what is expected.
    pub text: String,
}

impl Fault {
    /// A fault at a place in the text.
    pub fn at(span: Range<usize>, text: impl Into<String>) -> Self {
        Self { span: Some(span), text: text.into() }
    }

    /// Names the file and counts the lines.
    pub fn in_file(self, file: &str, source: &str) -> DefinitionError {
        let line = self.span.map(|span| {
            let before = source.as_bytes().get(..span.start).unwrap_or_default();
            1 + before.split(|byte| *byte == b'\n').count().saturating_sub(1)
        });
        let text = self.text.chars().take(LONGEST).collect();
        DefinitionError { file: file.to_owned(), line, text }
    }
}

impl From<toml::de::Error> for Fault {
    fn from(error: toml::de::Error) -> Self {
        Self { span: error.span(), text: error.message().to_owned() }
    }
}
