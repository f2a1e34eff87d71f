//! A recording written anew into one file: what `convert` and `decode` share.

use std::collections::BTreeMap;
use std::io::{self, IsTerminal as _};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};

use super::books::Books;
use super::interrupt::Interrupt;
use super::{Ended, info, output};
use crate::frame::{Stamped, Timestamp};
use crate::record::{Segments, Split, Target};
use crate::recording::definition::{Attachment, ChannelDefinition, Facts, SchemaDefinition};
use crate::recording::disk::RealDisk;
use crate::recording::reader::{Entries, Entry, Recording};
use crate::recording::segment::Segment;
use crate::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};
use crate::text::size;

/// What becomes of the entries of a recording.
pub trait Copy {
    /// Writes what follows from an entry.
    fn entry(&mut self, entry: Stamped<Entry>, out: &mut SegmentWriter) -> io::Result<()>;

    /// Writes what is left, and says what else the summary tells.
    fn end(&mut self, out: &mut SegmentWriter, summary: &mut Facts) -> io::Result<()>;
}

/// Writes `entries` of `recording` into the new file `path`, whose head is `head`.
pub fn write(
    recording: &Recording,
    mut entries: Entries<'_>,
    path: &Path,
    options: WriterOptions,
    head: &Head,
    copy: &mut impl Copy,
) -> Result<Ended> {
    let interrupt = Interrupt::watch()?;
    let target = Target::File(path.to_owned());
    let mut segments = Segments::new(Arc::new(RealDisk), target, Split::default(), options)?;
    let mut out = segments.open(head.time, head, "")?;
    let mut summary = summary(recording);
    let failed = || format!("cannot write {}", path.display());
    let copied =
        copy_all(&mut entries, copy, &mut out.writer, &failed, &interrupt).and_then(|()| {
            let written = copy.end(&mut out.writer, &mut summary);
            let written = written.and_then(|()| out.writer.finish(summary));
            let written = written.and_then(|()| out.writer.sync());
            written.with_context(failed)
        });
    if let Err(error) = copied.and_then(|()| interrupt.check()) {
        // The original is still there; half of a copy is of no use to anybody.
        segments.discard(out);
        return Err(error);
    }
    let damage = entries.damage().to_vec();
    segments.name(out)?;
    let written = std::fs::metadata(path)?.len();
    let before: u64 = recording.segments.iter().map(|s| s.size).sum();
    output::note(&format!("{}: {} (was {})", path.display(), size(written), size(before)));
    Ok(report(recording, &damage))
}

fn copy_all(
    entries: &mut Entries<'_>,
    copy: &mut impl Copy,
    out: &mut SegmentWriter,
    failed: &impl Fn() -> String,
    interrupt: &Interrupt,
) -> Result<()> {
    let progress = io::stderr().is_terminal();
    let total = entries.bytes_left().max(1);
    let mut percent = 0;
    while let Some(entry) = entries.next() {
        interrupt.check()?;
        copy.entry(entry, out).with_context(failed)?;
        if out.is_full() {
            out.cut().with_context(failed)?;
            let now = 100 - entries.bytes_left() * 100 / total;
            if progress && now != percent {
                percent = now;
                anstream::eprint!("\r{percent:3} %\r");
            }
        }
    }
    Ok(())
}

/// The channels that were copied so far.
#[derive(Default)]
pub struct Channels {
    /// By what defines them.
    known: BTreeMap<Key, u16>,
    /// By segment and id there.
    ids: BTreeMap<(usize, u16), u16>,
}

/// Topic, and name and data of its schema.
type Key = (String, String, Vec<u8>);

impl Channels {
    /// Copies a message of channel `from` (segment and id) as it is.
    pub fn copy(
        &mut self,
        recording: &Recording,
        from: (usize, u16),
        time: Timestamp,
        data: &[u8],
        out: &mut SegmentWriter,
    ) -> io::Result<()> {
        let id = match self.ids.get(&from) {
            Some(&id) => id,
            None => self.define(recording, from, out)?,
        };
        out.add_raw(id, time, data);
        Ok(())
    }

    fn define(
        &mut self,
        recording: &Recording,
        from: (usize, u16),
        out: &mut SegmentWriter,
    ) -> io::Result<u16> {
        let definition = definition(&recording.segments[from.0], from.1);
        let data = definition.schema.map_or(Vec::new(), |schema| schema.data.to_vec());
        let key = (definition.topic.clone(), definition.schema_name().to_owned(), data);
        let id = match self.known.get(&key) {
            Some(&id) => id,
            None => out.define(definition)?,
        };
        self.known.insert(key, id);
        self.ids.insert(from, id);
        Ok(id)
    }
}

fn report(recording: &Recording, damage: &[String]) -> Ended {
    let mut ended = if damage.is_empty() { Ended::Well } else { Ended::WithLoss };
    for sentence in damage {
        output::warning(sentence);
    }
    for segment in recording.unfinished() {
        output::note(&format!(
            "{} was not finished: what was in memory when it was cut off is not in it",
            segment.path.display()
        ));
        if info::is_damaged(segment) {
            output::warning(&info::unfinished(segment));
            ended = Ended::WithLoss;
        }
    }
    ended
}

/// The layout of the original.
pub fn layout_of(recording: &Recording) -> Layout {
    let fact = recording.segments.first().and_then(|s| s.fact("bustape.recording", "layout"));
    if fact == Some(Layout::Batch.name()) { Layout::Batch } else { Layout::Frame }
}

/// What stands at the head of the new file: that of the first segment, with every attachment.
pub fn head(recording: &Recording) -> Result<Head> {
    let metadata = |name: &str| {
        let found = recording.segments.iter().find_map(|s| s.metadata.get(name));
        found.cloned().unwrap_or_default()
    };
    let mut about = metadata("bustape.recording");
    about.remove("batch_max_ns");
    about.remove("segment");
    let buses = recording.buses.iter();
    let mut attachments: Vec<Attachment> = Vec::new();
    for segment in &recording.segments {
        for index in &segment.attachments {
            let data = segment.read_attachment(index)?;
            let (name, media_type) = (index.name.clone(), index.media_type.clone());
            let attachment = Attachment { name, media_type, data };
            if !attachments.contains(&attachment) {
                attachments.push(attachment);
            }
        }
    }
    Ok(Head {
        recording: about,
        clock: metadata("bustape.clock"),
        buses: buses.map(|name| (name.clone(), metadata(&format!("bustape.bus.{name}")))).collect(),
        more: other_metadata(recording),
        attachments,
        time: recording.span().unwrap_or_default().0,
    })
}

/// Metadata that are not the recorder's own, what a window is about and what logs were imported, each
/// name once.
fn other_metadata(recording: &Recording) -> Vec<(String, Facts)> {
    let all = recording.segments.iter().flat_map(|segment| &segment.metadata);
    let told = ["bustape.window", "bustape.import"];
    let kept = |name: &str| told.contains(&name) || !name.starts_with("bustape.");
    let foreign = all.filter(|(name, _)| kept(name));
    let once: BTreeMap<_, _> = foreign.map(|(n, f)| (n.clone(), f.clone())).collect();
    once.into_iter().collect()
}

/// The end of the last file that has one, with the books of all files.
fn summary(recording: &Recording) -> Facts {
    let last = recording.segments.iter().rev().find_map(|s| s.metadata.get("bustape.summary"));
    let cut = Facts::from([("reason".to_owned(), "converted from an unfinished file".to_owned())]);
    let mut summary = last.cloned().unwrap_or(cut);
    for bus in &recording.buses {
        Books::of(recording, bus).enter(bus, &mut summary);
    }
    summary
}

fn definition(segment: &Segment, channel: u16) -> ChannelDefinition<'_> {
    // A message of a channel without a definition is passed over by the reader.
    let Some(found) = segment.channels.get(&channel) else { return ChannelDefinition::default() };
    let schema = segment.schemas.get(&found.schema).map(|schema| SchemaDefinition {
        name: &schema.name,
        encoding: &schema.encoding,
        data: &schema.data,
    });
    ChannelDefinition {
        topic: found.topic.clone(),
        encoding: found.encoding.clone(),
        schema,
        metadata: found.metadata.clone(),
    }
}
