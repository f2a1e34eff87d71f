//! How much a reader takes in of what a file claims: one set for every command.
//!
//! Files come from anywhere, and each of their lengths is a claim. Whatever is beyond these limits
//! is an error or is counted as damage; nothing is allocated for it first. With them a reader stays
//! below some 300 MiB whatever the file says, and below 30 MiB with files of our own. Texts, maps and
//! tables inside a record need no limit of their own: their lengths are checked against the record's.

/// Largest record taken into memory, except a summary. Our own chunks are at most a few MiB.
/// Attachments may be larger where they are only copied.
pub const MAX_RECORD: u64 = 64 << 20;

/// Largest chunk after decompression.
pub const MAX_CHUNK: u64 = 64 << 20;

/// Largest summary: some 2 million chunks.
pub const MAX_SUMMARY: u64 = 256 << 20;

/// Most bytes of schemas, channels and metadata that are kept of one file.
pub const MAX_DEFINITIONS: usize = 64 << 20;

/// Most entries of a metadata record, and of the metadata of a channel.
pub const MAX_FACTS: usize = 1 << 16;

/// What an entry takes in memory beside its letters, about.
pub const FACT: usize = 96;

/// Most frames a batch may have. Our own have at most 2048.
pub const MAX_BATCH_FRAMES: usize = 1 << 16;

/// Most frames that a reader takes from one chunk; a writer stops at half of it. Unpacked they are
/// much larger than in the file.
pub const MAX_CHUNK_FRAMES: usize = 1 << 20;

/// Where chunks overlap in time, no more of them are unpacked once this much memory is taken by those before.
pub const MAX_READY: usize = 64 << 20;

/// Most bytes that are examined while looking for the next sound record after damage, for each byte
/// of the file: a file made to look like a chunk at every byte must not take forever.
pub const MAX_SEARCH_FACTOR: u64 = 8;

/// What may be examined besides, however small the file.
pub const MIN_SEARCH: u64 = 256 << 20;
