//! One segment file, opened for reading: what is in it, without reading its messages.
//!
//! A finished file tells by its summary, so opening one takes the same moment whatever its size. A
//! file that was not finished (a crash, or still being written) is walked once: from record to
//! record, without decompressing more than its channels need.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use mcap::records::op;

use super::definition::Facts;
use super::disk::is_locked;
use super::limits::{FACT, MAX_DEFINITIONS, MAX_RECORD, MAX_SUMMARY};
use super::records::{
    self, AttachmentIndex, Channel, ChunkHead, ChunkRef, HEAD, Message, Record, Schema, Statistics,
    records,
};
use super::unpack::unpack;

/// Footer record and closing magic.
const TAIL: usize = HEAD + 8 + 8 + 4 + mcap::MAGIC.len();

/// How a file ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// With a summary.
    Finished,
    /// Without: it can be read up to this byte of so many.
    Cut {
        /// First byte that makes no sense, or the end of the file.
        at: u64,
        /// Size of the file.
        of: u64,
    },
}

/// A segment file.
pub struct Segment {
    /// The file.
    pub path: PathBuf,
    /// Its size in bytes.
    pub size: u64,
    /// How it ends.
    pub ending: Ending,
    /// It has no end because somebody is still writing it; the last bytes may be a part of a record.
    pub is_growing: bool,
    /// Its schemas, by id.
    pub schemas: BTreeMap<u16, Schema>,
    /// Its channels, by id.
    pub channels: BTreeMap<u16, Channel>,
    /// Its counts.
    pub statistics: Statistics,
    /// Its metadata records, by name.
    pub metadata: BTreeMap<String, Facts>,
    /// Its attachments.
    pub attachments: Vec<AttachmentIndex>,
    /// Its chunks, in the order of the file.
    pub chunks: Vec<ChunkRef>,
    file: File,
    definition_bytes: usize,
}

/// A file that cannot be read as a recording. The text is the whole sentence.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(pub String);

fn cannot_read(path: &Path, error: &io::Error) -> ReadError {
    ReadError(format!("cannot read {}: {error}", path.display()))
}

impl Segment {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |error: io::Error| cannot_read(path, &error);
        let file = File::open(path).map_err(failed)?;
        let about = file.metadata().map_err(failed)?;
        let mut magic = [0; mcap::MAGIC.len()];
        if !about.is_file() || file.read_exact_at(&mut magic, 0).is_err() || magic != *mcap::MAGIC {
            return Err(ReadError(format!(
                "{} is not an MCAP file: it does not begin with the MCAP magic bytes",
                path.display()
            )));
        }
        let mut segment = Self::blank(path, file, about.len());
        if !segment.open_by_summary().map_err(failed)? {
            segment.is_growing = is_locked(&segment.file);
            segment.scan().map_err(failed)?;
        }
        Ok(segment)
    }

    /// What the summary of a file says, if it has a sound one; the rest may be damaged.
    pub fn of_summary(path: &Path) -> Result<Option<Self>, ReadError> {
        let failed = |error: io::Error| cannot_read(path, &error);
        let file = File::open(path).map_err(failed)?;
        let size = file.metadata().map_err(failed)?.len();
        let mut segment = Self::blank(path, file, size);
        // A disk that cannot read the end of the file has no summary to offer.
        Ok(segment.open_by_summary().unwrap_or(false).then_some(segment))
    }

    fn open_by_summary(&mut self) -> io::Result<bool> {
        Ok(self.read_summary()?.is_some_and(|bytes| self.take_summary(&bytes)))
    }

    fn blank(path: &Path, file: File, size: u64) -> Self {
        Self {
            path: path.to_owned(),
            size,
            ending: Ending::Finished,
            is_growing: false,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            statistics: Statistics::default(),
            metadata: BTreeMap::new(),
            attachments: Vec::new(),
            chunks: Vec::new(),
            file,
            definition_bytes: 0,
        }
    }

    /// The bytes of the summary section, if the file has one and it is whole.
    fn read_summary(&self) -> io::Result<Option<Vec<u8>>> {
        let Some(at) = self.size.checked_sub(TAIL as u64) else { return Ok(None) };
        let mut tail = [0; TAIL];
        self.file.read_exact_at(&mut tail, at)?;
        let (footer, magic) = tail.split_at(TAIL - mcap::MAGIC.len());
        let found = records(footer).next().and_then(records::footer);
        let Some((start, crc)) = found.filter(|_| magic == mcap::MAGIC) else { return Ok(None) };
        // The checksum covers the summary and the footer up to itself.
        let end = at + (footer.len() - 4) as u64;
        let length = end.checked_sub(start).filter(|l| start != 0 && *l <= MAX_SUMMARY);
        let Some(length) = length.and_then(|l| usize::try_from(l).ok()) else { return Ok(None) };
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, start)?;
        Ok((crc == 0 || crc32fast::hash(&bytes) == crc).then_some(bytes))
    }

    /// Takes in the summary; false when it lacks something or points outside of the file.
    fn take_summary(&mut self, bytes: &[u8]) -> bool {
        let mut complete = true;
        let mut has_statistics = false;
        // Where metadata were read; a file that names one place a million times gets one look.
        let mut facts = BTreeSet::new();
        for Record { opcode, body } in records(bytes) {
            complete &= match opcode {
                op::SCHEMA | op::CHANNEL => self.take_definition(opcode, body),
                op::STATISTICS => Statistics::of(body).is_some_and(|statistics| {
                    self.statistics = statistics;
                    has_statistics = true;
                    true
                }),
                op::CHUNK_INDEX => ChunkRef::of(body).is_some_and(|chunk| {
                    self.chunks.push(chunk);
                    self.contains(chunk.offset, chunk.length)
                }),
                op::ATTACHMENT_INDEX => AttachmentIndex::of(body).is_some_and(|index| {
                    let inside = self.contains(index.offset, index.length);
                    self.attachments.push(index);
                    inside
                }),
                op::METADATA_INDEX => {
                    records::metadata_index(body).is_some_and(|(offset, length)| {
                        !facts.insert(offset) || self.read_metadata(offset, length).is_some()
                    })
                }
                _ => true,
            };
        }
        complete &= has_statistics;
        // An index that names a chunk twice is wrong, and may name it in the place of another.
        let mut seen = BTreeSet::new();
        complete &= self.chunks.iter().all(|chunk| seen.insert(chunk.offset));
        if !complete {
            self.forget();
        }
        complete
    }

    fn contains(&self, offset: u64, length: u64) -> bool {
        offset.checked_add(length).is_some_and(|end| end <= self.size)
    }

    fn read_metadata(&mut self, offset: u64, length: u64) -> Option<()> {
        let bytes = self.read_record(offset, length).ok()?;
        let record = records(&bytes).next().filter(|r| r.opcode == op::METADATA)?;
        self.take_metadata(record.body).then_some(())
    }

    fn take_metadata(&mut self, body: &[u8]) -> bool {
        let found = records::metadata(body);
        let Some((name, facts)) = found.filter(|(_, facts)| self.may_keep(body, facts.len()))
        else {
            return false;
        };
        self.metadata.insert(name, facts);
        true
    }

    /// Ids are 16 bits and names are short, but what stands behind each may be large.
    fn may_keep(&mut self, body: &[u8], facts: usize) -> bool {
        let bytes = body.len() + facts * FACT;
        self.definition_bytes = self.definition_bytes.saturating_add(bytes);
        self.definition_bytes <= MAX_DEFINITIONS
    }

    fn take_definition(&mut self, opcode: u8, body: &[u8]) -> bool {
        if opcode == op::SCHEMA {
            let found = Schema::of(body).filter(|_| self.may_keep(body, 0));
            return found.map(|s| self.schemas.insert(s.id, s)).is_some();
        }
        let found = Channel::of(body).filter(|c| self.may_keep(body, c.metadata.len()));
        found.map(|c| self.channels.insert(c.id, c)).is_some()
    }

    fn forget(&mut self) {
        self.schemas.clear();
        self.channels.clear();
        self.statistics = Statistics::default();
        self.metadata.clear();
        self.attachments.clear();
        self.chunks.clear();
        self.definition_bytes = 0;
    }

    /// Walks a file without a usable summary from record to record.
    fn scan(&mut self) -> io::Result<()> {
        let mut at = mcap::MAGIC.len() as u64;
        // Messages of the chunk before, by channel, as its index tells.
        let mut counts = BTreeMap::new();
        while let Some((opcode, end)) = self.record_at(at)? {
            match opcode {
                op::CHUNK => {
                    self.add_counts(&std::mem::take(&mut counts));
                    self.scan_chunk(at, end)?;
                }
                op::FOOTER | op::DATA_END => break,
                op::MESSAGE_INDEX | op::METADATA | op::ATTACHMENT | op::SCHEMA | op::CHANNEL => {
                    let bytes = self.read_record(at, end - at)?;
                    self.scan_record(at, &bytes, &mut counts);
                }
                _ => {}
            }
            at = end;
        }
        self.ending = Ending::Cut { at, of: self.size };
        // The index of the last chunk may be cut off, all of it or a part.
        self.add_counts(&self.counts_of_last_chunk().unwrap_or(counts));
        self.find_definitions();
        Ok(())
    }

    /// Opcode and end of the record at `at`, if it is whole.
    fn record_at(&self, at: u64) -> io::Result<Option<(u8, u64)>> {
        if !self.contains(at, HEAD as u64) {
            return Ok(None);
        }
        let mut head = [0; HEAD];
        self.file.read_exact_at(&mut head, at)?;
        let [opcode, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let start = at + HEAD as u64;
        let whole = length <= MAX_RECORD && opcode != 0 && self.contains(start, length);
        Ok(whole.then_some((opcode, start.saturating_add(length))))
    }

    fn scan_chunk(&mut self, at: u64, end: u64) -> io::Result<()> {
        // Times stand in the first 16 bytes.
        let mut times = [0; 16];
        if end - at < (HEAD + times.len()) as u64 {
            return Ok(());
        }
        self.file.read_exact_at(&mut times, at + HEAD as u64)?;
        let [start, stop] =
            [0, 8].map(|i| u64::from_le_bytes(std::array::from_fn(|byte| times[i + byte])));
        self.chunks.push(ChunkRef { start, end: stop, offset: at, length: end - at, channels: 0 });
        let span = &mut self.statistics.span;
        *span = if span.1 == 0 { (start, stop) } else { (span.0.min(start), span.1.max(stop)) };
        Ok(())
    }

    /// Enters the messages of the last chunk in the statistics and in the chunk itself.
    fn add_counts(&mut self, counts: &BTreeMap<u16, u64>) {
        for (&channel, count) in counts {
            *self.statistics.channels.entry(channel).or_default() += count;
            self.statistics.messages += count;
            if let Some(chunk) = self.chunks.last_mut() {
                chunk.channels |= records::channel_bit(channel);
            }
        }
    }

    fn counts_of_last_chunk(&self) -> Option<BTreeMap<u16, u64>> {
        let mut records_of_chunk = Vec::new();
        self.read_chunk(*self.chunks.last()?, &mut records_of_chunk).ok()?;
        let mut counts = BTreeMap::new();
        for record in records(&records_of_chunk).filter(|record| record.opcode == op::MESSAGE) {
            *counts.entry(Message::of(record.body)?.channel).or_default() += 1;
        }
        Some(counts)
    }

    fn scan_record(&mut self, at: u64, bytes: &[u8], counts: &mut BTreeMap<u16, u64>) {
        let Some(Record { opcode, body }) = records(bytes).next() else { return };
        match opcode {
            op::MESSAGE_INDEX => {
                if let Some((channel, count)) = records::message_index(body) {
                    *counts.entry(channel).or_default() += count;
                }
            }
            op::METADATA => {
                self.take_metadata(body);
            }
            op::ATTACHMENT => {
                let index = AttachmentIndex::of_attachment(at, body).map(|(index, _)| index);
                self.attachments.extend(index);
            }
            _ => {
                self.take_definition(opcode, body);
            }
        }
    }

    /// Looks into chunks until every channel that has messages is known.
    fn find_definitions(&mut self) {
        let used: Vec<u16> = self.statistics.channels.keys().copied().collect();
        let mut records_of_chunk = Vec::new();
        for chunk in self.chunks.clone() {
            if used.iter().all(|id| self.channels.contains_key(id)) {
                return;
            }
            if self.read_chunk(chunk, &mut records_of_chunk).is_err() {
                continue;
            }
            for Record { opcode, body } in records(&records_of_chunk) {
                if matches!(opcode, op::SCHEMA | op::CHANNEL) {
                    self.take_definition(opcode, body);
                }
            }
        }
    }

    fn read_record(&self, offset: u64, length: u64) -> io::Result<Vec<u8>> {
        let fits = self.contains(offset, length) && length <= MAX_RECORD + HEAD as u64;
        let length = usize::try_from(length).ok().filter(|_| fits).ok_or_else(|| {
            io::Error::other(format!("a record of {length} bytes at byte {offset} is too long"))
        })?;
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, offset)?;
        Ok(bytes)
    }

    /// Reads a chunk and decompresses it into `out`. The error says what is wrong with it.
    pub fn read_chunk(&self, chunk: ChunkRef, out: &mut Vec<u8>) -> Result<(), ReadError> {
        self.try_read_chunk(chunk, out).map_err(|why| {
            ReadError(format!("{}: chunk at byte {}: {why}", self.path.display(), chunk.offset))
        })
    }

    fn try_read_chunk(&self, chunk: ChunkRef, out: &mut Vec<u8>) -> Result<(), String> {
        let bytes = self.read_record(chunk.offset, chunk.length).map_err(|e| e.to_string())?;
        let record = records(&bytes).next().filter(|record| record.opcode == op::CHUNK);
        let record = record.ok_or("there is no chunk there")?;
        let (head, rest) = ChunkHead::of(record.body).ok_or("its head is cut")?;
        let compressed = usize::try_from(head.compressed).ok().and_then(|n| rest.get(..n));
        unpack(&head, compressed.ok_or("its data are cut")?, out).map_err(|why| why.to_string())
    }

    /// Reads an attachment's data.
    pub fn read_attachment(&self, index: &AttachmentIndex) -> Result<Vec<u8>, ReadError> {
        let failed = |why: String| {
            ReadError(format!("{}: attachment \"{}\": {why}", self.path.display(), index.name))
        };
        let bytes =
            self.read_record(index.offset, index.length).map_err(|e| failed(e.to_string()))?;
        records(&bytes)
            .next()
            .filter(|record| record.opcode == op::ATTACHMENT)
            .and_then(|record| AttachmentIndex::of_attachment(index.offset, record.body))
            .map(|(_, data)| data.to_vec())
            .ok_or_else(|| failed("it is damaged".to_owned()))
    }

    /// A fact of the metadata record `name`.
    pub fn fact(&self, name: &str, key: &str) -> Option<&str> {
        self.metadata.get(name)?.get(key).map(String::as_str)
    }
}
