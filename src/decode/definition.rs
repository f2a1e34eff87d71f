//! What the frames of a bus mean: a database, and the rules that a database cannot say.

use super::answers::AnswerRule;
use super::assembly::Assembly;
use super::can::{CanDecoder, Reading};
use super::context::Meaning;
use super::dbc::{Database, Message};
use crate::frame::{CanFlags, CanFrame, Level};

/// A CAN protocol, ready to decode with.
#[derive(Debug)]
pub struct CanDefinition {
    pub(super) name: String,
    pub(super) title: Option<String>,
    pub(super) decoder: CanDecoder,
    pub(super) remotes: Vec<RemoteMessage>,
    pub(super) meanings: Vec<Meaning>,
    pub(super) assemblies: Vec<Assembly>,
    pub(super) answers: Vec<AnswerRule>,
    /// By message: whether a rule is about it.
    pub(super) ruled: Vec<bool>,
    /// Events, by message, sorted.
    pub(super) events: Vec<(usize, Event)>,
}

/// A message that is an event: something a person should read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// How much it matters.
    pub level: Level,
    /// What the sentence begins with; the message's name if not said.
    pub text: Option<String>,
}

/// A message that is a remote frame: asks for something, carries no data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteMessage {
    /// 11 or 29 bits.
    pub id: u32,
    /// 29-bit identifier.
    pub extended: bool,
    /// Its name; no other message of the protocol has it.
    pub name: String,
    /// For people.
    pub title: Option<String>,
    /// Which way it goes, `SENDER-to-RECEIVER`, if that is known.
    pub direction: Option<String>,
}

impl CanDefinition {
    /// A database without rules. With `j1939` see [`CanDecoder::new`].
    pub fn of_database(name: &str, database: Database, j1939: bool) -> Self {
        Self {
            name: name.to_owned(),
            title: None,
            ruled: vec![false; database.messages.len()],
            decoder: CanDecoder::new(database, j1939),
            remotes: Vec::new(),
            meanings: Vec::new(),
            assemblies: Vec::new(),
            answers: Vec::new(),
            events: Vec::new(),
        }
    }

    /// The protocol's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What people call it.
    pub fn title(&self) -> Option<&str> {
        self.title.as_deref()
    }

    /// The database, with the messages that rules have added at the end.
    pub fn database(&self) -> &Database {
        self.decoder.database()
    }

    /// Every message that a data frame can be.
    pub fn messages(&self) -> &[Message] {
        &self.database().messages
    }

    /// Gives every signal that is in `data` to `visit`, as [`super::can::Match::decode`] does, for
    /// a frame that is known to be message number `index`.
    #[inline]
    pub fn decode(&self, index: usize, data: &[u8], visit: impl FnMut(Reading)) {
        self.decoder.decode(index, data, visit);
    }

    /// For each of them whether it is recognised as J1939, so that its frames have addresses.
    pub fn grouped(&self) -> Vec<bool> {
        self.decoder.grouped()
    }

    /// The event that message number `index` is, if it is one.
    #[inline]
    pub fn event(&self, index: usize) -> Option<&Event> {
        if self.events.is_empty() {
            return None;
        }
        let at = self.events.binary_search_by_key(&index, |(message, _)| *message).ok()?;
        self.events.get(at).map(|(_, event)| event)
    }

    /// Every message that a remote frame can be.
    pub fn remotes(&self) -> &[RemoteMessage] {
        &self.remotes
    }

    /// Every message that is put together from several frames.
    pub fn assemblies(&self) -> &[Assembly] {
        &self.assemblies
    }

    /// Which frames answer which.
    pub fn answers(&self) -> &[AnswerRule] {
        &self.answers
    }

    /// The name of the message that a frame is by itself, whatever came before it.
    pub fn name_of(&self, frame: &CanFrame) -> Option<&str> {
        if frame.flags.has(CanFlags::REMOTE) {
            let key = (frame.id, frame.flags.has(CanFlags::EXTENDED));
            let found = self.remotes.iter().find(|remote| (remote.id, remote.extended) == key);
            return found.map(|remote| remote.name.as_str());
        }
        self.decoder.find(frame).map(|found| found.message.name.as_str())
    }

    /// True if frames can mean something beside what they say by themselves.
    pub fn has_rules(&self) -> bool {
        let Self { remotes, meanings, assemblies, .. } = self;
        !(remotes.is_empty() && meanings.is_empty() && assemblies.is_empty())
    }

    /// How many rules give an identifier another meaning.
    pub fn contexts(&self) -> usize {
        self.meanings.len()
    }

    /// Which way a message's frames go, if that is known.
    pub fn direction(&self, message: &Message) -> Option<String> {
        message.direction(&self.database().nodes)
    }
}
