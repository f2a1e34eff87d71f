//! An MCAP file being written: header, metadata, attachments, chunks, summary.
//!
//! Why not `mcap::Writer`: it compresses each record as a stream of small pieces, which costs three
//! times the CPU, and it does not tell when which message has reached the file. The records
//! themselves are the crate's. What a reader finds after a kill:
//!
//! * during [`Container::create`]: nothing, or a head without messages;
//! * at any later moment: everything up to the last chunk that was written in full. A chunk goes
//!   out in one `write` together with its index, so at most that one piece is cut.
//!
//! After the first error nothing more is written: what the disk did with a failed write is not
//! known, and a chunk after a torn one could not be found again.
//!
//! Source: MCAP format specification, version 0.

use std::collections::BTreeMap;
use std::io;

use mcap::records::{self, op};

use super::bytes::{body, put, put_bytes, record_bytes};
use super::chunk::{Chunk, MessageIndex};
use super::definition::{Attachment, ChannelDefinition, Facts, SchemaDefinition};
use super::disk::OutputFile;
use super::records::{AttachmentIndex, ChunkHead};
use super::summary::Summary;

/// How our own chunks are compressed.
const COMPRESSION: &str = "zstd";

/// Room is asked for in steps of this many bytes.
const AHEAD: u64 = 1 << 20;

/// Statistics, offsets, footer and the last metadata record: less than this.
const END: u64 = 16 << 10;

/// The file.
pub struct Container {
    out: Box<dyn OutputFile>,
    position: u64,
    /// Up to here the disk has room for it.
    held: u64,
    crc: crc32fast::Hasher,
    failed: bool,
    zstd: zstd::bulk::Compressor<'static>,
    compressed: Vec<u8>,
    block: Vec<u8>,
    /// Ids by name, checksum and length of the definition.
    schemas: BTreeMap<(String, u32, usize), u16>,
    summary: Summary,
}

impl Container {
    /// Writes the head of a new file. `level` is zstd's.
    pub fn create(out: Box<dyn OutputFile>, level: i32) -> io::Result<Self> {
        let library = format!("bustape/{}", env!("CARGO_PKG_VERSION"));
        let header = records::Header { profile: String::new(), library };
        Self::create_like(out, level, &body(&header)?)
    }

    /// Writes the head of a new file with the content of another file's header record.
    pub fn create_like(out: Box<dyn OutputFile>, level: i32, header: &[u8]) -> io::Result<Self> {
        let mut container = Self {
            out,
            position: 0,
            held: 0,
            crc: crc32fast::Hasher::new(),
            failed: false,
            zstd: zstd::bulk::Compressor::new(level)?,
            compressed: Vec::new(),
            block: Vec::new(),
            schemas: BTreeMap::new(),
            summary: Summary::default(),
        };
        let mut head = mcap::MAGIC.to_vec();
        put_bytes(&mut head, op::HEADER, header);
        container.append(&head)?;
        Ok(container)
    }

    /// Writes a metadata record.
    pub fn metadata(&mut self, name: &str, facts: Facts) -> io::Result<()> {
        let record = records::Metadata { name: name.to_owned(), metadata: facts };
        let bytes = record_bytes(op::METADATA, &record)?;
        self.copy_metadata(&bytes, name)
    }

    /// Writes a metadata record as it stands elsewhere.
    pub fn copy_metadata(&mut self, record: &[u8], name: &str) -> io::Result<()> {
        let (offset, length) = (self.position, record.len() as u64);
        let index = records::MetadataIndex { offset, length, name: name.to_owned() };
        self.append(record)?;
        self.summary.enter_metadata(&index)
    }

    /// Writes a record of which only its own program knows what it is.
    pub fn copy_private(&mut self, record: &[u8]) -> io::Result<()> {
        self.append(record)
    }

    /// Writes an attachment record as it stands elsewhere, piece by piece.
    pub fn copy_attachment(
        &mut self,
        index: &AttachmentIndex,
        pieces: impl Iterator<Item = Vec<u8>>,
    ) -> io::Result<()> {
        let index = records::AttachmentIndex {
            offset: self.position,
            length: index.length,
            log_time: index.log_time,
            create_time: index.create_time,
            data_size: index.size,
            name: index.name.clone(),
            media_type: index.media_type.clone(),
        };
        for piece in pieces {
            self.append(&piece)?;
        }
        self.summary.enter_attachment(&index)
    }

    /// Enters a schema record that stands in a copied chunk in the summary.
    pub fn enter_schema(&mut self, record: &[u8]) {
        self.summary.enter_schema(record);
    }

    /// Enters a channel record that stands in a copied chunk in the summary.
    pub fn enter_channel(&mut self, record: &[u8]) {
        self.summary.enter_channel(record);
    }

    /// Writes an attachment; `time` is nanoseconds since 1970.
    pub fn attachment(&mut self, time: u64, attachment: &Attachment) -> io::Result<()> {
        let header = records::AttachmentHeader {
            log_time: time,
            create_time: time,
            name: attachment.name.clone(),
            media_type: attachment.media_type.clone(),
        };
        let mut body = body(&header)?;
        let data_size = attachment.data.len() as u64;
        body.extend_from_slice(&data_size.to_le_bytes());
        body.extend_from_slice(&attachment.data);
        let crc = crc32fast::hash(&body);
        body.extend_from_slice(&crc.to_le_bytes());
        let mut bytes = Vec::new();
        put_bytes(&mut bytes, op::ATTACHMENT, &body);
        let index = records::AttachmentIndex {
            offset: self.position,
            length: bytes.len() as u64,
            log_time: time,
            create_time: time,
            data_size,
            name: header.name,
            media_type: header.media_type,
        };
        self.append(&bytes)?;
        self.summary.enter_attachment(&index)
    }

    /// Defines a channel, and its schema when it is new, in the open chunk. At most 65,535.
    pub fn channel(
        &mut self,
        chunk: &mut Chunk,
        definition: ChannelDefinition<'_>,
    ) -> io::Result<u16> {
        let schema_id = match &definition.schema {
            Some(schema) => self.schema(chunk, schema)?,
            None => 0,
        };
        let id = u16::try_from(self.summary.channels())
            .map_err(|_| io::Error::other("an MCAP file cannot have more than 65,535 channels"))?;
        let channel = records::Channel {
            id,
            schema_id,
            topic: definition.topic,
            message_encoding: definition.encoding,
            metadata: definition.metadata,
        };
        let bytes = record_bytes(op::CHANNEL, &channel)?;
        chunk.define(&bytes);
        self.summary.enter_channel(&bytes);
        Ok(id)
    }

    fn schema(&mut self, chunk: &mut Chunk, schema: &SchemaDefinition<'_>) -> io::Result<u16> {
        let crc = crc32fast::hash(schema.data);
        let key = (schema.name.to_owned(), crc, schema.data.len());
        if let Some(&id) = self.schemas.get(&key) {
            return Ok(id);
        }
        let id = u16::try_from(self.schemas.len() + 1)
            .map_err(|_| io::Error::other("an MCAP file cannot have more than 65,535 schemas"))?;
        let (name, encoding) = (schema.name.to_owned(), schema.encoding.to_owned());
        let mut body = body(&records::SchemaHeader { id, name, encoding })?;
        let length = u32::try_from(schema.data.len()).map_err(io::Error::other)?;
        body.extend_from_slice(&length.to_le_bytes());
        body.extend_from_slice(schema.data);
        let mut bytes = Vec::new();
        put_bytes(&mut bytes, op::SCHEMA, &body);
        chunk.define(&bytes);
        self.summary.enter_schema(&bytes);
        self.schemas.insert(key, id);
        Ok(id)
    }

    /// Compresses a chunk and writes it with its index in one piece. An empty chunk is kept: the
    /// definitions in it wait for the first message.
    pub fn write_chunk(&mut self, chunk: &mut Chunk) -> io::Result<()> {
        if chunk.is_empty() {
            return Ok(());
        }
        let (start, end) = chunk.index().span();
        self.compress(chunk.records())?;
        let header = records::ChunkHeader {
            message_start_time: start,
            message_end_time: end,
            uncompressed_size: chunk.len() as u64,
            uncompressed_crc: crc32fast::hash(chunk.records()),
            compression: COMPRESSION.to_owned(),
            compressed_size: self.compressed.len() as u64,
        };
        let head = body(&header)?;
        let mut block = std::mem::take(&mut self.block);
        block.clear();
        block.push(op::CHUNK);
        block.extend_from_slice(&((head.len() + self.compressed.len()) as u64).to_le_bytes());
        block.extend_from_slice(&head);
        block.extend_from_slice(&self.compressed);
        let sizes = (header.uncompressed_size, header.compressed_size);
        let written = self.write_block(&mut block, chunk.index(), header.compression, sizes);
        self.block = block;
        written?;
        chunk.clear();
        Ok(())
    }

    /// Writes a chunk record as it stands elsewhere, with an index of what is in it.
    pub fn copy_chunk(
        &mut self,
        record: &[u8],
        head: &ChunkHead<'_>,
        index: &MessageIndex,
    ) -> io::Result<()> {
        let mut block = std::mem::take(&mut self.block);
        block.clear();
        block.extend_from_slice(record);
        let sizes = (head.uncompressed, head.compressed);
        let written = self.write_block(&mut block, index, head.compression.to_owned(), sizes);
        self.block = block;
        written
    }

    /// Writes the chunk record in `block` with its index in one piece.
    fn write_block(
        &mut self,
        block: &mut Vec<u8>,
        messages: &MessageIndex,
        compression: String,
        (uncompressed_size, compressed_size): (u64, u64),
    ) -> io::Result<()> {
        let chunk_length = block.len() as u64;
        let message_index_offsets = self.put_message_indexes(messages, block);
        let (message_start_time, message_end_time) = messages.span();
        let index = records::ChunkIndex {
            message_start_time,
            message_end_time,
            chunk_start_offset: self.position,
            chunk_length,
            message_index_offsets,
            message_index_length: block.len() as u64 - chunk_length,
            compression,
            compressed_size,
            uncompressed_size,
        };
        self.append(block)?;
        self.summary.enter_chunk(&index, messages)
    }

    fn compress(&mut self, records: &[u8]) -> io::Result<()> {
        self.compressed.clear();
        self.compressed.reserve(zstd::zstd_safe::compress_bound(records.len()));
        self.zstd.compress_to_buffer(records, &mut self.compressed)?;
        Ok(())
    }

    /// Appends the index of each channel and returns where in the file each will stand.
    fn put_message_indexes(&self, index: &MessageIndex, block: &mut Vec<u8>) -> BTreeMap<u16, u64> {
        let mut offsets = BTreeMap::new();
        for (channel, entries) in index.channels() {
            offsets.insert(channel, self.position + block.len() as u64);
            block.push(op::MESSAGE_INDEX);
            block.extend_from_slice(&((2 + 4 + entries.len()) as u64).to_le_bytes());
            block.extend_from_slice(&channel.to_le_bytes());
            #[allow(clippy::cast_possible_truncation, reason = "a chunk is far below 4 GiB")]
            block.extend_from_slice(&(entries.len() as u32).to_le_bytes());
            block.extend_from_slice(entries);
        }
        offsets
    }

    /// Writes the summary and the end of the file.
    pub fn finish(&mut self) -> io::Result<()> {
        let mut data_end = Vec::new();
        let end = records::DataEnd { data_section_crc: self.crc.clone().finalize() };
        put(&mut data_end, op::DATA_END, &end)?;
        self.append(&data_end)?;
        let summary = self.summary.bytes(self.position)?;
        self.append(&summary)?;
        self.release();
        Ok(())
    }

    /// Keeps room for at least `need` more bytes and the end of the file, so that another program that
    /// fills the disk does not keep this one from being finished.
    pub fn hold_room(&mut self, need: u64) {
        let end = self.position + need + self.tail();
        if self.held < end {
            self.held = end + AHEAD;
            self.out.hold(self.position, self.held - self.position);
        }
    }

    fn release(&mut self) {
        if std::mem::take(&mut self.held) > 0 {
            self.out.give_back(self.position);
        }
    }

    /// Returns when everything written so far would survive a power cut.
    pub fn sync(&mut self) -> io::Result<()> {
        self.check()?;
        let result = self.out.sync();
        self.failed |= result.is_err();
        result
    }

    /// Channels defined so far.
    pub fn channels(&self) -> usize {
        self.summary.channels() as usize
    }

    /// Bytes in the file so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// About as many bytes as the end of the file will take.
    pub fn tail(&self) -> u64 {
        self.summary.size() + END
    }

    /// True after an error: the file stays as it is.
    pub fn failed(&self) -> bool {
        self.failed
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        if let Err(error) = self.out.write_all(bytes) {
            self.failed = true;
            // On a full disk the next file needs what this one holds.
            if error.kind() == io::ErrorKind::StorageFull {
                self.release();
            }
            return Err(error);
        }
        self.crc.update(bytes);
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn check(&self) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("an earlier write to this file failed"));
        }
        Ok(())
    }
}
