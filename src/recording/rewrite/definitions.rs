//! Schemas and channels: what was learnt of them, and what the new file says already.

use std::collections::{BTreeMap, BTreeSet};

use mcap::records::op;

use crate::recording::bytes::with_head;
use crate::recording::chunk::{Chunk, MessageIndex};
use crate::recording::container::Container;
use crate::recording::limits::{FACT, MAX_DEFINITIONS};
use crate::recording::records::{Channel, HEAD, Message, Record, Schema, records};
use crate::recording::segment::Segment;

/// What messages mean.
#[derive(Default)]
pub struct Definitions {
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Channel>,
    /// Those that stand in the new file, as records.
    told: BTreeSet<(u8, u16)>,
    /// Channels that were defined in two ways: nobody knows what their messages are.
    ambiguous: BTreeSet<u16>,
    bytes: usize,
}

/// What is in a chunk.
#[derive(Default)]
pub struct Content {
    /// Its messages, if it is copied as it stands.
    pub index: MessageIndex,
    /// True if it can be copied as it stands: it is sound, and says or follows all it needs.
    pub copyable: bool,
    contradicts: bool,
    cut: bool,
}

impl Content {
    /// What is wrong with it.
    pub fn why(&self) -> Option<String> {
        let why = match (self.contradicts, self.cut) {
            (true, _) => "it defines a schema or channel otherwise than before",
            (_, true) => "it ends in the middle of a record",
            _ => return None,
        };
        Some(why.to_owned())
    }
}

impl Definitions {
    /// What the summary of a damaged file tells.
    pub fn of(summary: Option<&Segment>) -> Self {
        let mut known = Self::default();
        if let Some(summary) = summary {
            known.schemas.clone_from(&summary.schemas);
            known.channels.clone_from(&summary.channels);
        }
        known
    }

    /// Takes in a definition. False if it contradicts what is known and came from a sound place.
    pub fn learn(&mut self, opcode: u8, body: &[u8], sound: bool) -> bool {
        let fits = |bytes: usize, more: usize| bytes.saturating_add(more) <= MAX_DEFINITIONS;
        if opcode == op::SCHEMA {
            let Some(schema) = Schema::of(body).filter(|schema| schema.id > 0) else {
                return !sound;
            };
            return match self.schemas.get(&schema.id) {
                Some(known) => *known == schema || !sound,
                None if fits(self.bytes, body.len()) => {
                    self.bytes += body.len();
                    self.schemas.insert(schema.id, schema);
                    true
                }
                None => false,
            };
        }
        let Some(channel) = Channel::of(body) else { return !sound };
        let cost = body.len() + channel.metadata.len() * FACT;
        match self.channels.get(&channel.id) {
            Some(known) if *known == channel || !sound => true,
            Some(_) => {
                self.ambiguous.insert(channel.id);
                false
            }
            None if fits(self.bytes, cost) => {
                self.bytes += cost;
                self.channels.insert(channel.id, channel);
                true
            }
            None => false,
        }
    }

    /// Learns from the records of a chunk, and says whether it can be copied as it stands.
    pub fn look_into(&mut self, unpacked: &[u8], sound: bool) -> Content {
        let mut content = Content { copyable: sound, ..Content::default() };
        let mut here = BTreeSet::new();
        let mut at = 0;
        for Record { opcode, body } in records(unpacked) {
            match opcode {
                op::SCHEMA | op::CHANNEL => {
                    content.contradicts |= !self.learn(opcode, body, sound);
                    here.extend(id(opcode, body).map(|id| (opcode, id)));
                }
                op::MESSAGE => {
                    let message = Message::of(body);
                    let channel = message.and_then(|m| Some((m, self.channels.get(&m.channel)?)));
                    content.copyable &= channel.is_some_and(|(_, channel)| {
                        self.is_told(channel, &here) && !self.ambiguous.contains(&channel.id)
                    });
                    if let Some(Message { channel, log_time, .. }) = message {
                        content.index.note(channel, log_time, at as u64);
                    }
                }
                _ => {}
            }
            at += HEAD + body.len();
        }
        content.cut = sound && at != unpacked.len();
        let whole = at == unpacked.len() && content.index.messages() > 0;
        content.copyable &= whole && !content.contradicts;
        content
    }

    fn is_told(&self, channel: &Channel, here: &BTreeSet<(u8, u16)>) -> bool {
        let told = |key| self.told.contains(&key) || here.contains(&key);
        let schema = channel.schema == 0 || told((op::SCHEMA, channel.schema));
        schema && told((op::CHANNEL, channel.id))
    }

    /// A channel, if it is known what it is.
    pub fn channel(&self, id: u16) -> Option<&Channel> {
        let channel = self.channels.get(&id).filter(|_| !self.ambiguous.contains(&id))?;
        let schema = channel.schema == 0 || self.schemas.contains_key(&channel.schema);
        schema.then_some(channel)
    }

    /// The schema of a channel.
    pub fn schema(&self, id: u16) -> Option<&Schema> {
        self.schemas.get(&id)
    }

    /// Defines a channel in a chunk that is being made, unless the new file has it already.
    pub fn define(&mut self, id: u16, chunk: &mut Chunk, out: &mut Container) {
        if self.told.contains(&(op::CHANNEL, id)) {
            return;
        }
        let Some(channel) = self.channels.get(&id).cloned() else { return };
        if let Some(schema) = self.schemas.get(&channel.schema).cloned() {
            let body = schema.body();
            if !self.told.contains(&(op::SCHEMA, schema.id)) {
                chunk.define(&with_head(op::SCHEMA, &body));
            }
            self.tell(op::SCHEMA, &body, out);
        }
        let body = channel.body();
        chunk.define(&with_head(op::CHANNEL, &body));
        self.tell(op::CHANNEL, &body, out);
    }

    /// Takes note of a definition that stands in the new file from now on.
    pub fn tell(&mut self, opcode: u8, body: &[u8], out: &mut Container) {
        let Some(id) = id(opcode, body) else { return };
        if !self.told.insert((opcode, id)) {
            return;
        }
        let record = with_head(opcode, body);
        match opcode {
            op::SCHEMA => out.enter_schema(&record),
            _ => out.enter_channel(&record),
        }
    }
}

/// The id that a schema or channel record defines.
fn id(opcode: u8, body: &[u8]) -> Option<u16> {
    let id = body.first_chunk::<2>().map(|bytes| u16::from_le_bytes(*bytes));
    id.filter(|_| matches!(opcode, op::SCHEMA | op::CHANNEL))
}
