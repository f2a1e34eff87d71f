//! From record to record through a file that may be damaged anywhere.
//!
//! As long as each record is followed by something that looks like one, the walk goes on. Where that
//! ends it looks, byte by byte, for the next record that proves itself: a chunk or attachment by its
//! checksum, anything else by its exact shape and by what follows it. What was passed over is told.
//! Memory is bounded by one record, time by [`MAX_SEARCH_FACTOR`].
//!
//! Source: MCAP format specification, version 0.

use std::collections::VecDeque;
use std::fs::File;
use std::os::unix::fs::FileExt as _;

use mcap::records::op;

use super::limits::{MAX_RECORD, MAX_SEARCH_FACTOR, MIN_SEARCH};
use super::records::{self, AttachmentIndex, Channel, ChunkHead, HEAD, Record, Schema};
use super::unpack::unpack;

/// Bytes looked at in one go while searching.
const WINDOW: usize = 1 << 20;
/// What a disk loses at once.
const BLOCK: u64 = 4096;
/// A search gives nothing away before the end of the head of a chunk or an attachment's name.
const LOOK: u64 = 512;
/// What looking at a place where a record might begin counts for, in bytes.
const CANDIDATE: u64 = 256;
/// Records that must follow one that has no checksum of its own.
const CHAIN: usize = 3;

/// A part of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Piece {
    /// A record, as far as its frame goes; its content is not looked at yet.
    Record {
        /// Kind of the record, as in `mcap::records::op`.
        opcode: u8,
        /// Where it starts.
        at: u64,
        /// Its length, with opcode and length field.
        length: u64,
        /// True if it was found by searching, and not where the record before it ended.
        searched: bool,
    },
    /// From this byte up to that, nothing could be recognised.
    Damage {
        /// First byte.
        from: u64,
        /// The byte behind the last.
        to: u64,
    },
}

/// The walk.
pub struct Walk<'a> {
    /// The file's bytes.
    pub bytes: Bytes<'a>,
    at: u64,
    /// Bytes that may still be examined in searches.
    patience: u64,
    /// What was seen already and comes next.
    ahead: VecDeque<Piece>,
    scratch: Vec<u8>,
}

/// A file's bytes; those that cannot be read are zeros.
pub struct Bytes<'a> {
    file: &'a File,
    /// Bytes in the file.
    pub size: u64,
}

impl Bytes<'_> {
    /// The `length` bytes at `at`, or up to the end of the file.
    pub fn get(&self, at: u64, length: u64) -> Vec<u8> {
        let length = length.min(self.size.saturating_sub(at));
        let mut bytes = vec![0; usize::try_from(length).unwrap_or(0)];
        if self.file.read_exact_at(&mut bytes, at).is_ok() {
            return bytes;
        }
        // A bad sector, or the file has become shorter: what can be read of it.
        let mut done = 0;
        while done < bytes.len() {
            let here = at + done as u64;
            let end = (done + usize::try_from(BLOCK - here % BLOCK).unwrap_or(1)).min(bytes.len());
            if self.file.read_exact_at(&mut bytes[done..end], here).is_err() {
                bytes[done..end].fill(0);
            }
            done = end;
        }
        bytes
    }

    /// Opcode and whole length of the record at `at`, if there may be one.
    fn head(&self, at: u64) -> Option<(u8, u64)> {
        plausible(&self.get(at, HEAD as u64), self.size - at)
    }

    /// True where the file ends as it should: after a footer, or anywhere on a record's boundary.
    fn is_end(&self, at: u64) -> bool {
        at == self.size
            || at + mcap::MAGIC.len() as u64 == self.size && self.get(at, 8) == mcap::MAGIC
    }
}

impl<'a> Walk<'a> {
    /// A walk through the whole of `file`.
    pub fn new(file: &'a File) -> std::io::Result<Self> {
        let size = file.metadata()?.len();
        let bytes = Bytes { file, size };
        let magic = mcap::MAGIC.len() as u64;
        let at = if bytes.get(0, magic) == mcap::MAGIC { magic } else { 0 };
        let patience = size.saturating_mul(MAX_SEARCH_FACTOR).saturating_add(MIN_SEARCH);
        Ok(Self { bytes, at, patience, ahead: VecDeque::new(), scratch: Vec::new() })
    }

    /// True if `at` is followed by what may be records, `count` of them or up to the end.
    fn followed(&self, mut at: u64, count: usize) -> bool {
        for _ in 0..count {
            if self.bytes.is_end(at) {
                return true;
            }
            match self.bytes.head(at) {
                Some((_, length)) => at += length,
                None => return false,
            }
        }
        true
    }

    /// True if the record at `at`, come upon in a search, proves itself.
    fn proves_itself(&mut self, opcode: u8, at: u64, length: u64) -> bool {
        let alone = matches!(opcode, op::CHUNK | op::ATTACHMENT);
        (alone || self.followed(at + length, CHAIN)) && self.has_shape(opcode, at, length)
    }

    /// True if a record's content is exactly as long as what is in it, and its checksum, if it has
    /// one, is right.
    fn has_shape(&mut self, opcode: u8, at: u64, length: u64) -> bool {
        // Its beginning is enough to see that most are none.
        let content = length - HEAD as u64;
        let start = self.bytes.get(at + HEAD as u64, LOOK.min(content));
        if opcode == op::CHUNK && !may_be_chunk(&start, content) || length > MAX_RECORD {
            return false;
        }
        self.patience = self.patience.saturating_sub(length);
        let body = self.bytes.get(at + HEAD as u64, content);
        match opcode {
            op::CHUNK => self.unpacks(&body),
            op::ATTACHMENT => AttachmentIndex::is_intact(&body) && body.len() > 32,
            op::SCHEMA => Schema::of(&body).is_some_and(|s| s.id > 0 && s.body() == body),
            op::CHANNEL => Channel::of(&body).is_some_and(|c| c.body().len() == body.len()),
            op::METADATA => records::metadata(&body).is_some_and(|(name, _)| !name.is_empty()),
            op::MESSAGE_INDEX => records::message_index_entries(&body).is_some(),
            op::MESSAGE => body.len() >= 22,
            op::DATA_END => body.len() == 4,
            op::FOOTER => body.len() == 20,
            op::HEADER => records::is_header(&body),
            // The summary is made anew.
            _ => false,
        }
    }

    fn unpacks(&mut self, body: &[u8]) -> bool {
        let Some((head, compressed)) = ChunkHead::of(body) else { return false };
        self.patience = self.patience.saturating_sub(head.uncompressed);
        let mut scratch = std::mem::take(&mut self.scratch);
        let sound = unpack(&head, compressed, &mut scratch).is_ok()
            && records::records(&scratch).map(|r| HEAD + r.body.len()).sum::<usize>()
                == scratch.len();
        self.scratch = scratch;
        sound
    }

    /// The first record from `from` on that proves itself, or the end of the file.
    fn search(&mut self, from: u64) -> Option<Piece> {
        let mut at = from;
        while at < self.bytes.size && self.patience > 0 {
            let window = self.bytes.get(at, (WINDOW + HEAD) as u64);
            let last = window.len().saturating_sub(HEAD - 1).min(WINDOW);
            for offset in 0..last {
                let here = at + offset as u64;
                let Some((opcode, length)) = plausible(&window[offset..], self.bytes.size - here)
                else {
                    continue;
                };
                self.patience = self.patience.saturating_sub(CANDIDATE);
                if self.proves_itself(opcode, here, length) {
                    return Some(Piece::Record { opcode, at: here, length, searched: true });
                }
            }
            if last == 0 {
                break;
            }
            at += last as u64;
        }
        None
    }

    /// What is at `at`, where the walk cannot go on, and what comes next. A record there is only
    /// what it seems if no other that proves itself begins inside of it: bytes may be missing from it.
    fn look_ahead(&mut self, at: u64) {
        let record = self.bytes.head(at).filter(|&(opcode, length)| {
            // Of a message nothing shows that it is one.
            opcode != op::MESSAGE && self.has_shape(opcode, at, length)
        });
        let checksum = matches!(record, Some((op::CHUNK | op::ATTACHMENT, _)));
        let from = record.filter(|_| checksum).map_or(at + 1, |(_, length)| at + length);
        let found = self.search(from);
        let next = match found {
            Some(Piece::Record { at, .. }) => at,
            _ => self.bytes.size,
        };
        let mut damaged_from = at;
        if let Some((opcode, length)) = record.filter(|(_, length)| at + length <= next) {
            self.ahead.push_back(Piece::Record { opcode, at, length, searched: false });
            damaged_from = at + length;
        }
        if damaged_from < next {
            self.ahead.push_back(Piece::Damage { from: damaged_from, to: next });
        }
        self.ahead.extend(found);
        self.at = match found {
            Some(Piece::Record { at, length, .. }) => at + length,
            _ => self.bytes.size,
        };
    }
}

impl Iterator for Walk<'_> {
    type Item = Piece;

    fn next(&mut self) -> Option<Piece> {
        let at = self.at;
        if self.ahead.is_empty() && !self.bytes.is_end(at) {
            match self.bytes.head(at) {
                Some((opcode, length)) if self.followed(at + length, 1) => {
                    self.at = at + length;
                    return Some(Piece::Record { opcode, at, length, searched: false });
                }
                _ => self.look_ahead(at),
            }
        }
        self.ahead.pop_front()
    }
}

/// Opcode and whole length of what may be a record with `left` bytes up to the end of the file.
fn plausible(bytes: &[u8], left: u64) -> Option<(u8, u64)> {
    let (&opcode, rest) = bytes.split_first()?;
    let length = u64::from_le_bytes(rest.get(..8)?.try_into().ok()?);
    let known = (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
    // Only an attachment may be larger, where it is copied piece by piece.
    let fits = length <= MAX_RECORD || opcode == op::ATTACHMENT;
    let length = length.checked_add(HEAD as u64)?;
    (known && fits && length <= left).then_some((opcode, length))
}

/// True if `start` may be the start of a chunk's body of `length` bytes.
fn may_be_chunk(start: &[u8], length: u64) -> bool {
    ChunkHead::of(start).is_some_and(|(head, rest)| {
        let data = length - (start.len() - rest.len()) as u64;
        head.start <= head.end && head.compressed == data
    })
}

/// The record at `at`, whose frame is known to be whole.
pub fn body(record: &[u8]) -> Option<&[u8]> {
    records::records(record).next().map(|Record { body, .. }| body)
}
