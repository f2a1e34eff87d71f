//! A file written anew, record by record: every intact message, in its order, under its channel, with
//! a fresh index and summary.
//!
//! A sound chunk is copied as it stands, byte for byte, so that a sound file comes out as it went in,
//! and a second run changes nothing. Damage is passed over ([`super::walk`]) and told ([`Report`]). Of
//! a chunk whose checksum is wrong or that cannot be decompressed to its end, those messages are kept
//! that can be taken apart; they are counted as unverified.
//!
//! Memory: one chunk, compressed and not, and the index of the file.

mod definitions;
mod report;

use std::fs::File;
use std::io;
use std::path::Path;

use mcap::records::op;

pub use report::{Lost, Report};

use super::bytes::with_head;
use super::chunk::{Chunk, MessageIndex};
use super::container::Container;
use super::definition::Facts;
use super::disk::OutputFile;
use super::records::{self, AttachmentIndex, Channel, ChunkHead, HEAD, Message, Record, Schema};
use super::segment::{ReadError, Segment};
use super::unpack::{Unpack, unpack};
use super::walk::{Piece, Walk, body};
use super::wire::Fields;
use definitions::Definitions;

/// zstd level of chunks that are made anew: that of a recording.
const COMPRESSION: i32 = 3;
/// Loose messages are collected in chunks of this size before compression.
const CHUNK: usize = 1 << 20;
/// Attachments are copied in pieces of this size.
const PIECE: u64 = 1 << 20;

/// What becomes of things on their way. Without one, all stays as it is.
pub trait Change {
    /// Changes the body of a message of `channel`, whose schema is `schema`.
    fn message(&mut self, channel: &Channel, schema: Option<&Schema>, body: &mut Vec<u8>);

    /// Changes the facts of the metadata record `name`.
    fn metadata(&mut self, name: &str, facts: &mut Facts);

    /// Changes a time beside messages, such as that of an attachment.
    fn time(&self, nanos: u64) -> u64;

    /// What the new file shall say of the change, in front of its summary.
    fn told(&self) -> (&'static str, Facts);
}

/// A file being written anew.
pub struct Rewrite<'a> {
    change: Option<&'a mut dyn Change>,
    out: Container,
    /// Loose messages, and those of chunks that are made anew.
    chunk: Chunk,
    definitions: Definitions,
    report: Report,
    unpacked: Vec<u8>,
    /// A message while it is changed.
    changed: Vec<u8>,
    /// How many metadata records `bustape.recovery` the file has.
    recoveries: usize,
    finished: bool,
    change_told: bool,
    /// Nothing has told since the last search that messages here are more than they seem.
    doubtful: bool,
}

impl<'a> Rewrite<'a> {
    /// Writes the recording in `path` into `out`. `go_on` is asked now and then, with the byte that
    /// was reached; when it says no, the result is `None` and `out` is of no use. The caller syncs
    /// by the returned container.
    pub fn run(
        path: &Path,
        out: Box<dyn OutputFile>,
        change: Option<&'a mut dyn Change>,
        go_on: &mut dyn FnMut(u64) -> bool,
    ) -> Result<Option<(Container, Report)>, RewriteError> {
        let summary = Segment::of_summary(path)?;
        let file = File::open(path)
            .map_err(|e| ReadError(format!("cannot read {}: {e}", path.display())))?;
        let mut walk = Walk::new(&file)
            .map_err(|e| ReadError(format!("cannot read {}: {e}", path.display())))?;
        let (first, container) = Self::start(&mut walk, out).map_err(RewriteError::Write)?;
        let mut rewrite = Self {
            change,
            out: container,
            chunk: Chunk::default(),
            definitions: Definitions::of(summary.as_ref()),
            report: Report::new(summary.as_ref()),
            unpacked: Vec::new(),
            changed: Vec::new(),
            recoveries: 0,
            finished: false,
            change_told: false,
            doubtful: false,
        };
        let mut next = first;
        while let Some(piece) = next.take().or_else(|| walk.next()) {
            let at = match piece {
                Piece::Record { at, .. } | Piece::Damage { from: at, .. } => at,
            };
            if !go_on(at) {
                return Ok(None);
            }
            rewrite.take(&walk, piece).map_err(RewriteError::Write)?;
        }
        rewrite.report.end();
        rewrite.finish().map(Some).map_err(RewriteError::Write)
    }

    /// Writes the head: that of the file, if it has one.
    fn start(
        walk: &mut Walk<'_>,
        out: Box<dyn OutputFile>,
    ) -> io::Result<(Option<Piece>, Container)> {
        let first = walk.next();
        if let Some(Piece::Record { opcode: op::HEADER, at, length, .. }) = first {
            let record = walk.bytes.get(at, length);
            if let Some(header) = body(&record).filter(|body| records::is_header(body)) {
                return Ok((None, Container::create_like(out, COMPRESSION, header)?));
            }
        }
        Ok((first, Container::create(out, COMPRESSION)?))
    }

    fn take(&mut self, walk: &Walk<'_>, piece: Piece) -> io::Result<()> {
        let (opcode, at, length) = match piece {
            Piece::Damage { from, to } => {
                self.doubtful = true;
                self.report.damage(from, to, self.finished);
                return Ok(());
            }
            Piece::Record { opcode, at, length, .. } => (opcode, at, length),
        };
        if opcode == op::ATTACHMENT {
            return self.take_attachment(walk, at, length);
        }
        let record = walk.bytes.get(at, length);
        let Some(body) = body(&record) else { return Ok(()) };
        if opcode != op::MESSAGE && opcode != op::MESSAGE_INDEX {
            self.report.settle();
        }
        match opcode {
            op::CHUNK => self.take_chunk(at, &record, body)?,
            op::MESSAGE => self.take_loose(at, body)?,
            op::MESSAGE_INDEX => match records::message_index_entries(body) {
                Some((_, entries)) => self.report.indexed(entries.count() as u64),
                None => self.report.damage(at, at + length, true),
            },
            op::SCHEMA | op::CHANNEL if self.definitions.learn(opcode, body, true) => {}
            op::SCHEMA | op::CHANNEL => {
                self.report.lost(at, length, "a schema or channel that contradicts another");
            }
            op::METADATA => self.take_metadata(at, &record, body)?,
            op::DATA_END | op::FOOTER => self.finished = true,
            private if private >= 0x80 => {
                self.flush()?;
                self.out.copy_private(&record)?;
            }
            // The summary is made anew.
            _ => {}
        }
        self.doubtful &= matches!(opcode, op::MESSAGE | op::MESSAGE_INDEX);
        Ok(())
    }

    fn take_chunk(&mut self, at: u64, record: &[u8], body: &[u8]) -> io::Result<()> {
        self.flush()?;
        let length = record.len() as u64;
        let Some((head, data)) = ChunkHead::of(body) else {
            self.report.lost(at, length, "a chunk without a head");
            return Ok(());
        };
        let data = &data[..data.len().min(usize::try_from(head.compressed).unwrap_or(usize::MAX))];
        let mut unpacked = std::mem::take(&mut self.unpacked);
        let sound = unpack(&head, data, &mut unpacked);
        if let Err(why @ (Unpack::TooLarge(_) | Unpack::Unknown(_))) = &sound {
            unpacked.clear();
            self.report.lost(at, length, &format!("a chunk: {why}"));
        } else {
            let why = sound.err().map(|why| why.to_string());
            let content = self.definitions.look_into(&unpacked, why.is_none());
            let times = content.index.span() == (head.start, head.end);
            if content.copyable && times && self.change.is_none() {
                self.copy_chunk(record, &head, &unpacked, &content.index)?;
            } else {
                let why = why.or_else(|| content.why());
                self.remake_chunk(at, length, &unpacked, why)?;
            }
        }
        self.unpacked = unpacked;
        Ok(())
    }

    fn copy_chunk(
        &mut self,
        record: &[u8],
        head: &ChunkHead<'_>,
        unpacked: &[u8],
        index: &MessageIndex,
    ) -> io::Result<()> {
        for Record { opcode, body } in records::records(unpacked) {
            self.definitions.tell(opcode, body, &mut self.out);
        }
        self.out.copy_chunk(record, head, index)?;
        self.report.kept(index.messages(), index.span());
        self.report.copied_chunk();
        Ok(())
    }

    /// Writes what can be taken apart of a chunk as a new one. `why` says what is wrong with it.
    fn remake_chunk(
        &mut self,
        at: u64,
        length: u64,
        unpacked: &[u8],
        why: Option<String>,
    ) -> io::Result<()> {
        let damaged = why.is_some();
        self.report.begin_chunk(at, length, why);
        for Record { opcode, body } in records::records(unpacked) {
            match opcode {
                op::SCHEMA | op::CHANNEL => {}
                op::MESSAGE => {
                    let sound = !damaged || self.may_be_sound(body);
                    let kept = if sound { self.add_message(body) } else { None };
                    self.report.of_chunk(kept);
                }
                _ if damaged => {}
                _ => self.chunk.define(&with_head(opcode, body)),
            }
        }
        self.flush()
    }

    /// False where the payload of a message is not even of the shape that its channel has, or its head
    /// is not as we write it where it is one of ours.
    fn may_be_sound(&self, body: &[u8]) -> bool {
        let Some(message) = Message::of(body) else { return false };
        let channel = self.definitions.channel(message.channel);
        let Some(channel) = channel.filter(|channel| channel.encoding == "protobuf") else {
            return true;
        };
        let schema = self.definitions.schema(channel.schema);
        let ours = schema.is_some_and(|schema| schema.name.starts_with("bustape."));
        if ours && !has_our_head(body) {
            return false;
        }
        let mut fields = Fields::of(message.data);
        fields.by_ref().for_each(drop);
        fields.sound()
    }

    /// Adds a message to the open chunk, with what it needs; `None` when nobody knows its channel.
    fn add_message(&mut self, body: &[u8]) -> Option<u64> {
        let message = Message::of(body)?;
        self.definitions.channel(message.channel)?;
        self.definitions.define(message.channel, &mut self.chunk, &mut self.out);
        let Some(change) = &mut self.change else {
            self.chunk.copy(message.channel, message.log_time, body);
            return Some(message.log_time);
        };
        let channel = self.definitions.channel(message.channel)?;
        self.changed.clear();
        self.changed.extend_from_slice(body);
        change.message(channel, self.definitions.schema(channel.schema), &mut self.changed);
        let time = Message::of(&self.changed)?.log_time;
        self.chunk.copy(message.channel, time, &self.changed);
        Some(time)
    }

    /// A message outside of chunks.
    fn take_loose(&mut self, at: u64, body: &[u8]) -> io::Result<()> {
        if let Some(time) = self.add_message(body) {
            self.report.kept(1, (time, time));
            self.report.loose(self.doubtful);
        } else {
            let why = "a message of an unknown channel";
            self.report.lost(at, (HEAD + body.len()) as u64, why);
        }
        if self.chunk.len() >= CHUNK { self.flush() } else { Ok(()) }
    }

    fn take_metadata(&mut self, at: u64, record: &[u8], body: &[u8]) -> io::Result<()> {
        self.flush()?;
        let Some((name, mut facts)) = records::metadata(body) else {
            self.report.lost(at, record.len() as u64, "a metadata record");
            return Ok(());
        };
        self.recoveries += usize::from(name.starts_with(RECOVERY));
        self.report.metadata += 1;
        if name == SUMMARY {
            self.tell_of_change()?;
        }
        match &mut self.change {
            None => self.out.copy_metadata(record, &name),
            Some(change) => {
                change.metadata(&name, &mut facts);
                self.out.metadata(&name, facts)
            }
        }
    }

    /// Writes what the new file shall say of the change, once.
    fn tell_of_change(&mut self) -> io::Result<()> {
        if let (Some(change), false) = (&self.change, self.change_told) {
            self.change_told = true;
            let (name, facts) = change.told();
            self.out.metadata(name, facts)?;
        }
        Ok(())
    }

    fn take_attachment(&mut self, walk: &Walk<'_>, at: u64, length: u64) -> io::Result<()> {
        self.flush()?;
        self.report.settle();
        let start = walk.bytes.get(at + HEAD as u64, (length - HEAD as u64).min(PIECE));
        let index = AttachmentIndex::of_start(at, length, &start).map(|(index, _)| index);
        let Some(mut index) = index.filter(|_| attachment_crc(walk, at, length)) else {
            self.report.lost(at, length, "an attachment");
            return Ok(());
        };
        self.report.attachments += 1;
        let mut crc = crc32fast::Hasher::new();
        if let Some(change) = &self.change {
            index.log_time = change.time(index.log_time);
            index.create_time = change.time(index.create_time);
        }
        // The two times stand in front; with others, the checksum behind is another too.
        let times = [index.log_time.to_le_bytes(), index.create_time.to_le_bytes()].concat();
        let (mut from, covered) = (at, at + length - 4);
        let pieces = std::iter::from_fn(|| {
            if from >= covered {
                let sum = crc.clone().finalize().to_le_bytes().to_vec();
                return (std::mem::replace(&mut from, u64::MAX) == covered).then_some(sum);
            }
            let mut piece = walk.bytes.get(from, PIECE.min(covered - from));
            let behind_head = if from == at { HEAD } else { 0 };
            if from == at {
                piece[HEAD..HEAD + times.len()].copy_from_slice(&times);
            }
            crc.update(&piece[behind_head..]);
            from += piece.len() as u64;
            Some(piece)
        });
        self.out.copy_attachment(&index, pieces)
    }

    /// Writes the open chunk.
    fn flush(&mut self) -> io::Result<()> {
        let full = !self.chunk.is_empty();
        self.report.remade_chunk(full);
        self.out.write_chunk(&mut self.chunk)
    }

    fn finish(mut self) -> io::Result<(Container, Report)> {
        self.flush()?;
        self.report.finished = self.finished;
        let nothing_new = self.report.is_whole() && self.finished;
        if !nothing_new {
            let number = self.recoveries + 1;
            let name =
                if number == 1 { RECOVERY.to_owned() } else { format!("{RECOVERY}.{number}") };
            self.out.metadata(&name, self.report.facts())?;
        }
        self.tell_of_change()?;
        self.out.finish()?;
        Ok((self.out, self.report))
    }
}

/// The last metadata record of a recording that was not cut off.
const SUMMARY: &str = "bustape.summary";
/// The metadata record that tells of a recovery.
pub const RECOVERY: &str = "bustape.recovery";

/// Why a file could not be written anew.
#[derive(Debug, thiserror::Error)]
pub enum RewriteError {
    /// The original cannot be read.
    #[error("{0}")]
    Read(#[from] ReadError),
    /// The new file cannot be written.
    #[error("{0}")]
    Write(io::Error),
}

/// True if an attachment's checksum is right, read piece by piece.
fn attachment_crc(walk: &Walk<'_>, at: u64, length: u64) -> bool {
    let (from, end) = (at + HEAD as u64, at + length - 4);
    let mut crc = crc32fast::Hasher::new();
    for here in (from..end).step_by(1 << 20) {
        crc.update(&walk.bytes.get(here, PIECE.min(end - here)));
    }
    let stored = walk.bytes.get(end, 4);
    stored == [0; 4] || stored == crc.finalize().to_le_bytes()
}

/// True if a message has no sequence number, and two equal times.
fn has_our_head(body: &[u8]) -> bool {
    let (sequence, log, publish) = (body.get(2..6), body.get(6..14), body.get(14..22));
    sequence == Some(&[0; 4]) && log == publish
}
