//! How to record, from what was typed.

use std::time::Duration;

use crate::cli::RecordArgs;
use crate::record::{Pace, Split, Target};
use crate::recording::writer::WriterOptions;

/// How to record.
pub struct Plan {
    /// Where to.
    pub target: Target,
    /// When a segment is full.
    pub split: Split,
    /// How a segment is written.
    pub writer: WriterOptions,
    /// When things reach the disk.
    pub pace: Pace,
    /// Bytes that may wait for the disk.
    pub queue: usize,
    /// When to stop by itself.
    pub duration: Option<Duration>,
    /// After how many frames to stop.
    pub count: Option<u64>,
}

impl Plan {
    /// What the options say.
    pub fn of(args: &RecordArgs) -> Self {
        let (target, split) = match (&args.output, &args.dir) {
            (Some(file), _) => {
                (Target::File(file.clone()), Split { size: args.split_size, time: args.split_time })
            }
            (None, dir) => (
                Target::Folder(dir.clone().unwrap_or_else(|| ".".into()), args.name.clone()),
                Split {
                    size: Some(args.split_size.unwrap_or(1 << 30)),
                    time: Some(args.split_time.unwrap_or(Duration::from_secs(3600))),
                },
            ),
        };
        let chunk_nanos = u64::try_from(args.chunk_time.as_nanos()).unwrap_or(u64::MAX);
        Self {
            target,
            split,
            writer: WriterOptions {
                layout: args.layout,
                chunk_bytes: args.chunk_size,
                compression: args.compression,
                batch_nanos: chunk_nanos.min(WriterOptions::default().batch_nanos),
                ..WriterOptions::default()
            },
            pace: Pace { chunk: args.chunk_time, sync: args.sync },
            queue: usize::try_from(args.queue).unwrap_or(usize::MAX),
            duration: args.duration,
            count: args.count,
        }
    }
}
