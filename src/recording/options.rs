//! How a segment is written, and what stands at its head.

use super::definition::{Attachment, Facts};
use crate::frame::Timestamp;

/// How CAN frames stand in the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Layout {
    /// One message for each frame: browsable in every viewer
    #[default]
    Frame,
    /// Many frames in one columnar message: several times smaller and faster
    Batch,
}

impl Layout {
    /// As it is called on the command line and in the metadata.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::Batch => "batch",
        }
    }
}

/// How a segment is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriterOptions {
    /// How CAN frames stand in the file.
    pub layout: Layout,
    /// A chunk is cut when its messages reach this many bytes, uncompressed.
    pub chunk_bytes: usize,
    /// Most frames in one batch message, 1 to 2048.
    pub batch_frames: usize,
    /// Longest time from the first to the last frame of one batch message, nanoseconds. Readers
    /// that look for a time range widen it by this much.
    pub batch_nanos: u64,
    /// zstd level, 1 to 19. Above 3 this kind of data hardly gets smaller.
    pub compression: i32,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self {
            layout: Layout::Frame,
            chunk_bytes: 1 << 20,
            batch_frames: 1024,
            batch_nanos: 1_000_000_000,
            compression: 1,
        }
    }
}

/// What stands at the head of each segment.
#[derive(Clone, Debug, Default)]
pub struct Head {
    /// `bustape.recording`.
    pub recording: Facts,
    /// `bustape.clock`.
    pub clock: Facts,
    /// The buses, in order; their facts become `bustape.bus.<name>`.
    pub buses: Vec<(String, Facts)>,
    /// Any other metadata.
    pub more: Vec<(String, Facts)>,
    /// Definitions and configuration, byte-exact.
    pub attachments: Vec<Attachment>,
    /// When the segment was started.
    pub time: Timestamp,
}
