//! Tables of signals: frames find their message, and its rows the writer of the format.

use anyhow::Result;

use super::decoders::Decoders;
use super::input::{self, Source};
use super::report::{Counts, report};
use super::routes::Routes;
use super::selection::Selection;
use super::target::Target;
use crate::cli::export::{ExportArgs, Shape};
use crate::commands::Ended;
use crate::commands::interrupt::Interrupt;
use crate::export::TableWriter;
use crate::export::catalogue::Catalogue;
use crate::frame::{Frame, Timestamp};
use crate::recording::reader::{Entry, Recording};

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let decoders = Decoders::load(&args.decode)?;
    let source = Source::open(&args.files)?;
    if args.shape != Shape::Frames {
        decoders.check(&source)?;
    }
    let mut target = Target::create(args)?;
    if args.shape == Shape::Frames {
        return frames(args, selection, interrupt, &source, target);
    }
    let mut routes = Routes::new(&decoders, selection);
    if args.shape == Shape::Wide {
        // Which columns there are is known at the end only, so there is a first round for that.
        read(&source, &mut routes, selection, interrupt, &mut Nothing, true)?;
        routes.restart();
    }
    let mut writer = target.writer(args, &routes.catalogue)?;
    let ended = read(&source, &mut routes, selection, interrupt, &mut *writer, false)?;
    writer.finish(&routes.catalogue)?;
    let (files, notes) = (writer.files(), writer.notes());
    drop(writer);
    interrupt.check()?;
    target.finish()?;
    routes.counts.tables = routes.catalogue.len();
    report(args, &routes.counts, files, &notes);
    let lost = decoders.incomplete || routes.counts.is_lossy() || ended == Ended::WithLoss;
    Ok(if lost { Ended::WithLoss } else { Ended::Well })
}

/// Takes rows and forgets them.
struct Nothing;

impl TableWriter for Nothing {
    fn write(&mut self, _: &Catalogue, _: u32, _: Timestamp, _: &[u8]) -> std::io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, _: &Catalogue) -> std::io::Result<()> {
        Ok(())
    }

    fn files(&self) -> u64 {
        0
    }
}

/// Reads everything once.
fn read(
    source: &Source,
    routes: &mut Routes<'_>,
    selection: &Selection,
    interrupt: &Interrupt,
    writer: &mut dyn TableWriter,
    quiet: bool,
) -> Result<Ended> {
    let recording = match source {
        Source::Recording(recording) => recording,
        Source::Logs(logs) => {
            return input::each_of_logs(logs, selection, interrupt, quiet, |bus, frame| {
                let bus = routes.bus(bus);
                routes.frame(bus, frame.time, &frame.value, writer)
            });
        }
    };
    let (origin, _) = recording.span().unwrap_or_default();
    let range = selection.range(origin)?;
    let buses: Vec<usize> = recording.buses.iter().map(|name| routes.bus(name)).collect();
    let decodes = routes.decodes();
    let wanted = |topic: &str| wants(recording, selection, decodes, topic);
    let visit = |entry: &crate::frame::Stamped<Entry>| match &entry.value {
        Entry::Frame(bus, frame) => {
            let bus = buses.get(*bus).copied().unwrap_or(usize::MAX);
            routes.frame(bus, entry.time, frame, writer)
        }
        Entry::Message { segment, channel, data } => {
            routes.message(recording, (*segment, *channel), entry.time, data, writer)
        }
    };
    input::each(recording, range, interrupt, quiet, wanted, visit)
}

/// True for topics that are read: raw ones to decode, or else decoded ones.
fn wants(recording: &Recording, selection: &Selection, decodes: bool, topic: &str) -> bool {
    let Some((bus, name)) = topic.strip_prefix('/').and_then(|topic| topic.rsplit_once('/')) else {
        return false;
    };
    let known = recording.buses.iter().any(|known| known == bus) && selection.bus(bus);
    let ours = matches!(name, "raw" | "gaps" | "stats" | "frames");
    known && if decodes { matches!(name, "raw" | "gaps") } else { !ours && selection.message(name) }
}

/// Exports raw frames.
fn frames(
    args: &ExportArgs,
    selection: &Selection,
    interrupt: &Interrupt,
    source: &Source,
    mut target: Target,
) -> Result<Ended> {
    let mut writer = target.frames(args)?;
    let mut counts = Counts { tables: 1, ..Counts::default() };
    let mut take = |bus: &str, time: Timestamp, frame: &Frame| -> Result<()> {
        if selection.bus(bus) && writer.write(bus, time, frame)? {
            counts.read += 1;
            counts.rows += 1;
        }
        Ok(())
    };
    let ended = match source {
        Source::Logs(logs) => {
            input::each_of_logs(logs, selection, interrupt, false, |bus, frame| {
                take(bus, frame.time, &frame.value)
            })?
        }
        Source::Recording(recording) => {
            let (origin, _) = recording.span().unwrap_or_default();
            let range = selection.range(origin)?;
            let wanted = |topic: &str| topic.ends_with("/raw");
            input::each(recording, range, interrupt, false, wanted, |entry| match &entry.value {
                Entry::Frame(bus, frame) => {
                    let bus = recording.buses.get(*bus).map_or("?", String::as_str);
                    take(bus, entry.time, frame)
                }
                Entry::Message { .. } => Ok(()),
            })?
        }
    };
    interrupt.check()?;
    writer.finish()?;
    let files = writer.files();
    drop(writer);
    target.finish()?;
    report(args, &counts, files, &[]);
    Ok(if counts.is_lossy() { Ended::WithLoss } else { ended })
}
