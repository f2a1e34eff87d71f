//! `bustape convert`: the same recording, written anew.

use std::collections::BTreeMap;
use std::io::IsTerminal as _;

use anyhow::{Result, bail};

use super::{Ended, info, output};
use crate::cli::ConvertArgs;
use crate::frame::Stamped;
use crate::record::{Segments, Split, Target};
use crate::recording::definition::{Attachment, ChannelDefinition, Facts, SchemaDefinition};
use crate::recording::disk::RealDisk;
use crate::recording::reader::{Entries, Entry, Recording};
use crate::recording::segment::Segment;
use crate::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};
use crate::text::size;

/// Runs the command.
pub fn run(args: &ConvertArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    let options = WriterOptions {
        layout: args.layout.unwrap_or_else(|| layout_of(&recording)),
        compression: args.compression,
        ..WriterOptions::default()
    };
    let target = Target::File(args.output.clone());
    let mut segments = Segments::new(Box::new(RealDisk), target, Split::default(), options)?;
    let (start, _) = recording.span().unwrap_or_default();
    let mut out = segments.open(start, &head(&recording)?)?;
    let mut entries = recording.entries(Recording::ALL, |_| true);
    let copied = copy(&recording, &mut entries, &mut out.writer)
        .and_then(|()| out.writer.finish(summary(&recording)))
        .and_then(|()| out.writer.sync());
    if let Err(error) = copied {
        // The original is still there; half of a copy is of no use to anybody.
        segments.discard(out);
        bail!("cannot write {}: {error}", args.output.display());
    }
    let damage = entries.damage().to_vec();
    segments.name(out)?;
    let written = std::fs::metadata(&args.output)?.len();
    let before: u64 = recording.segments.iter().map(|s| s.size).sum();
    output::note(&format!("{}: {} (was {})", args.output.display(), size(written), size(before)));
    Ok(report(&recording, &damage))
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

fn layout_of(recording: &Recording) -> Layout {
    let fact = recording.segments.first().and_then(|s| s.fact("bustape.recording", "layout"));
    if fact == Some(Layout::Batch.name()) { Layout::Batch } else { Layout::Frame }
}

/// What stands at the head of the new file: that of the first segment, with every attachment.
fn head(recording: &Recording) -> Result<Head> {
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

/// Metadata that are not the recorder's own, each name once.
fn other_metadata(recording: &Recording) -> Vec<(String, Facts)> {
    let all = recording.segments.iter().flat_map(|segment| &segment.metadata);
    let foreign = all.filter(|(name, _)| !name.starts_with("bustape."));
    let once: BTreeMap<_, _> = foreign.map(|(n, f)| (n.clone(), f.clone())).collect();
    once.into_iter().collect()
}

/// The books at the end, and which file said so.
fn summary(recording: &Recording) -> Facts {
    let last = recording.segments.iter().rev().find_map(|s| s.metadata.get("bustape.summary"));
    let cut = Facts::from([("reason".to_owned(), "converted from an unfinished file".to_owned())]);
    last.cloned().unwrap_or(cut)
}

fn copy(
    recording: &Recording,
    entries: &mut Entries<'_>,
    out: &mut SegmentWriter,
) -> std::io::Result<()> {
    let progress = std::io::stderr().is_terminal();
    let total = entries.bytes_left().max(1);
    let mut channels = BTreeMap::new();
    let mut percent = 0;
    while let Some(Stamped { time, value }) = entries.next() {
        match value {
            Entry::Frame(bus, frame) => out.add(bus, &Stamped { time, value: frame })?,
            Entry::Message { segment, channel, data } => {
                let definition = definition(&recording.segments[segment], channel);
                let key = (definition.topic.clone(), definition.schema_name().to_owned());
                let id = match channels.get(&key) {
                    Some(&id) => id,
                    None => out.define(definition)?,
                };
                channels.insert(key, id);
                out.add_raw(id, time, &data);
            }
        }
        if out.is_full() {
            out.cut()?;
            let now = 100 - entries.bytes_left() * 100 / total;
            if progress && now != percent {
                percent = now;
                anstream::eprint!("\r{percent:3} %\r");
            }
        }
    }
    Ok(())
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
