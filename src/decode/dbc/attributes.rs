//! `BA_DEF_`, `BA_DEF_DEF_`, `BA_`: the few attributes that say something about decoding.

use std::collections::{HashMap, HashSet};

use super::lexer::Kind;
use super::model::{Database, Format};
use super::parser::Parser;
use super::statement::{Statement, Trouble, integer, real, unescaped};

/// How the frames of a message look.
const FRAME_FORMAT: &str = "VFrameFormat";
/// What kind of bus it is.
const PROTOCOL: &str = "ProtocolType";

/// Place of "J1939PG" among the values of `VFrameFormat` in every file that defines them.
const J1939_FORMAT: i128 = 3;

/// Definitions and values that are applied when the whole file is read.
#[derive(Debug, Default)]
pub struct Attributes {
    formats: Vec<String>,
    default_format: Option<Format>,
    protocol: Option<String>,
    default_protocol: Option<String>,
    renamed_messages: HashMap<usize, String>,
    renamed_signals: HashMap<(usize, usize), String>,
}

impl Attributes {
    /// "attribute_definition": BA_DEF_ object "name" type ...; only one list of values matters here.
    #[allow(clippy::unnecessary_wraps, reason = "as all statements")]
    pub fn define(&mut self, rest: &mut Statement<'_, '_>) -> Result<(), Trouble> {
        rest.accept_word();
        if rest.accept_text() == Some(FRAME_FORMAT) && rest.accept_word() == Some("ENUM") {
            self.formats.clear();
            while let Some(value) = rest.accept_text() {
                self.formats.push(value.to_owned());
                rest.accept(',');
            }
        }
        skip(rest);
        Ok(())
    }

    /// "attribute_default": BA_DEF_DEF_ "name" value;
    #[allow(clippy::unnecessary_wraps, reason = "as all statements")]
    pub fn set_default(&mut self, rest: &mut Statement<'_, '_>) -> Result<(), Trouble> {
        match rest.accept_text() {
            Some(FRAME_FORMAT) => self.default_format = self.format(rest),
            Some(PROTOCOL) => self.default_protocol = rest.accept_text().map(unescaped),
            _ => {}
        }
        skip(rest);
        Ok(())
    }

    fn format(&self, rest: &mut Statement<'_, '_>) -> Option<Format> {
        let is_j1939 = match rest.next()? {
            Kind::Text(name) => name == "J1939PG",
            Kind::Word(number) => {
                let number = integer(number)?;
                let defined = usize::try_from(number).ok().and_then(|at| self.formats.get(at));
                defined.map_or(number == J1939_FORMAT, |name| name == "J1939PG")
            }
            Kind::Mark(_) => return None,
        };
        Some(if is_j1939 { Format::J1939 } else { Format::Plain })
    }

    /// Puts everything where it belongs.
    pub fn apply(&mut self, db: &mut Database) {
        db.protocol = self.protocol.take().or(self.default_protocol.take());
        let bus_is_j1939 = db.protocol.as_deref().is_some_and(|p| p.eq_ignore_ascii_case("J1939"));
        let implied =
            if bus_is_j1939 && self.formats.is_empty() { Format::J1939 } else { Format::Unsaid };
        for message in &mut db.messages {
            if message.format == Format::Unsaid {
                message.format = self.default_format.unwrap_or(implied);
            }
            // Error in some files' defaults: an 11-bit identifier has no parameter group.
            if !message.extended && message.format == Format::J1939 {
                message.format = Format::Plain;
            }
        }
        self.rename(db);
    }

    /// Names longer than 32 characters stand in attributes. They are taken where they stay unique.
    fn rename(&mut self, db: &mut Database) {
        let mut taken: HashSet<String> =
            db.messages.iter().map(|message| message.name.clone()).collect();
        for (index, message) in db.messages.iter_mut().enumerate() {
            if let Some(name) = self.renamed_messages.get(&index)
                && taken.insert(name.clone())
            {
                message.name.clone_from(name);
            }
        }
        let messages: HashSet<usize> = self.renamed_signals.keys().map(|key| key.0).collect();
        for message in messages {
            let signals = &mut db.messages[message].signals;
            let mut names: HashSet<String> =
                signals.iter().map(|signal| signal.name.clone()).collect();
            for (index, signal) in signals.iter_mut().enumerate() {
                if let Some(name) = self.renamed_signals.get(&(message, index))
                    && names.insert(name.clone())
                {
                    signal.name.clone_from(name);
                }
            }
        }
    }
}

impl<'a> Parser<'a> {
    /// "attribute_value_for_object": BA_ "name" object value;
    pub fn attribute(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        let name = rest.text("the name of an attribute in quotes")?;
        match (name, rest.accept_word()) {
            (PROTOCOL, None) => self.attributes.protocol = rest.accept_text().map(unescaped),
            (FRAME_FORMAT | "GenMsgCycleTime" | "SystemMessageLongSymbol", Some("BO_")) => {
                self.message_attribute(name, rest, line)?;
            }
            ("SystemSignalLongSymbol", Some("SG_")) => {
                let found = self.find_signal(rest)?;
                if let Some((key, long)) =
                    found.zip(rest.accept_text()).filter(|(_, t)| !t.is_empty())
                {
                    self.attributes.renamed_signals.insert(key, unescaped(long));
                }
            }
            _ => {}
        }
        skip(rest);
        Ok(())
    }

    fn message_attribute(
        &mut self,
        name: &str,
        rest: &mut Statement<'_, 'a>,
        line: u32,
    ) -> Result<(), Trouble> {
        let raw: u32 = rest.integer("identifier")?;
        let Some(index) = self.find(raw)? else { return Ok(()) };
        let message = &mut self.db.messages[index];
        match name {
            FRAME_FORMAT => match self.attributes.format(rest) {
                Some(format) => message.format = format,
                None => {
                    self.oddities.note(line, || "VFrameFormat has no value; skipped".to_owned());
                }
            },
            "GenMsgCycleTime" => {
                let time = rest.accept_word().and_then(real).unwrap_or(0.0);
                #[allow(clippy::cast_possible_truncation, reason = "saturates")]
                let time = time as u32;
                message.cycle_time = time;
            }
            _ => {
                if let Some(long) = rest.accept_text().filter(|long| !long.is_empty()) {
                    self.attributes.renamed_messages.insert(index, unescaped(long));
                }
            }
        }
        Ok(())
    }
}

fn skip(rest: &mut Statement<'_, '_>) {
    while rest.next().is_some() {}
}
