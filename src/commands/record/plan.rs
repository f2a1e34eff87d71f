//! How to record, from what was typed.

use std::path::Path;
use std::time::Duration;

use anyhow::{Result, bail};

use crate::cli::RecordArgs;
use crate::commands::UsageError;
use crate::record::{Limits, Pace, Retention, Split, Target, WhenFull};
use crate::recording::definition::Attachment;
use crate::recording::disk::{Disk as _, RealDisk};
use crate::recording::writer::WriterOptions;
use crate::text::size;
use crate::trigger::Triggers;

/// Fewer segments than these could not be deleted one by one.
const LEAST_SEGMENTS: u64 = 3;

/// How to record.
pub struct Plan {
    /// Where to.
    pub target: Target,
    /// When a segment is full.
    pub split: Split,
    /// How a segment is written.
    pub writer: WriterOptions,
    /// How much may be in the folder.
    pub limits: Option<Limits>,
    /// When things reach the disk.
    pub pace: Pace,
    /// Bytes that may wait for the disk.
    pub queue: usize,
    /// Bytes that may wait for a trigger.
    pub window_memory: usize,
    /// Nothing but windows around triggers is kept.
    pub windows_only: bool,
    /// When to stop by itself.
    pub duration: Option<Duration>,
    /// After how many frames to stop.
    pub count: Option<u64>,
    /// What the recorder was told, attached to each segment.
    pub configuration: Option<Attachment>,
}

impl Plan {
    /// What the options say.
    pub fn of(args: &RecordArgs) -> Result<Self> {
        let mut split = Split { size: args.split_size, time: args.split_time, at: args.split_at };
        let (target, limits) = match (&args.output, &args.dir) {
            (Some(file), _) => (Target::File(file.clone()), None),
            (None, dir) => {
                let folder = dir.clone().unwrap_or_else(|| ".".into());
                let limits = limits(args)?;
                split.size = Some(args.split_size.unwrap_or_else(|| share(&folder, &limits)));
                if split.at.is_none() {
                    split.time = Some(args.split_time.unwrap_or(Duration::from_secs(3600)));
                }
                (Target::Folder(folder, args.name.clone()), Some(limits))
            }
        };
        let chunk_nanos = u64::try_from(args.chunk_time.as_nanos()).unwrap_or(u64::MAX);
        Ok(Self {
            target,
            split,
            limits,
            writer: WriterOptions {
                layout: args.layout,
                chunk_bytes: args.chunk_size,
                compression: args.compression,
                batch_nanos: chunk_nanos.min(WriterOptions::default().batch_nanos),
                ..WriterOptions::default()
            },
            pace: Pace { chunk: args.chunk_time, sync: args.sync },
            queue: usize::try_from(args.queue).unwrap_or(usize::MAX),
            window_memory: usize::try_from(args.window_memory).unwrap_or(usize::MAX),
            windows_only: args.windows_only,
            duration: args.duration,
            count: args.count,
            configuration: None,
        })
    }

    /// Windows need a folder, and somebody who asks for them.
    pub fn check_windows(&self, triggers: Option<&Triggers>) -> Result<()> {
        let asked = triggers.and_then(Triggers::reach).is_some();
        if asked && !matches!(self.target, Target::Folder(..)) {
            bail!(UsageError(
                "a trigger with \"before\" or \"after\" keeps a recording of its own in the folder \
                 windows of --dir; record with --dir instead of --output"
                    .to_owned()
            ));
        }
        if self.windows_only && !asked {
            bail!(UsageError(
                "with --windows-only nothing would be kept: no [[trigger]] has \"before\" or \
                 \"after\""
                    .to_owned()
            ));
        }
        Ok(())
    }

    /// Who deletes segments, where there may be too many.
    pub fn retention(&self) -> Option<Retention> {
        let Target::Folder(folder, name) = &self.target else { return None };
        let limits = self.limits?;
        Some(Retention::new(Box::new(RealDisk), folder.clone(), name.clone(), limits))
    }
}

fn limits(args: &RecordArgs) -> Result<Limits> {
    if let (Some(keep), Some(split)) = (args.keep_size, args.split_size)
        && keep < split.saturating_mul(LEAST_SEGMENTS)
    {
        bail!(UsageError(format!(
            "--keep-size {} is less than {LEAST_SEGMENTS} segments of --split-size {}: there would \
             be nothing to delete but the file being written",
            size(keep),
            size(split)
        )));
    }
    Ok(Limits {
        keep_size: args.keep_size,
        keep_time: args.keep_time,
        min_free: args.min_free,
        when_full: args.when_full,
    })
}

/// Size of a segment, so that there are enough of them to delete one by one.
fn share(folder: &Path, limits: &Limits) -> u64 {
    let ring = limits.when_full == WhenFull::Ring;
    let disk = ring.then(|| RealDisk.capacity(folder).ok()).flatten();
    let budget = limits.keep_size.into_iter().chain(disk).min();
    budget.map_or(1 << 30, |budget| (budget / 16).clamp(256 << 10, 1 << 30))
}
