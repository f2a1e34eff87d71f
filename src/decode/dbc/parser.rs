//! From statements to a database.

use std::collections::{HashMap, HashSet};

use super::attributes::Attributes;
use super::lexer::{Kind, Lexer, Token, is_keyword};
use super::model::{Database, Labels};
use super::multiplex::{self, Written};
use super::names::Names;
use super::oddities::Oddities;
use super::statement::{Statement, Trouble, integer, short, unescaped};

/// So many nodes are kept.
const MAX_NODES: usize = 4096;

/// Sections without a meaning for decoding.
const IGNORED: [&str; 20] = [
    "EV_",
    "EV_DATA_",
    "ENVVAR_DATA_",
    "SGTYPE_",
    "SGTYPE_VAL_",
    "SIG_TYPE_REF_",
    "SIGTYPE_VALTYPE_",
    "SIG_GROUP_",
    "BA_DEF_SGTYPE_",
    "BA_SGTYPE_",
    "NS_DESC_",
    "CAT_DEF_",
    "CAT_",
    "BA_DEF_REL_",
    "BA_REL_",
    "BA_DEF_DEF_REL_",
    "BU_SG_REL_",
    "BU_EV_REL_",
    "BU_BO_REL_",
    "BU_EV_",
];

/// What is known while a file is read.
#[derive(Default)]
pub struct Parser<'a> {
    pub db: Database,
    pub oddities: Oddities,
    /// By identifier as in the file; `None`: refused, and said so.
    pub messages: HashMap<u32, Option<usize>>,
    /// The messages by the identifier that their number means, and whether it has 29 bits.
    pub identifiers: HashMap<(u32, bool), usize>,
    /// By message and name in the file.
    pub signals: HashMap<(usize, &'a str), usize>,
    pub tables: HashMap<&'a str, Labels>,
    /// How signals are multiplexed, as written.
    pub written: Written,
    pub attributes: Attributes,
    /// Takes the `SG_` that follow; `None` behind a message that was refused.
    pub open: Option<usize>,
    pub message_seen: bool,
    pub message_names: Names,
    pub signal_names: Names,
    pub total_signals: usize,
    pub total_ranges: usize,
    pub total_labels: usize,
    unknown: HashSet<&'a str>,
}

/// Reads a whole file.
pub fn parse(text: &str) -> (Database, Oddities) {
    let mut parser = Parser::default();
    let mut lexer = Lexer::new(text);
    let mut tokens = Vec::new();
    while let Some(beyond) = lexer.statement(&mut tokens) {
        let line = tokens.first().map_or(0, |token| token.line);
        for opened in lexer.unclosed.drain(..) {
            parser.oddities.note(opened, || {
                "a text has no closing quote; it ends where the next statement begins".to_owned()
            });
        }
        if beyond > 0 {
            let text = || format!("the statement is too long; its last {beyond} words are skipped");
            parser.oddities.lose(line, text);
        }
        parser.statement(&tokens, line);
    }
    let mut attributes = std::mem::take(&mut parser.attributes);
    attributes.apply(&mut parser.db);
    multiplex::resolve(&mut parser.db, parser.written, &mut parser.oddities);
    parser.oddities.sort();
    (parser.db, parser.oddities)
}

impl<'a> Parser<'a> {
    fn statement(&mut self, tokens: &[Token<'a>], line: u32) {
        let mut rest = Statement::new(tokens);
        let keyword = match rest.peek() {
            Some(Kind::Word(word)) if is_keyword(word) => word,
            _ => return self.strange(tokens, "stands before the first section"),
        };
        rest.next();
        // The list of NS_ names sections without content.
        if rest.ended() {
            return;
        }
        let done = match keyword {
            "VERSION" => self.version(&mut rest),
            "BU_" => self.nodes(&mut rest),
            "BO_" => self.message(&mut rest, line),
            "SG_" => self.signal(&mut rest, line),
            "SG_MUL_VAL_" => self.extended_multiplexing(&mut rest),
            "VAL_TABLE_" => self.value_table(&mut rest, line),
            "VAL_" => self.values(&mut rest, line),
            "CM_" => self.comment(&mut rest),
            "BA_DEF_" => self.attributes.define(&mut rest),
            "BA_DEF_DEF_" => self.attributes.set_default(&mut rest),
            "BA_" => self.attribute(&mut rest, line),
            "SIG_VALTYPE_" => self.value_type(&mut rest, line),
            "BO_TX_BU_" => self.senders(&mut rest),
            "NS_" => return,
            "BS_" => bit_timing(&mut rest),
            ignored if IGNORED.contains(&ignored) => skip(&mut rest),
            unknown => return self.unknown_section(unknown, line),
        };
        match done {
            Ok(()) if rest.ended() => {}
            Ok(()) => self.rest(&rest, keyword, line),
            Err(trouble) => self.oddities.lose(line, || format!("{keyword}: {trouble}; skipped")),
        }
    }

    fn rest(&mut self, rest: &Statement<'_, 'a>, keyword: &str, line: u32) {
        let found = match rest.peek() {
            Some(Kind::Word(text) | Kind::Text(text)) => short(text),
            Some(Kind::Mark(mark)) => format!("\"{mark}\""),
            None => return,
        };
        self.oddities.note(line, || format!("what follows {keyword} from {found} on is skipped"));
    }

    fn strange(&mut self, tokens: &[Token<'a>], why: &str) {
        if let Some(Token { kind: Kind::Word(text) | Kind::Text(text), line, .. }) = tokens.first()
        {
            self.oddities.note(*line, || format!("{} {why}; skipped", short(text)));
        }
    }

    fn unknown_section(&mut self, keyword: &'a str, line: u32) {
        if self.unknown.len() < 1000 && self.unknown.insert(keyword) {
            let text = || format!("section {} is not known; skipped", short(keyword));
            self.oddities.note(line, text);
        }
    }

    fn version(&mut self, rest: &mut Statement<'_, 'a>) -> Result<(), Trouble> {
        self.db.version = unescaped(rest.text("a version in quotes")?);
        Ok(())
    }

    fn nodes(&mut self, rest: &mut Statement<'_, 'a>) -> Result<(), Trouble> {
        rest.mark(':')?;
        while let Some(node) = rest.accept_word() {
            if self.db.nodes.len() >= MAX_NODES {
                return Err(format!("there are {MAX_NODES} nodes already"));
            }
            self.db.nodes.push(node.to_owned());
            rest.accept(',');
        }
        Ok(())
    }
}

/// "bit_timing": `BS_: baudrate : BTR1 , BTR2`, obsolete.
#[allow(clippy::unnecessary_wraps, reason = "as all statements")]
fn bit_timing(rest: &mut Statement<'_, '_>) -> Result<(), Trouble> {
    loop {
        match rest.peek() {
            Some(Kind::Mark(_)) => {}
            Some(Kind::Word(word)) if integer(word).is_some() => {}
            _ => return Ok(()),
        }
        rest.next();
    }
}

/// To the end of the statement.
#[allow(clippy::unnecessary_wraps, reason = "as all statements")]
fn skip(rest: &mut Statement<'_, '_>) -> Result<(), Trouble> {
    while rest.next().is_some_and(|kind| kind != Kind::Mark(';')) {}
    Ok(())
}
