//! Words, texts in quotes and marks, with their lines.

/// The longest statement: one `VAL_` with 100,000 labels still fits.
const MAX_TOKENS: usize = 1 << 18;

/// What a token is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind<'a> {
    /// A name or a number.
    Word(&'a str),
    /// What stands between quotes, as in the file.
    Text(&'a str),
    /// One of `: ; | @ ( ) [ ] ,`.
    Mark(char),
}

/// A piece of the file.
#[derive(Clone, Copy, Debug)]
pub struct Token<'a> {
    /// What it is.
    pub kind: Kind<'a>,
    /// Where it begins, from 1.
    pub line: u32,
    /// First of its line, or behind a `;`: here a statement may begin.
    first: bool,
}

/// Cuts a file into statements.
pub struct Lexer<'a> {
    text: &'a str,
    at: usize,
    line: u32,
    first: bool,
    ahead: Option<Token<'a>>,
    /// Lines of texts whose closing quote is missing, since the last statement.
    pub unclosed: Vec<u32>,
}

impl<'a> Lexer<'a> {
    /// At the beginning of a file.
    pub fn new(text: &'a str) -> Self {
        Self { text, at: 0, line: 1, first: true, ahead: None, unclosed: Vec::new() }
    }

    /// Fills `out` with the next statement: a keyword where one may begin, and everything up to the
    /// next. What stands before the first keyword comes as a statement without one. Gives the
    /// number of tokens that are beyond the longest statement, `None` at the end.
    pub fn statement(&mut self, out: &mut Vec<Token<'a>>) -> Option<usize> {
        out.clear();
        self.unclosed.clear();
        let first = self.ahead.take().or_else(|| self.token())?;
        out.push(first);
        let mut beyond = 0;
        while let Some(token) = self.token() {
            if token.first && matches!(token.kind, Kind::Word(word) if is_keyword(word)) {
                self.ahead = Some(token);
                break;
            }
            if out.len() < MAX_TOKENS {
                out.push(token);
            } else {
                beyond += 1;
            }
        }
        Some(beyond)
    }

    fn token(&mut self) -> Option<Token<'a>> {
        self.skip_blanks();
        let rest = &self.text[self.at..];
        let next = rest.chars().next()?;
        let (line, first) = (self.line, self.first);
        let kind = match next {
            '"' => self.quoted(),
            ':' | ';' | '|' | '@' | '(' | ')' | '[' | ']' | ',' => {
                self.at += 1;
                Kind::Mark(next)
            }
            _ => {
                let end = rest.find(ends_word).unwrap_or(rest.len());
                self.at += end;
                Kind::Word(&rest[..end])
            }
        };
        self.first = next == ';';
        Some(Token { kind, line, first })
    }

    fn skip_blanks(&mut self) {
        loop {
            let rest = &self.text[self.at..];
            let blanks = rest.len() - rest.trim_start().len();
            let skipped = &rest.as_bytes()[..blanks];
            let lines = count_lines(skipped, rest.as_bytes().get(blanks));
            self.line += lines;
            self.first |= lines > 0;
            self.at += blanks;
            // Not in the format, but people write comments like this.
            let rest = &self.text[self.at..];
            if !rest.starts_with("//") {
                return;
            }
            self.at += rest.find(['\n', '\r']).unwrap_or(rest.len());
        }
    }

    /// A text. Its closing quote may be missing; then it ends where a line begins that can only be
    /// a statement, so that one slip does not swallow half of the file.
    fn quoted(&mut self) -> Kind<'a> {
        let bytes = self.text.as_bytes();
        let start = self.at + 1;
        let opened = self.line;
        let mut at = start;
        while let Some(&byte) = bytes.get(at) {
            match byte {
                b'"' => {
                    self.at = at + 1;
                    return Kind::Text(&self.text[start..at]);
                }
                // Some tools write \" for a quote inside of a text; but a text may end in a backslash.
                b'\\' if bytes.get(at + 1) == Some(&b'"') && !ends_statement(&bytes[at + 2..]) => {
                    at += 1;
                }
                b'\n' => {
                    self.line += 1;
                    if begins_statement(&self.text[at + 1..]) {
                        break;
                    }
                }
                _ => {}
            }
            at += 1;
        }
        self.unclosed.push(opened);
        // Before the line end, which has to be seen once more.
        if bytes.get(at) == Some(&b'\n') {
            self.line -= 1;
        }
        self.at = at;
        Kind::Text(self.text[start..at].trim_end())
    }
}

/// Line ends: LF, CR LF, or CR alone.
fn count_lines(bytes: &[u8], next: Option<&u8>) -> u32 {
    let mut lines = 0;
    for (index, byte) in bytes.iter().enumerate() {
        let follower = bytes.get(index + 1).or(next);
        lines += u32::from(*byte == b'\n' || (*byte == b'\r' && follower != Some(&b'\n')));
    }
    lines
}

fn ends_word(c: char) -> bool {
    c.is_whitespace() || matches!(c, '"' | ':' | ';' | '|' | '@' | '(' | ')' | '[' | ']' | ',')
}

/// `;` and nothing else follows in the line. Looks at a few bytes only: a hostile text may be made
/// of nothing but `\"`.
fn ends_statement(rest: &[u8]) -> bool {
    let near = &rest[..rest.len().min(32)];
    let line = near.split(|&byte| byte == b'\n' || byte == b'\r').next().unwrap_or_default();
    line.trim_ascii() == b";"
}

/// `VERSION`, or capitals, digits and `_`, and a `_` at the end: all sections of a DBC, also those
/// that we do not know.
pub fn is_keyword(word: &str) -> bool {
    let fits = |byte: u8| byte.is_ascii_uppercase() || byte.is_ascii_digit() || byte == b'_';
    word == "VERSION"
        || (word.len() > 2
            && word.ends_with('_')
            && word.starts_with(|c: char| c.is_ascii_uppercase())
            && word.bytes().all(fits))
}

/// The line can hardly be anything but the beginning of a statement, not a line of a comment.
fn begins_statement(text: &str) -> bool {
    let line = text.trim_start_matches([' ', '\t']);
    let end = line.bytes().take(40).position(|b| b == b' ' || b == b'\t');
    let Some((keyword, rest)) = end.and_then(|end| line.split_at_checked(end)) else {
        return false;
    };
    let next = rest.trim_start_matches([' ', '\t']).as_bytes().first();
    let number = next.is_some_and(u8::is_ascii_digit);
    match keyword {
        "BO_" | "VAL_" | "SIG_VALTYPE_" | "SG_MUL_VAL_" | "BO_TX_BU_" | "SIG_GROUP_" => number,
        "SG_" => rest.bytes().take(200).any(|byte| byte == b'@'),
        "CM_" | "BA_" | "BA_DEF_" | "BA_DEF_DEF_" => {
            next == Some(&b'"')
                || ["SG_ ", "BO_ ", "BU_ ", "EV_ "]
                    .iter()
                    .any(|object| rest.trim_start_matches([' ', '\t']).starts_with(object))
        }
        _ => false,
    }
}
