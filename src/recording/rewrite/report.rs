//! What a rewriting kept, and what it could not: for a person, for a program, and for the file.

use super::super::definition::Facts;
use super::super::records::ChunkRef;
use super::super::segment::Segment;

/// Losses told one by one; further ones are only counted. A file made of damage must not cost memory.
const TOLD: usize = 1000;
/// Losses told in the new file's metadata.
const TOLD_IN_FILE: usize = 100;

/// A part of the file that is not in the new one, or not all of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lost {
    /// First byte.
    pub from: u64,
    /// The byte behind the last.
    pub to: u64,
    /// What is wrong with it.
    pub what: String,
    /// The latest time before it, nanoseconds since 1970: what is lost may be later than this.
    pub after: Option<u64>,
    /// The next time behind it: what is lost may be earlier than this.
    pub before: Option<u64>,
    /// How many messages it cost, where an index tells.
    pub messages: Option<u64>,
}

/// What became of a file.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Messages in the new file.
    pub messages: u64,
    /// Chunks that were copied as they stood.
    pub copied_chunks: u64,
    /// Chunks that were made anew.
    pub remade_chunks: u64,
    /// Metadata records kept.
    pub metadata: u64,
    /// Attachments kept.
    pub attachments: u64,
    /// Messages kept that nothing vouches for: the checksum of their chunk is wrong.
    pub unverified: u64,
    /// What was lost, in the order of the file.
    pub lost: Vec<Lost>,
    /// Losses beyond those.
    pub more_lost: u64,
    /// Bytes of the file that are in no way in the new one, or not surely so.
    pub lost_bytes: u64,
    /// Bytes of damage to indexes and summary, which are made anew: nothing is lost with them.
    pub index_bytes: u64,
    /// True if the file had an end.
    pub finished: bool,
    /// Messages that the file's own summary counts.
    told: Option<u64>,
    chunks: Vec<ChunkRef>,
    latest: Option<u64>,
    /// Losses from here on wait for the next time.
    open: usize,
    chunk: Option<Remade>,
    /// The last loss, until it is known how many messages were in it.
    counting: bool,
}

/// A chunk that is being made anew.
#[derive(Clone, Debug, Default)]
struct Remade {
    at: u64,
    length: u64,
    why: Option<String>,
    kept: u64,
    unknown: u64,
    indexed: u64,
    after: Option<u64>,
}

impl Report {
    /// For a file whose summary, if it has a sound one, is this.
    pub(super) fn new(summary: Option<&Segment>) -> Self {
        let told = summary.map(|summary| summary.statistics.messages);
        let mut chunks = summary.map(|summary| summary.chunks.clone()).unwrap_or_default();
        chunks.sort_unstable_by_key(|chunk| chunk.offset);
        Self { told, chunks, ..Self::default() }
    }

    /// True if everything in the file is in the new one.
    pub fn is_whole(&self) -> bool {
        self.lost.is_empty() && self.unverified == 0 && self.told.is_none_or(|n| n == self.messages)
    }

    /// Messages that are known to be lost, and whether that is all of them.
    pub fn lost_messages(&self) -> (u64, bool) {
        if let Some(told) = self.told {
            return (told.saturating_sub(self.messages), true);
        }
        let known = self.lost.iter().filter_map(|lost| lost.messages).sum();
        (known, self.lost.is_empty())
    }

    /// True if nothing of a recording was found.
    pub fn is_empty(&self) -> bool {
        self.messages == 0 && self.metadata == 0 && self.attachments == 0 && !self.finished
    }

    /// What was kept and lost, in a sentence.
    pub fn sentence(&self) -> String {
        let mut parts = vec![format!(
            "kept {} messages, {} metadata records, {} attachments",
            self.messages, self.metadata, self.attachments
        )];
        if !self.finished {
            let why =
                "it had not been finished, so what was in memory when it was cut off is not in it";
            parts.push(why.to_owned());
        }
        if self.unverified > 0 {
            parts.push(format!("of the messages {} are unverified", self.unverified));
        }
        let (messages, all) = self.lost_messages();
        if !self.is_whole() {
            let least = if all { "" } else { "at least " };
            parts.push(format!("lost {} bytes, {least}{messages} messages", self.lost_bytes));
        }
        parts.join("; ")
    }

    pub(super) fn damage(&mut self, from: u64, to: u64, of_index: bool) {
        if of_index {
            self.index_bytes += to - from;
        } else {
            self.lost(from, to - from, "nothing recognisable");
        }
    }

    pub(super) fn lost(&mut self, from: u64, length: u64, what: &str) {
        self.settle();
        let what = what.to_owned();
        let after = self.latest;
        self.push(Lost { from, to: from + length, what, after, before: None, messages: None });
        self.counting = true;
    }

    fn push(&mut self, mut lost: Lost) {
        self.lost_bytes += lost.to - lost.from;
        if self.lost.len() >= TOLD {
            self.more_lost += 1;
            return;
        }
        let first = self.chunks.partition_point(|chunk| chunk.offset < lost.from);
        let inside = self.chunks[first..].iter().take_while(|chunk| chunk.offset < lost.to);
        let times = inside.fold(None, |span: Option<(u64, u64)>, chunk| {
            let (start, end) = span.unwrap_or((chunk.start, chunk.end));
            Some((start.min(chunk.start), end.max(chunk.end)))
        });
        if let Some((start, end)) = times {
            (lost.after, lost.before) = (Some(start), Some(end));
        }
        self.lost.push(lost);
    }

    /// A message index of so many entries follows.
    pub(super) fn indexed(&mut self, entries: u64) {
        if let Some(chunk) = &mut self.chunk {
            chunk.indexed += entries;
        } else if self.counting
            && self.more_lost == 0
            && let Some(lost) = self.lost.last_mut()
        {
            *lost.messages.get_or_insert(0) += entries;
        }
    }

    pub(super) fn begin_chunk(&mut self, at: u64, length: u64, why: Option<String>) {
        self.settle();
        let after = self.latest;
        self.chunk = Some(Remade { at, length, why, after, ..Remade::default() });
    }

    /// A message of the chunk was kept, with its time, or belongs to nobody knows what.
    pub(super) fn of_chunk(&mut self, kept: Option<u64>) {
        let Some(chunk) = &mut self.chunk else { return };
        match kept {
            Some(time) => {
                chunk.kept += 1;
                self.kept(1, (time, time));
            }
            None => chunk.unknown += 1,
        }
    }

    pub(super) fn kept(&mut self, messages: u64, (start, end): (u64, u64)) {
        self.messages += messages;
        for lost in &mut self.lost[self.open..] {
            // Chunks overlap a little, times of a range never do.
            lost.before.get_or_insert(start.max(lost.after.unwrap_or(0)));
        }
        self.open = self.lost.len();
        self.latest = Some(self.latest.map_or(end, |latest| latest.max(end)));
    }

    pub(super) fn loose(&mut self, doubtful: bool) {
        self.unverified += u64::from(doubtful);
    }

    pub(super) fn copied_chunk(&mut self) {
        self.copied_chunks += 1;
    }

    pub(super) fn remade_chunk(&mut self, full: bool) {
        self.remade_chunks += u64::from(full);
    }

    /// No more is to be learnt about the loss or chunk before.
    pub(super) fn settle(&mut self) {
        self.counting = false;
        let Some(chunk) = self.chunk.take() else { return };
        let Remade { at, length, why, kept, unknown, indexed, after } = chunk;
        let what = match why {
            Some(why) => {
                self.unverified += kept;
                format!("a chunk: {why}; {kept} messages of it are kept unverified")
            }
            None if unknown > 0 => {
                format!("a chunk: {unknown} messages of channels that nothing defines any more")
            }
            None => return,
        };
        let messages = (indexed > 0 || unknown > 0).then(|| (kept + unknown).max(indexed) - kept);
        self.push(Lost { from: at, to: at + length, what, after, before: None, messages });
    }

    pub(super) fn end(&mut self) {
        self.settle();
    }

    /// What the new file says of it. The same for the same file, whenever it is made.
    pub(super) fn facts(&self) -> Facts {
        let (messages, all) = self.lost_messages();
        let mut facts = Facts::from([
            ("was_finished".to_owned(), self.finished.to_string()),
            ("messages".to_owned(), self.messages.to_string()),
            ("lost_bytes".to_owned(), self.lost_bytes.to_string()),
            ("lost_ranges".to_owned(), (self.lost.len() as u64 + self.more_lost).to_string()),
            ("lost_messages_known".to_owned(), messages.to_string()),
            ("lost_messages_exact".to_owned(), all.to_string()),
            ("unverified_messages".to_owned(), self.unverified.to_string()),
        ]);
        for (number, lost) in (1..).zip(self.lost.iter().take(TOLD_IN_FILE)) {
            facts.insert(format!("lost.{number:04}"), lost.to_string());
        }
        facts
    }
}

impl std::fmt::Display for Lost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "bytes {} to {}: {}", self.from, self.to, self.what)?;
        if let Some(messages) = self.messages {
            write!(f, "; {messages} messages lost")?;
        }
        if let Some(after) = self.after {
            write!(f, "; not before {after} ns")?;
        }
        if let Some(before) = self.before {
            write!(f, "; not after {before} ns")?;
        }
        Ok(())
    }
}
