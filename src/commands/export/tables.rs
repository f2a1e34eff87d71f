//! Tables of signals: frames find their message, and its rows the writer of the format.

use anyhow::Result;

use super::decoders::Decoders;
use super::input::{self, Source};
use super::report::report;
use super::routes::Routes;
use super::selection::Selection;
use super::target::Target;
use crate::cli::export::{ExportArgs, Shape};
use crate::commands::Ended;
use crate::commands::interrupt::Interrupt;
use crate::export::TableWriter;
use crate::export::ordered::Ordered;
use crate::export::shape::survey::Survey;
use crate::frame::Stamped;
use crate::recording::reader::{Entry, Recording};

/// What is selected by time is decoded with what stands a minute before and behind it: an answer
/// means something by its question, and a message of several frames ends after it has begun.
const MARGIN: u64 = 60_000_000_000;

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let decoders = Decoders::load(&args.decode)?;
    let source = Source::open(&args.files)?;
    decoders.check(&source)?;
    let mut target = Target::create(args)?;
    let mut routes = Routes::new(&decoders, selection);
    let margin = if decoders.look_back() { MARGIN } else { 0 };
    let job = Job { source: &source, selection, margin, interrupt };
    let mut survey = Survey::default();
    if args.shape == Shape::Wide {
        // Which columns there are is known at the end only, so there is a first round for that.
        job.read(&mut routes, &mut survey, true)?;
        routes.restart();
    }
    let mut writer = target.writer(args, &routes.catalogue, survey.lengths())?;
    if decoders.look_back() {
        writer = Box::new(Ordered::new(writer));
    }
    let ended = job.read(&mut routes, &mut *writer, false)?;
    writer.finish(&routes.catalogue)?;
    let (files, notes) = (writer.files(), writer.notes());
    drop(writer);
    interrupt.check()?;
    target.finish()?;
    routes.counts.tables = routes.catalogue.messages();
    report(args, &routes.counts, files, &notes)?;
    let lost = decoders.incomplete || routes.counts.is_lossy() || ended == Ended::WithLoss;
    Ok(if lost { Ended::WithLoss } else { Ended::Well })
}

/// What is read.
struct Job<'a> {
    source: &'a Source,
    selection: &'a Selection,
    /// So many nanoseconds before and behind what is selected are read, too.
    margin: u64,
    interrupt: &'a Interrupt,
}

impl Job<'_> {
    /// Reads everything once.
    fn read(
        &self,
        routes: &mut Routes<'_>,
        writer: &mut dyn TableWriter,
        quiet: bool,
    ) -> Result<Ended> {
        let Self { source, selection, margin, interrupt } = *self;
        let ended = match source {
            Source::Recording(recording) => {
                let (origin, _) = recording.span().unwrap_or_default();
                routes.range = selection.range(origin)?;
                let range = input::widened(&routes.range, margin);
                let buses = recording.buses.iter().map(|name| routes.bus(name));
                let buses: Vec<usize> = buses.collect();
                let decodes = routes.decodes();
                let wanted = |topic: &str| wants(recording, selection, decodes, topic);
                input::each(recording, range, interrupt, quiet, wanted, |entry| match entry.value {
                    Entry::Frame(bus, value) => {
                        let bus = buses.get(bus).copied().unwrap_or(usize::MAX);
                        routes.frame(bus, &Stamped { time: entry.time, value }, writer)
                    }
                    Entry::Message { segment, channel, data } => {
                        let place = (segment, channel);
                        routes.message(recording, place, entry.time, &data, writer)
                    }
                })
            }
            Source::Logs(logs) => input::each_of_logs(
                logs,
                selection,
                margin,
                interrupt,
                quiet,
                |bus, frame, range| {
                    if routes.range != *range {
                        routes.range = range.clone();
                    }
                    let bus = routes.bus(bus);
                    routes.frame(bus, frame, writer)
                },
            ),
        }?;
        routes.finish(writer)?;
        Ok(ended)
    }
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
