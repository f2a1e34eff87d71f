//! `bustape convert`: the same recording, written anew.

use std::io;

use anyhow::Result;

use super::Ended;
use super::rewrite::{self, Channels, Copy};
use crate::cli::ConvertArgs;
use crate::frame::Stamped;
use crate::recording::definition::Facts;
use crate::recording::reader::{Entry, Recording};
use crate::recording::writer::{SegmentWriter, WriterOptions};

/// Runs the command.
pub fn run(args: &ConvertArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    let options = WriterOptions {
        layout: args.layout.unwrap_or_else(|| rewrite::layout_of(&recording)),
        compression: args.compression,
        ..WriterOptions::default()
    };
    let entries = recording.entries(Recording::ALL, |_| true);
    let mut convert = Convert { recording: &recording, channels: Channels::default() };
    let head = rewrite::head(&recording)?;
    rewrite::write(&recording, entries, &args.output, options, &head, &mut convert)
}

/// Frames are written in the layout of the new file, everything else as it is.
struct Convert<'a> {
    recording: &'a Recording,
    channels: Channels,
}

impl Copy for Convert<'_> {
    fn entry(&mut self, entry: Stamped<Entry>, out: &mut SegmentWriter) -> io::Result<()> {
        let Stamped { time, value } = entry;
        match value {
            Entry::Frame(bus, frame) => out.add(bus, &Stamped { time, value: frame }),
            Entry::Message { segment, channel, data } => {
                self.channels.copy(self.recording, (segment, channel), time, &data, out)
            }
        }
    }

    fn end(&mut self, _: &mut SegmentWriter, _: &mut Facts) -> io::Result<()> {
        Ok(())
    }
}
