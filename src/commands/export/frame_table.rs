//! Raw frames as one table.

use anyhow::Result;

use super::frames::filter::Filter;
use super::input::{self, Source};
use super::report::{Counts, report};
use super::selection::Selection;
use super::target::Target;
use crate::cli::export::ExportArgs;
use crate::commands::Ended;
use crate::commands::interrupt::Interrupt;
use crate::export::shape::frames::Frames;
use crate::frame::{Frame, Timestamp};
use crate::recording::reader::Entry;

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let filter = Filter::of(&args.filters, selection)?;
    let source = Source::open(&args.files)?;
    let mut target = Target::create(args)?;
    let writer = target.frames(args)?;
    let mut table = Table { writer, filter, buses: Vec::new(), counts: Counts::default() };
    let ended = match &source {
        Source::Logs(logs) => {
            input::each_of_logs(logs, selection, 0, interrupt, false, |bus, frame, _| {
                table.take(bus, frame.time, &frame.value)
            })?
        }
        Source::Recording(recording) => {
            let (origin, _) = recording.span().unwrap_or_default();
            let range = selection.range(origin)?;
            let wanted = |topic: &str| topic.ends_with("/raw");
            input::each(recording, range, interrupt, false, wanted, |entry| match &entry.value {
                Entry::Frame(bus, frame) => {
                    let bus = recording.buses.get(*bus).map_or("?", String::as_str);
                    table.take(bus, entry.time, frame)
                }
                Entry::Message { .. } => Ok(()),
            })?
        }
    };
    table.filter.check_all_met()?;
    let Table { mut writer, mut counts, .. } = table;
    writer.finish()?;
    let files = writer.files();
    drop(writer);
    target.finish()?;
    counts.tables = 1;
    report(args, &counts, files, &[])?;
    Ok(if counts.is_lossy() { Ended::WithLoss } else { ended })
}

struct Table {
    writer: Frames,
    filter: Filter,
    /// The buses seen, and which of the wanted ones each is.
    buses: Vec<(String, Option<usize>)>,
    counts: Counts,
}

impl Table {
    fn take(&mut self, bus: &str, time: Timestamp, frame: &Frame) -> Result<()> {
        let index = match self.buses.iter().find(|(name, _)| name == bus) {
            Some((_, index)) => *index,
            None => self.meet(bus),
        };
        match frame {
            Frame::Can(_) => self.counts.frames += 1,
            Frame::Serial(_) => self.counts.reads += 1,
            Frame::Gap(_) | Frame::Notice(_) => return Ok(()),
        }
        if index.is_some_and(|index| self.filter.passes(index, frame)) {
            self.writer.write(bus, time, frame)?;
            self.counts.rows += 1;
        }
        Ok(())
    }

    fn meet(&mut self, bus: &str) -> Option<usize> {
        let wanted = self.buses.iter().flat_map(|(_, index)| index).count();
        let index = self.filter.wants(bus).then_some(wanted);
        self.buses.push((bus.to_owned(), index));
        index
    }
}
