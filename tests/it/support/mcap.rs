//! A strict reader of MCAP files, written from the format's specification alone.
//!
//! It accepts only what a careful writer writes: every checksum there and right, every index exact,
//! every chunk with a message. The text of an error says what is wrong and where.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const FOOTER: usize = 9 + 20;

/// What a file holds.
#[derive(Clone, Debug, Default)]
pub struct Mcap {
    pub library: String,
    /// Opcode and offset of each record outside of chunks.
    pub records: Vec<(u8, usize)>,
    /// Name, encoding and data.
    pub schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    pub channels: BTreeMap<u16, Channel>,
    pub messages: Vec<Message>,
    /// In the order of the file.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    pub attachments: Vec<Attachment>,
    pub chunks: Vec<Chunk>,
    /// How far it could be read: its size, unless it was cut off.
    pub end: usize,
    pub size: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    pub schema: u16,
    pub topic: String,
    pub encoding: String,
    pub metadata: BTreeMap<String, String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    pub channel: u16,
    pub time: u64,
    pub data: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    pub name: String,
    pub media_type: String,
    pub data: Vec<u8>,
}

/// Where a chunk stands, its times, and for each channel its index: time and offset.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chunk {
    pub offset: usize,
    pub length: usize,
    pub start: u64,
    pub end: u64,
    pub uncompressed: u64,
    pub messages: usize,
    index: BTreeMap<u16, Vec<(u64, u64)>>,
    /// Where each channel's index record stands.
    index_at: BTreeMap<u16, u64>,
}

/// Reads a finished file.
pub fn finished(path: &Path) -> Mcap {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    parse(&bytes, true).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Reads a file that was cut off, up to the first record that is not whole.
pub fn cut(path: &Path) -> Mcap {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    parse(&bytes, false).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

impl Mcap {
    pub fn topic(&self, message: &Message) -> &str {
        &self.channels[&message.channel].topic
    }

    /// The messages of a topic, in the order of the file.
    pub fn on<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |m| self.topic(m) == topic)
    }

    /// A metadata record.
    pub fn facts(&self, name: &str) -> &BTreeMap<String, String> {
        let mut found = self.metadata.iter().filter(|(n, _)| n == name);
        let (_, facts) = found.next().unwrap_or_else(|| panic!("no metadata {name}"));
        assert!(found.next().is_none(), "metadata {name} twice");
        facts
    }
}

type Outcome<T> = Result<T, String>;

/// Reads the bytes of a file.
pub fn parse(bytes: &[u8], whole: bool) -> Outcome<Mcap> {
    let mut mcap = Mcap { size: bytes.len(), ..Mcap::default() };
    if !whole && MAGIC.starts_with(bytes) {
        return Ok(mcap);
    }
    ensure(bytes.starts_with(MAGIC), || "no magic".into())?;
    let mut at = MAGIC.len();
    let mut summary = None;
    while let Some((opcode, body, next)) = record(bytes, at) {
        mcap.records.push((opcode, at));
        mcap.take(opcode, body, at, next).map_err(|e| format!("record {opcode} at {at}: {e}"))?;
        at = next;
        if opcode == 15 {
            let crc = Cursor(body).u32()?;
            ensure(crc == crc32fast::hash(&bytes[..at - 13]), || "data checksum".into())?;
            summary = Some(at);
            break;
        }
    }
    mcap.end = at;
    match summary {
        Some(at) => match mcap.check_summary(bytes, at) {
            Err(why) if whole => return Err(why),
            _ => {}
        },
        None => ensure(!whole, || format!("not finished: ends at {at} of {}", bytes.len()))?,
    }
    let last = if whole { mcap.chunks.len() } else { mcap.chunks.len().saturating_sub(1) };
    for chunk in &mcap.chunks[..last] {
        let missing = || format!("chunk at {}: message index missing", chunk.offset);
        ensure(chunk.index.keys().eq(chunk.index_at.keys()), missing)?;
    }
    Ok(mcap)
}

/// Opcode, content and end of the record at `at`, if it is whole.
fn record(bytes: &[u8], at: usize) -> Option<(u8, &[u8], usize)> {
    let mut cursor = Cursor(bytes.get(at..)?);
    let (opcode, length) = (cursor.u8().ok()?, cursor.u64().ok()?);
    let body = cursor.take(usize::try_from(length).ok()?).ok()?;
    Some((opcode, body, at + 9 + body.len()))
}

impl Mcap {
    fn take(&mut self, opcode: u8, body: &[u8], at: usize, next: usize) -> Outcome<()> {
        let mut cursor = Cursor(body);
        ensure((opcode == 1) == (self.records.len() == 1), || "header is not first".into())?;
        match opcode {
            1 => {
                ensure(cursor.text()?.is_empty(), || "profile".into())?;
                self.library = cursor.text()?;
            }
            6 => self.take_chunk(&mut cursor, at, next)?,
            7 => {
                let channel = cursor.u16()?;
                let length = cursor.u32()? as usize;
                let mut entries = Cursor(cursor.take(length)?);
                let mut index = Vec::new();
                while !entries.0.is_empty() {
                    index.push((entries.u64()?, entries.u64()?));
                }
                let chunk = self.chunks.last_mut().ok_or("message index before any chunk")?;
                ensure(chunk.index.get(&channel) == Some(&index), || "wrong index".into())?;
                let again = chunk.index_at.insert(channel, at as u64);
                ensure(again.is_none(), || format!("index of channel {channel} twice"))?;
            }
            9 => {
                let covered = body.len().checked_sub(4).ok_or("short")?;
                let _times = (cursor.u64()?, cursor.u64()?);
                let (name, media_type) = (cursor.text()?, cursor.text()?);
                let length = cursor.u64()? as usize;
                let data = cursor.take(length)?.to_vec();
                let crc = cursor.u32()?;
                ensure(crc == crc32fast::hash(&body[..covered]), || "checksum".into())?;
                self.attachments.push(Attachment { name, media_type, data });
            }
            12 => self.metadata.push((cursor.text()?, cursor.facts()?)),
            15 => drop(cursor.u32()?),
            other => return Err(format!("opcode {other} does not belong here")),
        }
        ensure(cursor.0.is_empty(), || format!("{} bytes too many", cursor.0.len()))
    }

    fn take_chunk(&mut self, cursor: &mut Cursor<'_>, at: usize, next: usize) -> Outcome<()> {
        let (start, end) = (cursor.u64()?, cursor.u64()?);
        let (uncompressed, crc) = (cursor.u64()?, cursor.u32()?);
        ensure(cursor.text()? == "zstd", || "compression".into())?;
        let length = cursor.u64()? as usize;
        let compressed = cursor.take(length)?;
        let records = zstd::decode_all(compressed).map_err(|e| e.to_string())?;
        ensure(records.len() as u64 == uncompressed, || "uncompressed size".into())?;
        ensure(crc == crc32fast::hash(&records), || "chunk checksum".into())?;
        let length = next - at;
        let mut chunk = Chunk { offset: at, length, start, end, uncompressed, ..Chunk::default() };
        let (mut at, mut times) = (0, BTreeSet::new());
        while let Some((opcode, body, next)) = record(&records, at) {
            match opcode {
                3 | 4 => self.define(opcode, body)?,
                5 => {
                    let message = self.message(body)?;
                    times.insert(message.time);
                    let index = chunk.index.entry(message.channel).or_default();
                    index.push((message.time, at as u64));
                    chunk.messages += 1;
                    self.messages.push(message);
                }
                other => return Err(format!("opcode {other} in a chunk")),
            }
            at = next;
        }
        ensure(at == records.len(), || "a record is cut off inside the chunk".into())?;
        let span = times.first().copied().zip(times.last().copied());
        ensure(span == Some((start, end)), || format!("chunk says {start} {end}, has {span:?}"))?;
        self.chunks.push(chunk);
        Ok(())
    }

    fn define(&mut self, opcode: u8, body: &[u8]) -> Outcome<()> {
        let mut cursor = Cursor(body);
        let id = cursor.u16()?;
        let fresh = if opcode == 3 {
            ensure(id != 0, || "schema 0".into())?;
            let (name, encoding) = (cursor.text()?, cursor.text()?);
            let length = cursor.u32()? as usize;
            let schema = (name, encoding, cursor.take(length)?.to_vec());
            self.schemas.insert(id, schema.clone()).is_none_or(|s| s == schema)
        } else {
            let (schema, topic, encoding) = (cursor.u16()?, cursor.text()?, cursor.text()?);
            ensure(self.schemas.contains_key(&schema), || format!("no schema {schema}"))?;
            let channel = Channel { schema, topic, encoding, metadata: cursor.facts()? };
            self.channels.insert(id, channel.clone()).is_none_or(|c| c == channel)
        };
        ensure(cursor.0.is_empty() && fresh, || format!("definition {id}"))
    }

    fn message(&self, body: &[u8]) -> Outcome<Message> {
        let mut cursor = Cursor(body);
        let (channel, sequence) = (cursor.u16()?, cursor.u32()?);
        let (time, published) = (cursor.u64()?, cursor.u64()?);
        ensure(self.channels.contains_key(&channel), || format!("no channel {channel} yet"))?;
        ensure(sequence == 0 && published == time && time > 0, || "message head".into())?;
        Ok(Message { channel, time, data: cursor.0.to_vec() })
    }

    /// The summary must say exactly what was found before it.
    fn check_summary(&mut self, bytes: &[u8], start: usize) -> Outcome<()> {
        let footer = bytes.len().checked_sub(FOOTER + MAGIC.len()).ok_or("no footer")?;
        ensure(bytes.ends_with(MAGIC), || "no magic at the end".into())?;
        let mut told = Mcap::default();
        let (mut at, mut statistics, mut offsets) = (start, None, Vec::new());
        let (mut chunks, mut places, mut groups) =
            (Vec::new(), Vec::new(), Vec::<(u8, _, _)>::new());
        while at < footer {
            let (opcode, body, next) = record(bytes, at).ok_or("summary is cut off")?;
            let mut cursor = Cursor(body);
            match opcode {
                3 | 4 => told.define(opcode, body)?,
                8 => chunks.push(chunk_index(&mut cursor)?),
                10 => {
                    places.push((9, cursor.u64()?, cursor.u64()?));
                }
                11 => statistics = Some(body.to_vec()),
                13 => places.push((12, cursor.u64()?, cursor.u64()?)),
                14 => offsets.push((cursor.u8()?, cursor.u64()?, cursor.u64()?)),
                other => return Err(format!("opcode {other} in the summary")),
            }
            match groups.last_mut().filter(|(of, ..)| *of == opcode) {
                Some((_, _, end)) => *end = next,
                None => groups.push((opcode, at, next)),
            }
            at = next;
        }
        ensure(told.schemas == self.schemas, || "schemas of the summary differ".into())?;
        ensure(told.channels == self.channels, || "channels of the summary differ".into())?;
        let expected: Vec<_> = self.chunks.iter().map(Chunk::as_indexed).collect();
        ensure(chunks == expected, || "chunk indexes differ".into())?;
        for wanted in [9, 12] {
            let found = self.records.iter().filter(|(opcode, _)| *opcode == wanted);
            let found = found.map(|&(op, at)| (op, at as u64, record(bytes, at).unwrap().2 - at));
            let told = places.iter().filter(|p| p.0 == wanted).map(|p| (p.0, p.1, p.2 as usize));
            ensure(found.eq(told), || format!("indexes of records {wanted} differ"))?;
        }
        let offsets_at = groups.pop_if(|(opcode, ..)| *opcode == 14).map_or(0, |(_, at, _)| at);
        let groups: Vec<_> =
            groups.iter().map(|&(op, a, b)| (op, a as u64, (b - a) as u64)).collect();
        ensure(offsets == groups, || format!("summary offsets {offsets:?} for {groups:?}"))?;
        self.check_statistics(&statistics.ok_or("no statistics")?)?;
        let (opcode, body, end) = record(bytes, footer).ok_or("no footer")?;
        let mut cursor = Cursor(body);
        ensure((opcode, end) == (2, bytes.len() - MAGIC.len()), || "footer".into())?;
        ensure(cursor.u64()? == start as u64, || "summary start".into())?;
        ensure(cursor.u64()? == offsets_at as u64, || "summary offset start".into())?;
        let crc = crc32fast::hash(&bytes[start..end - 4]);
        ensure(cursor.u32()? == crc, || "summary checksum".into())?;
        self.end = bytes.len();
        Ok(())
    }

    fn check_statistics(&self, body: &[u8]) -> Outcome<()> {
        let mut cursor = Cursor(body);
        let mut counts = BTreeMap::new();
        for message in &self.messages {
            *counts.entry(message.channel).or_insert(0) += 1;
        }
        let times = || self.messages.iter().map(|m| m.time);
        let span = (times().min().unwrap_or(0), times().max().unwrap_or(0));
        ensure(cursor.u64()? == self.messages.len() as u64, || "message count".into())?;
        ensure(usize::from(cursor.u16()?) == self.schemas.len(), || "schema count".into())?;
        for count in
            [self.channels.len(), self.attachments.len(), self.metadata.len(), self.chunks.len()]
        {
            ensure(cursor.u32()? as usize == count, || "a count in the statistics".into())?;
        }
        ensure((cursor.u64()?, cursor.u64()?) == span, || "times in the statistics".into())?;
        let length = cursor.u32()? as usize;
        let mut map = Cursor(cursor.take(length)?);
        let mut told = BTreeMap::new();
        while !map.0.is_empty() {
            told.insert(map.u16()?, map.u64()?);
        }
        ensure(told == counts, || format!("channel counts {told:?}, not {counts:?}"))
    }
}

type ChunkIndex = (u64, u64, u64, u64, BTreeMap<u16, u64>, u64, u64);

fn chunk_index(cursor: &mut Cursor<'_>) -> Outcome<ChunkIndex> {
    let (start, end, offset, length) = (cursor.u64()?, cursor.u64()?, cursor.u64()?, cursor.u64()?);
    let map_length = cursor.u32()? as usize;
    let mut map = Cursor(cursor.take(map_length)?);
    let mut places = BTreeMap::new();
    while !map.0.is_empty() {
        places.insert(map.u16()?, map.u64()?);
    }
    let index_length = cursor.u64()?;
    ensure(cursor.text()? == "zstd", || "compression".into())?;
    let (_compressed, uncompressed) = (cursor.u64()?, cursor.u64()?);
    Ok((start, end, offset, length, places, index_length, uncompressed))
}

impl Chunk {
    fn as_indexed(&self) -> ChunkIndex {
        let index_length = self.index.values().map(|e| 9 + 6 + 16 * e.len() as u64).sum();
        let (offset, length) = (self.offset as u64, self.length as u64);
        let places = self.index_at.clone();
        (self.start, self.end, offset, length, places, index_length, self.uncompressed)
    }
}

fn ensure(holds: bool, why: impl FnOnce() -> String) -> Outcome<()> {
    if holds { Ok(()) } else { Err(why()) }
}

struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, length: usize) -> Outcome<&'a [u8]> {
        let short = || format!("{length} bytes wanted, {} there", self.0.len());
        let (head, tail) = self.0.split_at_checked(length).ok_or_else(short)?;
        self.0 = tail;
        Ok(head)
    }

    fn number<const N: usize>(&mut self) -> Outcome<[u8; N]> {
        Ok(self.take(N)?.try_into().expect("N bytes were taken"))
    }

    fn u8(&mut self) -> Outcome<u8> {
        self.number().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Outcome<u16> {
        self.number().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Outcome<u32> {
        self.number().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Outcome<u64> {
        self.number().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Outcome<String> {
        let length = self.u32()? as usize;
        String::from_utf8(self.take(length)?.to_vec()).map_err(|e| e.to_string())
    }

    fn facts(&mut self) -> Outcome<BTreeMap<String, String>> {
        let length = self.u32()? as usize;
        let mut map = Cursor(self.take(length)?);
        let mut facts = BTreeMap::new();
        while !map.0.is_empty() {
            let (key, value) = (map.text()?, map.text()?);
            ensure(facts.insert(key, value).is_none(), || "a key twice".into())?;
        }
        Ok(facts)
    }
}
