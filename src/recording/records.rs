//! MCAP records as they stand in a file, read without trusting a single length.
//!
//! Every length is checked against the bytes that are there before anything is allocated.
//! `mcap::parse_record` asks for the declared length of a text first, up to 4 GiB, so files from
//! outside must not reach it. Source: MCAP format specification, version 0.

use mcap::records::op;

use super::definition::Facts;
use super::limits::MAX_FACTS;

/// Opcode and length.
pub const HEAD: usize = 9;

/// One record: its opcode and its content.
#[derive(Clone, Copy, Debug)]
pub struct Record<'a> {
    /// Kind of the record, as in `mcap::records::op`.
    pub opcode: u8,
    /// What follows the length.
    pub body: &'a [u8],
}

/// Walks the records in `bytes`; ends at the first that does not fit.
pub fn records(bytes: &[u8]) -> impl Iterator<Item = Record<'_>> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let mut reader = Reader(rest);
        let (opcode, length) = (reader.u8()?, reader.u64()?);
        let body = reader.bytes(usize::try_from(length).ok()?)?;
        rest = reader.0;
        Some(Record { opcode, body })
    })
}

/// A message in a chunk.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// The channel it belongs to.
    pub channel: u16,
    /// Nanoseconds since 1970.
    pub log_time: u64,
    /// The payload.
    pub data: &'a [u8],
}

/// A schema, with its data where they stand.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Identifier, not 0.
    pub id: u16,
    /// Type name.
    pub name: String,
    /// Encoding of the data, such as `protobuf`.
    pub encoding: String,
    /// The definition.
    pub data: Vec<u8>,
}

/// A channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Identifier.
    pub id: u16,
    /// Its schema, 0 for none.
    pub schema: u16,
    /// Topic.
    pub topic: String,
    /// Encoding of its messages, such as `protobuf`.
    pub encoding: String,
    /// Whatever the writer noted.
    pub metadata: Facts,
}

/// Head of a chunk; the compressed records follow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkHead<'a> {
    /// Log time of its earliest message.
    pub start: u64,
    /// Log time of its latest message.
    pub end: u64,
    /// Bytes after decompression.
    pub uncompressed: u64,
    /// CRC-32 of those, 0 for none.
    pub crc: u32,
    /// `zstd`, `lz4` or empty.
    pub compression: &'a str,
    /// Bytes before decompression.
    pub compressed: u64,
}

/// Where an attachment stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AttachmentIndex {
    /// Of its record, from the start of the file.
    pub offset: u64,
    /// Of its record, with opcode and length.
    pub length: u64,
    /// When it was recorded, nanoseconds since 1970.
    pub log_time: u64,
    /// When it was made, nanoseconds since 1970, or 0.
    pub create_time: u64,
    /// Bytes of the attachment itself.
    pub size: u64,
    /// Its name, as the file says: not to be used as a path.
    pub name: String,
    /// Media type.
    pub media_type: String,
}

/// Where a chunk stands and what time it covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkRef {
    /// Log time of its earliest message.
    pub start: u64,
    /// Log time of its latest message.
    pub end: u64,
    /// Of its record, from the start of the file.
    pub offset: u64,
    /// Of its record, with opcode and length.
    pub length: u64,
    /// Which channels have messages in it, see [`channel_bit`].
    pub channels: u64,
}

/// The bit that stands for a channel in [`ChunkRef::channels`]. Channels from 63 on share one, so
/// a set bit means "perhaps", a clear one "no".
pub fn channel_bit(channel: u16) -> u64 {
    1 << channel.min(63)
}

/// Counts of a whole file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// All messages.
    pub messages: u64,
    /// Log times of the earliest and the latest message.
    pub span: (u64, u64),
    /// Messages of each channel.
    pub channels: std::collections::BTreeMap<u16, u64>,
}

impl<'a> Message<'a> {
    /// Reads a message record.
    pub fn of(body: &'a [u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let channel = reader.u16()?;
        let _sequence = reader.u32()?;
        let log_time = reader.u64()?;
        let _publish_time = reader.u64()?;
        Some(Self { channel, log_time, data: reader.0 })
    }
}

impl Schema {
    /// Reads a schema record.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let (id, name, encoding) = (reader.u16()?, reader.text()?, reader.text()?);
        let length = usize::try_from(reader.u32()?).ok()?;
        let data = reader.bytes(length)?.to_vec();
        Some(Self { id, name: name.to_owned(), encoding: encoding.to_owned(), data })
    }
}

impl Schema {
    /// The content of its record.
    pub fn body(&self) -> Vec<u8> {
        let mut body = self.id.to_le_bytes().to_vec();
        put_text(&mut body, &self.name);
        put_text(&mut body, &self.encoding);
        put_sized(&mut body, &self.data);
        body
    }
}

impl Channel {
    /// The content of its record.
    pub fn body(&self) -> Vec<u8> {
        let mut body = [self.id.to_le_bytes(), self.schema.to_le_bytes()].concat();
        put_text(&mut body, &self.topic);
        put_text(&mut body, &self.encoding);
        let mut facts = Vec::new();
        for (key, value) in &self.metadata {
            put_text(&mut facts, key);
            put_text(&mut facts, value);
        }
        put_sized(&mut body, &facts);
        body
    }
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    put_sized(out, text.as_bytes());
}

fn put_sized(out: &mut Vec<u8>, bytes: &[u8]) {
    // What is put here was read from a record, so it is shorter than one.
    out.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes());
    out.extend_from_slice(bytes);
}

impl Channel {
    /// Reads a channel record.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        Some(Self {
            id: reader.u16()?,
            schema: reader.u16()?,
            topic: reader.text()?.to_owned(),
            encoding: reader.text()?.to_owned(),
            metadata: reader.facts()?,
        })
    }
}

impl<'a> ChunkHead<'a> {
    /// Reads the head of a chunk record; the second part is what follows it.
    pub fn of(body: &'a [u8]) -> Option<(Self, &'a [u8])> {
        let mut reader = Reader(body);
        let head = Self {
            start: reader.u64()?,
            end: reader.u64()?,
            uncompressed: reader.u64()?,
            crc: reader.u32()?,
            compression: reader.text()?,
            compressed: reader.u64()?,
        };
        Some((head, reader.0))
    }
}

impl AttachmentIndex {
    /// Reads an attachment index record.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let (offset, length) = (reader.u64()?, reader.u64()?);
        let (log_time, create_time) = (reader.u64()?, reader.u64()?);
        let size = reader.u64()?;
        let (name, media_type) = (reader.text()?.to_owned(), reader.text()?.to_owned());
        Some(Self { offset, length, log_time, create_time, size, name, media_type })
    }

    /// Reads the start of an attachment record that stands at `offset` and is `length` bytes long
    /// in all: its index entry, and the data as far as they are in `start`.
    pub fn of_start(offset: u64, length: u64, start: &[u8]) -> Option<(Self, &[u8])> {
        let mut reader = Reader(start);
        let (log_time, create_time) = (reader.u64()?, reader.u64()?);
        let (name, media_type) = (reader.text()?.to_owned(), reader.text()?.to_owned());
        let size = reader.u64()?;
        // Opcode and length in front, a checksum behind.
        let around = (HEAD + start.len() - reader.0.len() + 4) as u64;
        let fits = size.checked_add(around) == Some(length);
        let index = Self { offset, length, log_time, create_time, size, name, media_type };
        fits.then_some((index, reader.0))
    }

    /// Reads an attachment record that stands at `offset`: its index entry and its data.
    pub fn of_attachment(offset: u64, body: &[u8]) -> Option<(Self, &[u8])> {
        let (index, data) = Self::of_start(offset, (HEAD + body.len()) as u64, body)?;
        let data = data.get(..usize::try_from(index.size).ok()?)?;
        Some((index, data))
    }
}

impl AttachmentIndex {
    /// True if an attachment's checksum, where it has one, is that of its bytes.
    pub fn is_intact(body: &[u8]) -> bool {
        let Some((covered, crc)) = body.split_last_chunk::<4>() else { return false };
        let crc = u32::from_le_bytes(*crc);
        Self::of_attachment(0, body).is_some() && (crc == 0 || crc32fast::hash(covered) == crc)
    }
}

impl ChunkRef {
    /// Reads a chunk index record.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let (start, end, offset, length) =
            (reader.u64()?, reader.u64()?, reader.u64()?, reader.u64()?);
        let map_length = usize::try_from(reader.u32()?).ok()?;
        let mut map = Reader(reader.bytes(map_length)?);
        let mut channels = 0;
        while let (Some(channel), Some(_offset)) = (map.u16(), map.u64()) {
            channels |= channel_bit(channel);
        }
        Some(Self { start, end, offset, length, channels })
    }
}

impl Statistics {
    /// Reads a statistics record.
    pub fn of(body: &[u8]) -> Option<Self> {
        let mut reader = Reader(body);
        let messages = reader.u64()?;
        let _counts = (reader.u16()?, reader.u32()?, reader.u32()?, reader.u32()?, reader.u32()?);
        let span = (reader.u64()?, reader.u64()?);
        let length = usize::try_from(reader.u32()?).ok()?;
        let mut map = Reader(reader.bytes(length)?);
        let mut channels = std::collections::BTreeMap::new();
        while let (Some(id), Some(count)) = (map.u16(), map.u64()) {
            channels.insert(id, count);
        }
        Some(Self { messages, span, channels })
    }
}

/// True if `body` is a header record's: profile and library.
pub fn is_header(body: &[u8]) -> bool {
    let mut reader = Reader(body);
    reader.text().and_then(|_| reader.text()).is_some() && reader.0.is_empty()
}

/// Reads a metadata record: its name and content.
pub fn metadata(body: &[u8]) -> Option<(String, Facts)> {
    let mut reader = Reader(body);
    Some((reader.text()?.to_owned(), reader.facts()?))
}

/// Reads a metadata index record: offset and length of the record it points to.
pub fn metadata_index(body: &[u8]) -> Option<(u64, u64)> {
    let mut reader = Reader(body);
    Some((reader.u64()?, reader.u64()?))
}

/// Reads a message index record: the channel, and how many messages of it its chunk has.
pub fn message_index(body: &[u8]) -> Option<(u16, u64)> {
    let mut reader = Reader(body);
    let (channel, length) = (reader.u16()?, reader.u32()?);
    Some((channel, u64::from(length) / super::chunk::INDEX_ENTRY as u64))
}

/// Reads a message index record whose shape is exact: the channel, and each entry's time and offset.
pub fn message_index_entries(body: &[u8]) -> Option<(u16, impl Iterator<Item = (u64, u64)> + '_)> {
    let mut reader = Reader(body);
    let (channel, length) = (reader.u16()?, reader.u32()?);
    let whole = reader.0.len() as u64 == u64::from(length) && length.is_multiple_of(16);
    let entries = std::iter::from_fn(move || Some((reader.u64()?, reader.u64()?)));
    whole.then_some((channel, entries))
}

/// Reads a footer: where the summary starts (0 for none), and its CRC-32 (0 for none).
pub fn footer(record: Record<'_>) -> Option<(u64, u32)> {
    let mut reader = Reader(record.body);
    let (start, _offsets, crc) = (reader.u64()?, reader.u64()?, reader.u32()?);
    (record.opcode == op::FOOTER).then_some((start, crc))
}

/// Takes values off the front of a slice.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(length)?;
        self.0 = tail;
        Some(head)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = usize::try_from(self.u32()?).ok()?;
        std::str::from_utf8(self.bytes(length)?).ok()
    }

    fn facts(&mut self) -> Option<Facts> {
        let length = usize::try_from(self.u32()?).ok()?;
        let mut map = Reader(self.bytes(length)?);
        let mut facts = Facts::new();
        while !map.0.is_empty() {
            if facts.len() >= MAX_FACTS {
                return None;
            }
            facts.insert(map.text()?.to_owned(), map.text()?.to_owned());
        }
        Some(facts)
    }
}
