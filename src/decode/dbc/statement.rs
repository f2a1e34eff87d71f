//! One statement, read from left to right.

use super::lexer::{Kind, Token};
use super::model::whole;

/// Why a statement cannot be used.
pub type Trouble = String;

/// The tokens of a statement that were not read yet.
pub struct Statement<'s, 'a> {
    tokens: &'s [Token<'a>],
}

impl<'s, 'a> Statement<'s, 'a> {
    /// All of it.
    pub fn new(tokens: &'s [Token<'a>]) -> Self {
        Self { tokens }
    }

    /// The next token, left where it is.
    pub fn peek(&self) -> Option<Kind<'a>> {
        self.tokens.first().map(|token| token.kind)
    }

    /// Takes the next token.
    pub fn next(&mut self) -> Option<Kind<'a>> {
        let (first, rest) = self.tokens.split_first()?;
        self.tokens = rest;
        Some(first.kind)
    }

    /// Nothing is left but the final `;`.
    pub fn ended(&self) -> bool {
        self.tokens.iter().all(|token| token.kind == Kind::Mark(';'))
    }

    /// Takes a mark if it is next.
    pub fn accept(&mut self, mark: char) -> bool {
        let found = self.peek() == Some(Kind::Mark(mark));
        if found {
            self.next();
        }
        found
    }

    /// Takes a mark that must be next.
    pub fn mark(&mut self, mark: char) -> Result<(), Trouble> {
        if self.accept(mark) { Ok(()) } else { Err(self.unexpected(&format!("\"{mark}\""))) }
    }

    /// Takes a word if it is next.
    pub fn accept_word(&mut self) -> Option<&'a str> {
        let Some(Kind::Word(word)) = self.peek() else { return None };
        self.next();
        Some(word)
    }

    /// Takes a word that must be next.
    pub fn word(&mut self, what: &str) -> Result<&'a str, Trouble> {
        self.accept_word().ok_or_else(|| self.unexpected(what))
    }

    /// Takes a text in quotes if it is next.
    pub fn accept_text(&mut self) -> Option<&'a str> {
        let Some(Kind::Text(text)) = self.peek() else { return None };
        self.next();
        Some(text)
    }

    /// Takes a text in quotes that must be next.
    pub fn text(&mut self, what: &str) -> Result<&'a str, Trouble> {
        self.accept_text().ok_or_else(|| self.unexpected(what))
    }

    /// Takes an integer that must be next.
    pub fn integer<T: TryFrom<i128>>(&mut self, what: &str) -> Result<T, Trouble> {
        let word = self.word(what)?;
        let number = integer(word).and_then(|number| T::try_from(number).ok());
        number.ok_or_else(|| format!("{} is no {what}", short(word)))
    }

    /// Takes a number that must be next.
    pub fn real(&mut self, what: &str) -> Result<f64, Trouble> {
        let word = self.word(what)?;
        real(word).ok_or_else(|| format!("{} is no {what}", short(word)))
    }

    fn unexpected(&self, what: &str) -> Trouble {
        match self.peek() {
            Some(Kind::Word(found) | Kind::Text(found)) => {
                format!("{} stands where {what} should be", short(found))
            }
            Some(Kind::Mark(found)) => format!("\"{found}\" stands where {what} should be"),
            None => format!("{what} is missing"),
        }
    }
}

/// A word for a message, cut when it is long.
pub fn short(word: &str) -> String {
    match word.char_indices().nth(60) {
        Some((cut, _)) => format!("\"{}...\"", &word[..cut]),
        None => format!("\"{word}\""),
    }
}

/// An integer in decimal or hexadecimal, also written as `1.0` or `1E3`.
pub fn integer(word: &str) -> Option<i128> {
    if let Some(digits) = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X")) {
        return u64::from_str_radix(digits, 16).ok().map(i128::from);
    }
    word.parse().ok().or_else(|| whole(real(word)?))
}

/// A finite number in any usual notation: `1`, `.5`, `5.`, `+1E-003`.
pub fn real(word: &str) -> Option<f64> {
    word.parse().ok().filter(|number: &f64| number.is_finite())
}

/// What stands between quotes, `\"` resolved.
pub fn unescaped(text: &str) -> String {
    text.replace("\\\"", "\"")
}
