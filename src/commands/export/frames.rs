//! Frames in the formats of other tools, from a recording or straight from logs.

pub(super) mod filter;
mod sink;

use std::collections::BTreeMap;

use anyhow::Result;
use serde_json::json;

use super::input::{self, Progress, Source};
use super::report::{print_totals, selected};
use super::selection::Selection;
use crate::cli::export::ExportArgs;
use crate::commands::interrupt::Interrupt;
use crate::commands::{Ended, output};
use crate::export::frames::kept::EARLIER;
use crate::export::{BusHead, FrameWriter};
use crate::frame::{Frame, Stamped, Timestamp};
use crate::import::format;
use crate::import::merge::Merge;
use crate::import::{LogFrame, Settings};
use crate::recording::reader::{Entry, Recording};
use crate::text::grouped;
use filter::Filter;
use sink::Sink;

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let filter = Filter::of(&args.filters, selection)?;
    let source = Source::open(&args.files)?;
    let mut export = Export {
        filter,
        sink: Sink::new(args)?,
        writer: None,
        buses: Vec::new(),
        counts: Counts::default(),
    };
    let read = match &source {
        Source::Recording(recording) => export.recording(recording, selection, interrupt)?,
        Source::Logs(logs) => export.logs(logs, selection, interrupt)?,
    };
    let unkept = match export.writer.take() {
        Some(mut writer) => {
            writer.finish()?;
            writer.unkept().clone()
        }
        None => BTreeMap::new(),
    };
    interrupt.check()?;
    // Before the output has its name: what was asked for cannot be, so there is none.
    export.filter.check_all_met()?;
    export.sink.finish()?;
    report(args, &export.counts, &unkept, read)
}

/// What happened to the frames.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    /// Frames and reads of serial lines that were there.
    read: u64,
    /// Of these, those that were wanted.
    wanted: u64,
    /// Lines or objects of logs that could not be taken.
    skipped: u64,
}

struct Export {
    filter: Filter,
    sink: Sink,
    writer: Option<Box<dyn FrameWriter>>,
    /// For each bus of the source its index in the output, `None` if it is not wanted.
    buses: Vec<Option<u16>>,
    counts: Counts,
}

impl Export {
    fn recording(
        &mut self,
        recording: &Recording,
        selection: &Selection,
        interrupt: &Interrupt,
    ) -> Result<Ended> {
        let heads: Vec<BusHead> =
            recording.buses.iter().map(|name| head(recording, name)).collect();
        self.begin(&heads)?;
        let origin = recording.span().map_or(Timestamp(0), |span| span.0);
        let range = selection.range(origin)?;
        let wanted = |topic: &str| topic.ends_with("/raw") || topic.ends_with("/gaps");
        input::each(recording, range, interrupt, false, wanted, |entry| match &entry.value {
            Entry::Frame(bus, frame) => self.frame(*bus, entry.time, frame),
            Entry::Message { .. } => Ok(()),
        })
    }

    fn logs(
        &mut self,
        logs: &[std::path::PathBuf],
        selection: &Selection,
        interrupt: &Interrupt,
    ) -> Result<Ended> {
        let (mut readers, mut taken, mut total) = (Vec::new(), Vec::new(), 0);
        for path in logs {
            let opened = format::open(path, None, &Settings::default());
            let opened =
                opened.map_err(|error| super::super::import::cannot_import(path, &error))?;
            total += opened.size.unwrap_or(0);
            taken.push(opened.taken);
            readers.push(opened.reader);
        }
        let mut merge = Merge::new(readers, Timestamp(0), Box::new(|_, name| Ok(name.to_owned())));
        let mut progress = Progress::new(total);
        let (mut frames, mut range) = (Vec::new(), None);
        let failed = |error| super::super::import::failed(logs, error);
        while merge.next(&mut frames).map_err(failed)? {
            let range = match &range {
                Some(range) => range,
                None => range.insert(selection.range(frames[0].frame.time)?),
            };
            self.meet_buses(merge.buses())?;
            for LogFrame { bus, frame } in &frames {
                if range.contains(&frame.time) {
                    self.stamped(usize::from(*bus), frame)?;
                }
            }
            interrupt.check()?;
            progress.show(total.saturating_sub(taken.iter().map(|taken| taken.get()).sum()));
        }
        progress.clear();
        if self.writer.is_none() {
            self.begin(&[])?;
        }
        for (path, source) in logs.iter().zip(merge.sources()) {
            self.counts.skipped += source.skipped().count;
            input::say_skipped(path, source.skipped(), source.notes());
        }
        if merge.disordered() > 0 {
            let count = grouped(merge.disordered());
            output::note(&format!("{count} frames stand behind later ones, as in the log"));
        }
        Ok(if self.counts.skipped > 0 { Ended::WithLoss } else { Ended::Well })
    }

    /// Makes the buses known that were not yet.
    fn meet_buses(&mut self, names: &[String]) -> Result<()> {
        if self.buses.len() == names.len() && self.writer.is_some() {
            return Ok(());
        }
        let new = names.iter().skip(self.buses.len());
        let heads: Vec<BusHead> =
            new.map(|name| BusHead { name: name.clone(), bitrate: None }).collect();
        if self.writer.is_none() {
            return self.begin(&heads);
        }
        for head in &heads {
            let index = self.take_bus(head);
            if let (Some(writer), Some(_)) = (&mut self.writer, index) {
                writer.add_bus(head)?;
            }
            self.buses.push(index);
        }
        Ok(())
    }

    fn begin(&mut self, heads: &[BusHead]) -> Result<()> {
        let mut wanted = Vec::new();
        for head in heads {
            let index = self.take_bus(head);
            if index.is_some() {
                wanted.push(head.clone());
            }
            self.buses.push(index);
        }
        self.writer = Some(self.sink.writer(&wanted)?);
        Ok(())
    }

    /// The index in the output of one more bus.
    fn take_bus(&mut self, head: &BusHead) -> Option<u16> {
        let before = self.buses.iter().flatten().count();
        let index = u16::try_from(before).ok()?;
        self.filter.wants(&head.name).then_some(index)
    }

    fn frame(&mut self, bus: usize, time: Timestamp, frame: &Frame) -> Result<()> {
        // The writers take what the readers of logs give.
        self.stamped(bus, &Stamped { time, value: frame.clone() })
    }

    fn stamped(&mut self, bus: usize, frame: &Stamped<Frame>) -> Result<()> {
        let counted = u64::from(matches!(frame.value, Frame::Can(_) | Frame::Serial(_)));
        self.counts.read += counted;
        let Some(Some(index)) = self.buses.get(bus) else { return Ok(()) };
        if !self.filter.passes(usize::from(*index), &frame.value) {
            return Ok(());
        }
        self.counts.wanted += counted;
        if let Some(writer) = &mut self.writer {
            writer.write(*index, frame)?;
        }
        Ok(())
    }
}

/// What the recording knows of a bus.
fn head(recording: &Recording, name: &str) -> BusHead {
    let facts = format!("bustape.bus.{name}");
    let rate = recording.segments.iter().find_map(|segment| segment.fact(&facts, "bitrate"));
    BusHead { name: name.to_owned(), bitrate: rate.and_then(|text| text.parse().ok()) }
}

/// Says what came of it, and what the format could not keep.
fn report(
    args: &ExportArgs,
    counts: &Counts,
    unkept: &BTreeMap<&'static str, u64>,
    read: Ended,
) -> Result<Ended> {
    // Whole frames that the format has no place for.
    let lost =
        unkept.iter().filter(|(what, _)| what.ends_with("frames") && !what.contains(" are "));
    let lost: u64 = lost.map(|(_, count)| count).sum();
    let written = counts.wanted - lost.min(counts.wanted);
    for (what, count) in unkept {
        say_unkept(what, &grouped(*count));
    }
    if counts.wanted == 0 {
        output::warning(&format!("nothing was exported: {}", why_nothing(args, counts.read)));
    }
    if args.json {
        let format = clap::ValueEnum::to_possible_value(&args.format);
        let value = json!({
            "output": args.output.display().to_string(),
            "format": format.map(|value| value.get_name().to_owned()),
            "frames": counts.wanted,
            "written": written,
            "skipped": counts.skipped,
            "unkept": unkept,
        });
        print_totals(args, &value)?;
    } else {
        output::note(&format!(
            "{}: {} frames in = {} written, {} not expressible; {} lines or objects skipped",
            args.output.display(),
            grouped(counts.wanted),
            grouped(written),
            grouped(lost),
            grouped(counts.skipped),
        ));
    }
    let lost = lost + unkept.get(EARLIER).copied().unwrap_or(0) + counts.skipped;
    let complete = read == Ended::Well && lost == 0 && counts.wanted > 0;
    Ok(if complete { Ended::Well } else { Ended::WithLoss })
}

fn say_unkept(what: &str, count: &str) {
    if what.ends_with("frames") {
        output::warning(&format!("{count} {what} are not in the output: this format has none"));
    } else if what == EARLIER {
        output::warning(&format!(
            "{count} frames have the time of the first one, since they are earlier and this format \
             counts from that; import the log and export the recording, which sorts them"
        ));
    } else {
        output::note(&format!("this format does not keep {what} ({count} of the frames had them)"));
    }
}

/// What kept everything out of the output.
fn why_nothing(args: &ExportArgs, read: u64) -> String {
    match selected(args) {
        _ if read == 0 => "the input has no frames".to_owned(),
        options => format!("no frame of the input is selected by {options}"),
    }
}
