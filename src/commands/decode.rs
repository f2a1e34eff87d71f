//! `bustape decode`: decoded channels for a recording that has none.

use std::collections::BTreeSet;
use std::io::{self, Write as _};

use anyhow::Result;
use serde_json::json;

use super::definitions::{self, Definitions};
use super::rewrite::{self, Channels, Copy};
use super::{Ended, output};
use crate::channels::Stream;
use crate::cli::DecodeArgs;
use crate::frame::{Frame, Level, Notice, Stamped, Timestamp, Unit};
use crate::recording::definition::{Attachment, Facts};
use crate::recording::message;
use crate::recording::reader::{Carriers, Entry, Recording};
use crate::recording::writer::{Head, SegmentWriter, WriterOptions};
use crate::text::{printable, printable_json};

/// What a bus is counted in, by what stands on its channel of raw data.
fn unit(recording: &Recording, bus: &str) -> Option<Unit> {
    let topic = format!("/{bus}/raw");
    recording.segments.iter().find_map(|segment| {
        let channel = segment.channels.values().find(|channel| channel.topic == topic)?;
        match segment.schemas.get(&channel.schema)?.name.as_str() {
            "bustape.CanFrame" | "bustape.CanBatch" => Some(Unit::Frames),
            "bustape.SerialBytes" => Some(Unit::Bytes),
            _ => None,
        }
    })
}

/// Runs the command.
pub fn run(args: &DecodeArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    let mut head = rewrite::head(&recording)?;
    let kept = needed(&head, &args.decode);
    let definitions = definitions::load(&args.decode, &recording.buses, kept)?;
    definitions.check(recording.buses.iter().map(|bus| (bus.clone(), unit(&recording, bus))))?;
    let Definitions { streams, attachments, incomplete, .. } = definitions;
    update(&mut head, &streams, attachments);
    let mut decode = Decode::new(&recording, streams);
    decode.say_replaced();
    let options = options(&recording, args.compression);
    let entries = recording.messages();
    let ended = rewrite::write(&recording, entries, &args.output, options, &head, &mut decode)?;
    report(&decode.streams, args.json)?;
    let stopped = decode.streams.iter().flatten().any(|stream| stream.stopped().is_some());
    let skipped = stopped || incomplete || decode.damaged > 0;
    if decode.damaged > 0 {
        output::warning(&format!("{} raw messages could not be understood", decode.damaged));
    }
    Ok(if skipped { Ended::WithLoss } else { ended })
}

/// The attachments that buses need which are not decoded now.
fn needed(head: &Head, asked: &[String]) -> Vec<Attachment> {
    let asked: BTreeSet<&str> = asked.iter().filter_map(|t| Some(t.split_once('=')?.0)).collect();
    let others = head.buses.iter().filter(|(bus, _)| !asked.contains(bus.as_str()));
    let names: BTreeSet<&str> = others
        .flat_map(|(_, facts)| facts.keys().filter_map(|key| key.strip_prefix("definition.")))
        .collect();
    head.attachments.iter().filter(|a| names.contains(a.name.as_str())).cloned().collect()
}

/// The new definitions take the place of attachments of their name.
fn update(head: &mut Head, streams: &[Option<Stream>], attachments: Vec<Attachment>) {
    head.attachments.retain(|old| attachments.iter().all(|new| new.name != old.name));
    head.attachments.extend(attachments);
    for ((_, facts), stream) in head.buses.iter_mut().zip(streams) {
        if let Some(stream) = stream {
            definitions::enter(stream, facts);
        }
    }
}

/// Raw messages stay as they are, so the layout and its longest batch do, too.
fn options(recording: &Recording, compression: i32) -> WriterOptions {
    let batches = recording
        .segments
        .iter()
        .filter_map(|s| s.fact("bustape.recording", "batch_max_ns")?.parse().ok());
    let layout = rewrite::layout_of(recording);
    let default = WriterOptions::default();
    let batch_nanos = batches.max().unwrap_or(default.batch_nanos);
    WriterOptions { layout, batch_nanos, compression, ..default }
}

/// Copies every message, and adds what the raw ones mean.
struct Decode<'a> {
    recording: &'a Recording,
    carriers: Carriers,
    channels: Channels,
    streams: Vec<Option<Stream>>,
    /// Segments and ids of decoded channels that are replaced, and of logs.
    replaced: BTreeSet<(usize, u16)>,
    logs: BTreeSet<(usize, u16)>,
    frames: Vec<Stamped<Frame>>,
    damaged: u64,
    last: Timestamp,
}

impl<'a> Decode<'a> {
    fn new(recording: &'a Recording, streams: Vec<Option<Stream>>) -> Self {
        let (mut replaced, mut logs) = (BTreeSet::new(), BTreeSet::new());
        for (index, segment) in recording.segments.iter().enumerate() {
            for channel in segment.channels.values() {
                let bus = channel.metadata.get("bus");
                let decoded = streams.iter().flatten().any(|s| bus.is_some_and(|b| b == s.bus()));
                if decoded && channel.metadata.contains_key("protocol") {
                    replaced.insert((index, channel.id));
                }
                if channel.topic == "/bustape/log" {
                    logs.insert((index, channel.id));
                }
            }
        }
        Self {
            recording,
            carriers: recording.carriers(),
            channels: Channels::default(),
            streams,
            replaced,
            logs,
            frames: Vec::new(),
            damaged: 0,
            last: Timestamp(0),
        }
    }

    fn say_replaced(&self) {
        let topic = |(segment, id): &(usize, u16)| {
            let channel = self.recording.segments[*segment].channels.get(id)?;
            channel.metadata.get("bus")
        };
        let buses: BTreeSet<&String> = self.replaced.iter().filter_map(topic).collect();
        for bus in buses {
            output::note(&format!("{bus}: its decoded channels are replaced"));
        }
    }

    /// True for a sentence that an earlier decoding of a bus has left in the log.
    fn is_old(&self, from: (usize, u16), data: &[u8]) -> bool {
        let name = || message::decode_log(data).map(|(name, _)| name);
        self.logs.contains(&from)
            && name().is_some_and(|name| {
                let bus = name.split_once('/').map(|(bus, _)| bus);
                self.streams.iter().flatten().any(|stream| Some(stream.bus()) == bus)
            })
    }

    fn decode(
        &mut self,
        from: (usize, u16),
        time: Timestamp,
        data: &[u8],
        out: &mut SegmentWriter,
    ) -> io::Result<()> {
        let bus = self.carriers.bus(from.0, from.1);
        let Some(stream) = bus.and_then(|bus| self.streams.get_mut(bus)?.as_mut()) else {
            return Ok(());
        };
        self.frames.clear();
        if !self.carriers.frames(from, time, data, &mut self.frames) {
            self.damaged += 1;
        }
        for frame in &self.frames {
            if let Err(why) = stream.take(frame, out) {
                tell(stream, frame.time, why, out)?;
            }
        }
        Ok(())
    }
}

impl Copy for Decode<'_> {
    fn entry(&mut self, entry: Stamped<Entry>, out: &mut SegmentWriter) -> io::Result<()> {
        let Stamped { time, value } = entry;
        let Entry::Message { segment, channel, data } = value else { return Ok(()) };
        let from = (segment, channel);
        self.last = time;
        if self.replaced.contains(&from) || self.is_old(from, &data) {
            return Ok(());
        }
        self.channels.copy(self.recording, from, time, &data, out)?;
        self.decode(from, time, &data, out)
    }

    fn end(&mut self, out: &mut SegmentWriter, summary: &mut Facts) -> io::Result<()> {
        for stream in self.streams.iter_mut().flatten() {
            if let Err(why) = stream.finish(out) {
                tell(stream, self.last, why, out)?;
            }
            stream.sum_up(summary);
        }
        Ok(())
    }
}

/// Says why a bus is not decoded any more, here and in the file.
fn tell(stream: &Stream, time: Timestamp, why: String, out: &mut SegmentWriter) -> io::Result<()> {
    output::warning(&why);
    let notice = Notice { level: Level::Error, text: why };
    out.add_notice(time, &format!("{}/decode", stream.bus()), &notice)
}

fn report(streams: &[Option<Stream>], as_json: bool) -> Result<()> {
    let mut out = output::stdout();
    let streams = streams.iter().flatten();
    if as_json {
        let buses: Vec<_> = streams.map(definitions::as_json).collect();
        writeln!(out, "{}", printable_json(&json!({ "buses": buses }).to_string()))?;
    } else {
        for stream in streams {
            writeln!(out, "{}", printable(&definitions::sentence(stream)))?;
        }
    }
    out.flush()?;
    Ok(())
}
