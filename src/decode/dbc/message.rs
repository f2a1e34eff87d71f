//! `BO_`: messages.

use super::model::Message;
use super::names::Names;
use super::parser::Parser;
use super::statement::{Statement, Trouble};

/// `VECTOR__INDEPENDENT_SIG_MSG`: where editors keep signals that belong to no message.
const INDEPENDENT: u32 = 0xC000_0000;
/// Marks a 29-bit identifier.
const EXTENDED: u32 = 0x8000_0000;

/// Longest message, bytes: 255 frames of J1939's transport protocol.
const MAX_LENGTH: u16 = 1785;

/// So many messages of a file are loaded; the others are counted.
const MAX_MESSAGES: usize = 1 << 16;

impl<'a> Parser<'a> {
    /// "message": `BO_ id name: size transmitter`.
    pub fn message(&mut self, rest: &mut Statement<'_, 'a>, line: u32) -> Result<(), Trouble> {
        self.open = None;
        self.message_seen = true;
        self.signal_names = Names::default();
        let raw: u32 = rest.integer("identifier (32 bits)")?;
        let name = rest.word("a name")?;
        rest.mark(':')?;
        let length: u64 = rest.integer("length in bytes")?;
        let sender = rest.accept_word().filter(|sender| *sender != "Vector__XXX");
        if raw == INDEPENDENT {
            self.messages.insert(raw, None);
            return Ok(());
        }
        if let Some(Some(first)) = self.messages.get(&raw) {
            return Err(self.defined_before(*first, raw & !EXTENDED, name));
        }
        if self.db.messages.len() >= MAX_MESSAGES {
            return Err(format!("there are {MAX_MESSAGES} messages already; {name} is left out"));
        }
        let (id, extended) = self.identifier(raw, line);
        // Different numbers may mean one identifier, whose frames would find only one of the two.
        if let Some(first) = self.identifiers.get(&(id, extended)) {
            let why = self.defined_before(*first, id, name);
            self.messages.insert(raw, None);
            return Err(why);
        }
        if length > u64::from(MAX_LENGTH) {
            let text = || format!("{name} cannot have {length} bytes; read as {MAX_LENGTH}");
            self.oddities.note(line, text);
        }
        let length = u16::try_from(length).map_or(MAX_LENGTH, |length| length.min(MAX_LENGTH));
        let unique = self.message_names.take(name);
        if unique != name {
            let text = || format!("a message {name} was there before; this one is called {unique}");
            self.oddities.note(line, text);
        }
        let senders = sender.map(str::to_owned).into_iter().collect();
        let index = self.db.messages.len();
        self.messages.insert(raw, Some(index));
        self.identifiers.insert((id, extended), index);
        self.open = Some(index);
        let name = unique;
        self.db.messages.push(Message {
            id,
            extended,
            name,
            length,
            senders,
            line,
            ..Message::default()
        });
        Ok(())
    }

    fn defined_before(&self, first: usize, id: u32, name: &str) -> String {
        let first = self.db.messages.get(first).map_or(0, |message| message.line);
        format!(
            "identifier 0x{id:X} of {name} was defined in line {first} already, which stays; this \
             one with its signals is left out"
        )
    }

    fn identifier(&mut self, raw: u32, line: u32) -> (u32, bool) {
        let (id, extended) = (raw & 0x1FFF_FFFF, raw & EXTENDED != 0);
        if raw & 0x6000_0000 != 0 {
            let text = || format!("bits 29 and 30 of identifier {raw} mean nothing; read as 0");
            self.oddities.note(line, text);
        }
        if !extended && id > 0x7FF {
            self.oddities.note(line, || {
                format!("identifier 0x{id:X} does not fit in 11 bits; read as one of 29 bits")
            });
        }
        (id, extended || id > 0x7FF)
    }

    /// The message that a statement is about; `None` when it was refused before.
    pub fn find(&self, raw: u32) -> Result<Option<usize>, Trouble> {
        match self.messages.get(&raw) {
            Some(found) => Ok(*found),
            None => Err(format!("there is no message {} (0x{:X})", raw, raw & !EXTENDED)),
        }
    }
}
