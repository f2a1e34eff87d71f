//! `bustape import`: logs of other tools become a recording.

mod books;
mod names;
mod raw;
mod report;

use std::cell::Cell;
use std::io;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use anyhow::Result;

use super::export::input::Progress;
use super::interrupt::Interrupt;
use super::{Ended, UsageError, output};
use crate::cli::import::ImportArgs;
use crate::frame::error::CanError;
use crate::frame::{Frame, Timestamp};
use crate::import::expand::Compression;
use crate::import::format::{self, Format};
use crate::import::merge::{Merge, MergeError};
use crate::import::{ImportError, LogFrame, LogReader, Settings, raw::Line};
use crate::record::{Segment, Segments, Split, Target};
use crate::recording::definition::Facts;
use crate::recording::disk::RealDisk;
use crate::recording::writer::{Head, WriterOptions};
use crate::text::parse_moment;
use books::Books;
use report::Report;

/// A chunk that holds less is not cut for the sake of frames that are out of order.
const LEAST_CUT: usize = 256;

/// A log that is being read.
pub struct Log {
    path: PathBuf,
    format: Format,
    compression: Option<Compression>,
    size: Option<u64>,
    taken: Rc<Cell<u64>>,
}

impl AsRef<Path> for Log {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

/// Runs the command.
pub fn run(args: &ImportArgs) -> Result<Ended> {
    let start = match &args.start {
        Some(text) => parse_moment(text, Timestamp(0)).map_err(UsageError)?,
        None => Timestamp(0),
    };
    let settings = Settings { zone: zone(&args.zone)?, line: None };
    let lines = raw::lines(args)?;
    let (mut logs, mut readers) = (Vec::new(), Vec::new());
    for (number, path) in args.logs.iter().enumerate() {
        let (log, reader) = open(path, args.format, &settings, lines.get(number))?;
        logs.push(log);
        readers.push(reader);
    }
    let names = names::Names::of(if lines.is_empty() { &args.buses } else { &[] })?;
    let merge = Merge::new(readers, start, names.naming());
    let interrupt = Interrupt::watch()?;
    let report = import(args, &logs, merge, &interrupt)?;
    for name in names.unused() {
        output::warning(&format!("--bus {name}=...: no log has a bus {name}"));
    }
    for (from, to) in names.changed() {
        output::note(&format!(
            "bus \"{}\" is named {to}, since a recording cannot have its name, or another bus has it",
            from.escape_debug()
        ));
    }
    report.say(args.json)
}

/// Opens a log as a person named it.
pub fn open(
    path: &Path,
    format: Option<Format>,
    settings: &Settings,
    line: Option<&Line>,
) -> Result<(Log, Box<dyn LogReader>)> {
    let settings = Settings { line: line.cloned(), ..settings.clone() };
    let opened = format::open(path, format, &settings);
    let opened = opened.map_err(|error| cannot_import(path, &error))?;
    let format::Opened { reader, format, compression, size, taken } = opened;
    Ok((Log { path: path.to_owned(), format, compression, size, taken }, reader))
}

/// The sentence for a log that cannot be read.
pub fn cannot_import(path: &Path, error: &ImportError) -> anyhow::Error {
    match error {
        ImportError::Read(cause) => anyhow::anyhow!("cannot read {}: {cause}", path.display()),
        ImportError::Format(why) => anyhow::anyhow!("cannot import {}: {why}", path.display()),
    }
}

/// A time zone by its name.
pub fn zone(name: &str) -> Result<jiff::tz::TimeZone> {
    jiff::tz::TimeZone::get(name).map_err(|_| {
        let text = format!("--zone {name}: no such time zone; name it like Europe/Berlin or UTC");
        UsageError(text).into()
    })
}

fn import(
    args: &ImportArgs,
    logs: &[Log],
    mut merge: Merge,
    interrupt: &Interrupt,
) -> Result<Report> {
    let options = WriterOptions {
        layout: args.layout,
        compression: args.compression,
        ..WriterOptions::default()
    };
    let target = Target::File(args.output.clone());
    let mut segments = Segments::new(Arc::new(RealDisk), target, Split::default(), options)?;
    let mut frames = Vec::new();
    // The head tells when the recording begins.
    merge.next(&mut frames).map_err(|error| failed(logs, error))?;
    let first = frames.first().map(|frame| frame.frame.time).unwrap_or_default();
    let mut out = segments.open(first, &head(logs, first), "")?;
    let mut books = Books::default();
    let copied = copy(logs, &mut merge, frames, &mut out, &mut books, interrupt);
    let finished = copied.and_then(|()| {
        let written = out.writer.finish(books.summary()).and_then(|()| out.writer.sync());
        written.map_err(|error| cannot_write(&args.output, &error))
    });
    if let Err(error) = finished {
        // The logs are still there; half of a recording is of no use to anybody.
        segments.discard(out);
        return Err(error);
    }
    segments.name(out)?;
    Ok(Report::new(&args.output, logs, &merge, books))
}

fn copy(
    logs: &[Log],
    merge: &mut Merge,
    mut frames: Vec<LogFrame>,
    out: &mut Segment,
    books: &mut Books,
    interrupt: &Interrupt,
) -> Result<()> {
    let sizes = || logs.iter().filter_map(|log| log.size);
    let mut progress = Progress::new(sizes().sum());
    let cannot_write = |error: io::Error| cannot_write(&out.path.clone(), &error);
    let mut latest = Timestamp(0);
    let mut since_cut = 0;
    while !frames.is_empty() {
        interrupt.check()?;
        for frame in &frames {
            let bus = usize::from(frame.bus);
            while books.buses() <= bus {
                let name = &merge.buses()[books.buses()];
                let (name, facts) = books.add_bus(name, &frame.frame.value);
                out.writer.add_bus(&name, facts).map_err(cannot_write)?;
            }
            // Chunks are found by their times, so each should span as little as it can.
            if frame.frame.time < latest && since_cut >= LEAST_CUT {
                out.writer.cut().map_err(cannot_write)?;
                (since_cut, latest) = (0, Timestamp(0));
            }
            latest = latest.max(frame.frame.time);
            since_cut += 1;
            out.writer.add(bus, &frame.frame).map_err(cannot_write)?;
            if let Frame::Can(can) = &frame.frame.value
                && let Some(error) = CanError::of(can)
            {
                out.writer.add_error(bus, frame.frame.time, &error).map_err(cannot_write)?;
            }
            books.count(bus, &frame.frame.value);
            if out.writer.is_full() {
                out.writer.cut().map_err(cannot_write)?;
                since_cut = 0;
            }
        }
        let taken: u64 =
            logs.iter().filter(|log| log.size.is_some()).map(|log| log.taken.get()).sum();
        progress.show(sizes().sum::<u64>().saturating_sub(taken));
        merge.next(&mut frames).map_err(|error| failed(logs, error))?;
    }
    progress.clear();
    Ok(())
}

fn cannot_write(path: &Path, error: &io::Error) -> anyhow::Error {
    anyhow::anyhow!("cannot write {}: {error}", path.display())
}

/// The sentence for logs that cannot be merged any further.
pub fn failed(logs: &[impl AsRef<Path>], error: MergeError) -> anyhow::Error {
    match error {
        MergeError::Log { number, error } => match logs.get(number) {
            Some(log) => cannot_import(log.as_ref(), &error),
            None => error.into(),
        },
        MergeError::Name(why) => UsageError(why).into(),
    }
}

/// What stands at the head of the recording: that it was imported, and from what.
fn head(logs: &[Log], first: Timestamp) -> Head {
    let mut recording = super::record::about::about();
    // What describes the machine that recorded says nothing about that of the logs.
    for name in ["boot_id", "host", "kernel"] {
        recording.remove(name);
    }
    recording.insert("session".to_owned(), "1".to_owned());
    recording.insert("imported".to_owned(), "true".to_owned());
    let mut import = Facts::new();
    for (number, log) in (1..).zip(logs) {
        let mut put = |key: &str, value: String| import.insert(format!("{number}.{key}"), value);
        put("file", log.path.file_name().unwrap_or_default().to_string_lossy().into_owned());
        put("format", log.format.name().to_owned());
        if let Some(size) = log.size {
            put("bytes", size.to_string());
        }
        if let Some(kind) = log.compression {
            put("compression", format!("{kind:?}").to_lowercase());
        }
    }
    let clock = Facts::from([("log_time_ns".to_owned(), first.nanos().to_string())]);
    let more = vec![("bustape.import".to_owned(), import)];
    Head { recording, clock, more, time: first, ..Head::default() }
}
