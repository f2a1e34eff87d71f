//! `VAL_TABLE_`, `VAL_`, `CM_`, `BO_TX_BU_`: texts for people.

use super::lexer::Kind;
use super::model::{Labels, MAX_LIST};
use super::parser::Parser;
use super::statement::{Statement, Trouble, integer, short, unescaped};

impl<'a> Parser<'a> {
    /// "value_table": `VAL_TABLE_ name value "text" ... ;`
    pub fn value_table(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        let name = rest.word("the name of a table")?;
        let labels = self.labels(rest, line);
        self.tables.insert(name, labels);
        Ok(())
    }

    /// "value_encoding_for_signal": `VAL_ id signal value "text" ... ;` or the name of a table.
    pub fn values(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        if let Some(Kind::Word(word)) = rest.peek()
            && integer(word).is_none()
        {
            // Of an environment variable, which no frame carries.
            while rest.next().is_some() {}
            return Ok(());
        }
        let Some((message, index)) = self.find_signal(rest)? else { return Ok(()) };
        let table = match rest.peek() {
            Some(Kind::Word(name)) => self.tables.get(name).filter(|_| integer(name).is_none()),
            _ => None,
        };
        let labels = if let Some(table) = table.cloned() {
            rest.next();
            table
        } else {
            self.labels(rest, line)
        };
        self.db.messages[message].signals[index].labels = Some(labels);
        Ok(())
    }

    fn labels(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Labels {
        let mut labels: Vec<(i128, Box<str>)> = Vec::new();
        while let Some(word) = rest.accept_word() {
            let text = rest.accept_text();
            match (integer(word), text) {
                (Some(_), Some(_)) if self.total_labels >= MAX_LIST => {
                    let trouble = || format!("there are {MAX_LIST} texts already; skipped");
                    self.oddities.lose(line, trouble);
                }
                (Some(value), Some(text)) => {
                    self.total_labels += 1;
                    labels.push((value, unescaped(text).into()));
                }
                (None, _) => {
                    self.oddities
                        .lose(line, || format!("{} is no raw value; skipped", short(word)));
                }
                (_, None) => {
                    let trouble = || format!("value {} has no text; skipped", short(word));
                    self.oddities.lose(line, trouble);
                }
            }
        }
        labels.sort_by_key(|(value, _)| *value);
        let all = labels.len();
        labels.dedup_by_key(|(value, _)| *value);
        if labels.len() < all {
            let twice = all - labels.len();
            self.oddities.note(line, || {
                format!("{twice} values of a table have a second text; the first one stays")
            });
        }
        labels.into()
    }

    /// "comment": `CM_ [object] "text";`
    pub fn comment(&mut self, rest: &mut Statement<'_, 'a>) -> Result<(), Trouble> {
        match rest.accept_word() {
            None => self.db.comment = unescaped(rest.text("a comment in quotes")?),
            Some("BO_") => {
                let raw: u32 = rest.integer("identifier")?;
                let found = self.find(raw)?;
                let text = unescaped(rest.text("a comment in quotes")?);
                if let Some(index) = found {
                    self.db.messages[index].comment = text;
                }
            }
            Some("SG_") => {
                let found = self.find_signal(rest)?;
                if let Some((message, index)) = found {
                    let text = unescaped(rest.text("a comment in quotes")?);
                    self.db.messages[message].signals[index].comment = text;
                }
            }
            // Nodes and environment variables.
            Some(_) => while rest.next().is_some() {},
        }
        Ok(())
    }

    /// "message_transmitters": `BO_TX_BU_ id : node, node;`
    pub fn senders(&mut self, rest: &mut Statement<'_, 'a>) -> Result<(), Trouble> {
        let raw: u32 = rest.integer("identifier")?;
        rest.accept(':');
        let found = self.find(raw)?;
        while let Some(word) = rest.accept_word() {
            rest.accept(',');
            let Some(index) = found else { continue };
            let senders = &mut self.db.messages[index].senders;
            // So many nodes send no message; a hostile list must not be searched again and again.
            if senders.len() < 32 && !senders.iter().any(|sender| sender == word) {
                senders.push(word.to_owned());
            }
        }
        Ok(())
    }
}
