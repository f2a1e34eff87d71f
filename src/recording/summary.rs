//! The summary section of a file, collected while the file is written.
//!
//! Source: MCAP format specification, version 0: schemas, channels, statistics, indexes of chunks,
//! attachments and metadata, then where each group begins, then the footer.

use std::collections::BTreeMap;
use std::io;

use mcap::records::{self, op};

use super::bytes::{put, record_bytes};
use super::chunk::{INDEX_ENTRY, MessageIndex};

/// What the summary will say.
pub struct Summary {
    groups: Groups,
    statistics: records::Statistics,
}

/// The records of the summary section, serialized as they become known.
#[derive(Default)]
struct Groups {
    schemas: Vec<u8>,
    channels: Vec<u8>,
    chunks: Vec<u8>,
    attachments: Vec<u8>,
    metadata: Vec<u8>,
}

impl Default for Summary {
    fn default() -> Self {
        let statistics = records::Statistics {
            message_count: 0,
            schema_count: 0,
            channel_count: 0,
            attachment_count: 0,
            metadata_count: 0,
            chunk_count: 0,
            message_start_time: 0,
            message_end_time: 0,
            channel_message_counts: BTreeMap::new(),
        };
        Self { groups: Groups::default(), statistics }
    }
}

impl Summary {
    /// Enters a schema record.
    pub fn enter_schema(&mut self, record: &[u8]) {
        self.groups.schemas.extend_from_slice(record);
        self.statistics.schema_count += 1;
    }

    /// Enters a channel record.
    pub fn enter_channel(&mut self, record: &[u8]) {
        self.groups.channels.extend_from_slice(record);
        self.statistics.channel_count += 1;
    }

    /// Enters a metadata record.
    pub fn enter_metadata(&mut self, index: &records::MetadataIndex) -> io::Result<()> {
        self.statistics.metadata_count += 1;
        put(&mut self.groups.metadata, op::METADATA_INDEX, index)
    }

    /// Enters an attachment.
    pub fn enter_attachment(&mut self, index: &records::AttachmentIndex) -> io::Result<()> {
        self.statistics.attachment_count += 1;
        put(&mut self.groups.attachments, op::ATTACHMENT_INDEX, index)
    }

    /// Enters a chunk and its messages.
    pub fn enter_chunk(
        &mut self,
        index: &records::ChunkIndex,
        messages: &MessageIndex,
    ) -> io::Result<()> {
        put(&mut self.groups.chunks, op::CHUNK_INDEX, index)?;
        let (start, end) = messages.span();
        let statistics = &mut self.statistics;
        let first = statistics.message_count == 0;
        statistics.message_start_time =
            if first { start } else { statistics.message_start_time.min(start) };
        statistics.message_end_time = statistics.message_end_time.max(end);
        statistics.message_count += messages.messages();
        statistics.chunk_count += 1;
        for (channel, entries) in messages.channels() {
            *statistics.channel_message_counts.entry(channel).or_default() +=
                (entries.len() / INDEX_ENTRY) as u64;
        }
        Ok(())
    }

    /// Channels entered so far.
    pub fn channels(&self) -> u32 {
        self.statistics.channel_count
    }

    /// Bytes of what was entered.
    pub fn size(&self) -> u64 {
        let Groups { schemas, channels, chunks, attachments, metadata } = &self.groups;
        let groups = [schemas, channels, chunks, attachments, metadata];
        groups.iter().map(|group| group.len() as u64).sum()
    }

    /// The section with the footer and the end of the file, for a summary that begins at `position`.
    pub fn bytes(&self, position: u64) -> io::Result<Vec<u8>> {
        let statistics = record_bytes(op::STATISTICS, &self.statistics)?;
        let groups = [
            (op::SCHEMA, &self.groups.schemas),
            (op::CHANNEL, &self.groups.channels),
            (op::STATISTICS, &statistics),
            (op::CHUNK_INDEX, &self.groups.chunks),
            (op::ATTACHMENT_INDEX, &self.groups.attachments),
            (op::METADATA_INDEX, &self.groups.metadata),
        ];
        let mut bytes =
            Vec::with_capacity(groups.iter().map(|(_, g)| g.len()).sum::<usize>() + 512);
        let mut offsets = Vec::new();
        for (group_opcode, group) in groups.into_iter().filter(|(_, group)| !group.is_empty()) {
            let offset = records::SummaryOffset {
                group_opcode,
                group_start: position + bytes.len() as u64,
                group_length: group.len() as u64,
            };
            put(&mut offsets, op::SUMMARY_OFFSET, &offset)?;
            bytes.extend_from_slice(group);
        }
        let summary_offset_start = position + bytes.len() as u64;
        bytes.extend_from_slice(&offsets);
        let footer =
            records::Footer { summary_start: position, summary_offset_start, summary_crc: 0 };
        put(&mut bytes, op::FOOTER, &footer)?;
        // The checksum covers everything up to itself and stands in the footer's last four bytes.
        let at = bytes.len() - 4;
        let crc = crc32fast::hash(&bytes[..at]);
        bytes[at..].copy_from_slice(&crc.to_le_bytes());
        bytes.extend_from_slice(mcap::MAGIC);
        Ok(bytes)
    }
}
