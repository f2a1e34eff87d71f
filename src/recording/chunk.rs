//! The open chunk: messages collected in memory until they go out in one piece.
//!
//! A chunk that was never written is never half in the file, so a recording that was cut off ends
//! on a record boundary.

use mcap::records::op;

use crate::frame::Timestamp;

/// Messages and the definitions they need, not yet compressed.
#[derive(Default)]
pub struct Chunk {
    /// Records as they stand in the chunk.
    records: Vec<u8>,
    /// Bytes of `records` up to the end of the last one that is complete.
    whole: usize,
    index: MessageIndex,
}

/// Which messages a chunk has, for the index that follows it.
#[derive(Default)]
pub struct MessageIndex {
    /// For each channel its entries, already serialized.
    entries: Vec<Vec<u8>>,
    /// The channels that have any.
    used: Vec<u16>,
    start: u64,
    end: u64,
    messages: u64,
}

/// A message whose payload is being appended; see [`Chunk::begin`].
#[must_use]
pub struct OpenMessage {
    /// Where the record starts.
    at: usize,
    channel: u16,
    time: u64,
}

/// opcode and length.
const RECORD_HEAD: usize = 1 + 8;
/// channel id, sequence, log time, publish time.
const MESSAGE_HEAD: usize = 2 + 4 + 8 + 8;
/// log time and offset.
pub const INDEX_ENTRY: usize = 8 + 8;

impl Chunk {
    /// Starts a message; append its payload to the returned buffer, then call [`Chunk::end`].
    pub fn begin(&mut self, channel: u16, time: Timestamp) -> (OpenMessage, &mut Vec<u8>) {
        let at = self.records.len();
        let time = time.nanos();
        let mut head = [0; RECORD_HEAD + MESSAGE_HEAD];
        head[0] = op::MESSAGE;
        head[9..11].copy_from_slice(&channel.to_le_bytes());
        // 11..15: sequence 0, which means that messages are not numbered.
        head[15..23].copy_from_slice(&time.to_le_bytes());
        head[23..31].copy_from_slice(&time.to_le_bytes());
        self.records.extend_from_slice(&head);
        (OpenMessage { at, channel, time }, &mut self.records)
    }

    /// Completes the message started last.
    pub fn end(&mut self, message: OpenMessage) {
        let OpenMessage { at, channel, time } = message;
        let length = (self.records.len() - at - RECORD_HEAD) as u64;
        self.records[at + 1..at + RECORD_HEAD].copy_from_slice(&length.to_le_bytes());
        self.index.note(channel, time, at as u64);
        self.whole = self.records.len();
    }

    /// Appends a message as it stood elsewhere; `body` is the record's content.
    pub fn copy(&mut self, channel: u16, time: u64, body: &[u8]) {
        let at = self.records.len() as u64;
        self.records.push(op::MESSAGE);
        self.records.extend_from_slice(&(body.len() as u64).to_le_bytes());
        self.records.extend_from_slice(body);
        self.index.note(channel, time, at);
        self.whole = self.records.len();
    }

    /// Takes back a message that was begun and not completed.
    pub fn abandon(&mut self) {
        self.records.truncate(self.whole);
    }

    /// Appends a schema or channel record.
    pub fn define(&mut self, record: &[u8]) {
        self.records.extend_from_slice(record);
        self.whole = self.records.len();
    }

    /// True when there is no message. Such a chunk must not be written: readers take its start
    /// time for 1970.
    pub fn is_empty(&self) -> bool {
        self.index.messages == 0
    }

    /// Bytes before compression.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// The records.
    pub fn records(&self) -> &[u8] {
        &self.records
    }

    /// What is in it.
    pub fn index(&self) -> &MessageIndex {
        &self.index
    }

    /// Empties the chunk, keeping its buffers.
    pub fn clear(&mut self) {
        self.records.clear();
        self.whole = 0;
        self.index.clear();
    }
}

impl MessageIndex {
    /// Enters a message that stands at `offset` in the chunk's records.
    pub fn note(&mut self, channel: u16, time: u64, offset: u64) {
        if self.entries.len() <= usize::from(channel) {
            self.entries.resize_with(usize::from(channel) + 1, Vec::new);
        }
        let entries = &mut self.entries[usize::from(channel)];
        if entries.is_empty() {
            self.used.push(channel);
        }
        let mut entry = [0; INDEX_ENTRY];
        entry[..8].copy_from_slice(&time.to_le_bytes());
        entry[8..].copy_from_slice(&offset.to_le_bytes());
        entries.extend_from_slice(&entry);
        self.start = if self.messages == 0 { time } else { self.start.min(time) };
        self.end = self.end.max(time);
        self.messages += 1;
    }

    /// Messages in it.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Times of the earliest and the latest message.
    pub fn span(&self) -> (u64, u64) {
        (self.start, self.end)
    }

    /// Channels that have messages here, by id, and their entries.
    pub fn channels(&self) -> impl Iterator<Item = (u16, &[u8])> {
        let mut used = self.used.clone();
        used.sort_unstable();
        used.into_iter().map(|id| (id, &self.entries[usize::from(id)][..]))
    }

    /// Empties it, keeping its buffers.
    pub fn clear(&mut self) {
        for channel in self.used.drain(..) {
            self.entries[usize::from(channel)].clear();
        }
        (self.start, self.end, self.messages) = (0, 0, 0);
    }
}
