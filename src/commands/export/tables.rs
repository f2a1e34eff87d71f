//! Tables of signals: frames find their message, and its rows the writer of the format.

use std::sync::Arc;

use anyhow::{Result, bail};
use serde_json::json;

use super::decoders::Decoders;
use super::input::{self, Source};
use super::selection::Selection;
use super::target::Target;
use crate::cli::export::{ExportArgs, Shape};
use crate::commands::interrupt::Interrupt;
use crate::commands::{Ended, UsageError, output};
use crate::export::TableWriter;
use crate::export::catalogue::Catalogue;
use crate::frame::{CanFlags, Frame, Timestamp};
use crate::recording::reader::Entry;
use crate::text::grouped;

/// Runs the export.
pub fn run(args: &ExportArgs, selection: &Selection, interrupt: &Interrupt) -> Result<Ended> {
    let decoders = Decoders::load(&args.decode)?;
    let source = Source::open(&args.files)?;
    let target = Target::create(args)?;
    let wanted = selection.clone();
    let wanted = Box::new(move |signal: &str| wanted.signal(signal));
    let catalogue = Catalogue::new(decoders.definitions.clone(), wanted);
    let writer = target.writer(args)?;
    let mut export = Export {
        catalogue,
        decoders: &decoders,
        selection,
        writer,
        buses: Vec::new(),
        counts: Counts::default(),
    };
    let read = match &source {
        Source::Recording(recording) => export.recording(recording, interrupt)?,
        Source::Logs(logs) => input::each_of_logs(logs, selection, interrupt, |bus, frame| {
            let bus = export.bus(bus);
            export.frame(bus, frame.time, &frame.value)
        })?,
    };
    export.writer.finish(&export.catalogue)?;
    interrupt.check()?;
    let (counts, files) = (export.counts, export.writer.files());
    let tables = export.catalogue.len();
    drop(export);
    target.finish()?;
    report(args, &counts, tables, files);
    let lost = decoders.incomplete || counts.rows == 0 || read == Ended::WithLoss;
    Ok(if lost { Ended::WithLoss } else { Ended::Well })
}

/// What happened to the frames.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    read: u64,
    rows: u64,
    unknown: u64,
    /// Remote and error frames, serial bytes, frames of buses without a protocol.
    other: u64,
}

struct Export<'a> {
    catalogue: Catalogue,
    decoders: &'a Decoders,
    selection: &'a Selection,
    writer: Box<dyn TableWriter>,
    buses: Vec<Bus>,
    counts: Counts,
}

/// A bus, and the tables of its messages.
struct Bus {
    name: Arc<str>,
    definition: Option<usize>,
    /// By index of the message.
    tables: Vec<u32>,
}

/// A message without a table yet.
const UNSEEN: u32 = u32::MAX;
/// A message that is not wanted.
const UNWANTED: u32 = u32::MAX - 1;

impl Export<'_> {
    fn recording(
        &mut self,
        recording: &crate::recording::reader::Recording,
        interrupt: &Interrupt,
    ) -> Result<Ended> {
        for bus in self.decoders.buses() {
            if !recording.buses.iter().any(|name| name == bus) {
                let buses = recording.buses.join(", ");
                bail!(UsageError(format!(
                    "--decode {bus}=...: there is no bus {bus}, only {buses}"
                )));
            }
        }
        let (origin, _) = recording.span().unwrap_or_default();
        let range = self.selection.range(origin)?;
        let selection = self.selection;
        let wanted = |topic: &str| {
            let bus = topic.strip_prefix('/').and_then(|topic| topic.strip_suffix("/raw"));
            bus.is_some_and(|bus| selection.bus(bus))
        };
        let buses: Vec<usize> = recording.buses.iter().map(|name| self.bus(name)).collect();
        input::each(recording, range, interrupt, wanted, |entry| match &entry.value {
            Entry::Frame(bus, frame) => {
                let bus = buses.get(*bus).copied().unwrap_or(usize::MAX);
                self.frame(bus, entry.time, frame)
            }
            Entry::Message { .. } => Ok(()),
        })
    }

    /// The index of a bus by its name.
    fn bus(&mut self, name: &str) -> usize {
        if let Some(index) = self.buses.iter().position(|bus| &*bus.name == name) {
            return index;
        }
        let definition = self.decoders.of(name).filter(|_| self.selection.bus(name));
        let definitions = self.catalogue.definitions();
        let messages = definition.and_then(|index| definitions.get(index));
        let messages = messages.map_or(0, |d| d.decoder.database().messages.len());
        self.buses.push(Bus { name: name.into(), definition, tables: vec![UNSEEN; messages] });
        self.buses.len() - 1
    }

    fn frame(&mut self, bus: usize, time: Timestamp, frame: &Frame) -> Result<()> {
        let can = match frame {
            Frame::Can(can) => can,
            Frame::Serial(_) => {
                self.counts.read += 1;
                self.counts.other += 1;
                return Ok(());
            }
            Frame::Gap(_) | Frame::Notice(_) => return Ok(()),
        };
        self.counts.read += 1;
        let Some(bus) = self.buses.get_mut(bus) else { return Ok(()) };
        let definition = bus.definition.and_then(|index| self.catalogue.definitions().get(index));
        let special = can.flags.has(CanFlags::REMOTE) || can.flags.has(CanFlags::ERROR);
        let Some(definition) = definition.filter(|_| !special) else {
            self.counts.other += 1;
            return Ok(());
        };
        let Some(found) = definition.decoder.find(can) else {
            self.counts.unknown += 1;
            return Ok(());
        };
        let message = found.index;
        let Some(table) = bus.tables.get_mut(message) else { return Ok(()) };
        if *table == UNSEEN {
            let wanted = self.selection.message(&found.message.name);
            let definition = bus.definition.filter(|_| wanted);
            let number = definition.and_then(|d| self.catalogue.add(&bus.name, d, message));
            *table = number.unwrap_or(UNWANTED);
        }
        if *table != UNWANTED {
            self.writer.write(&self.catalogue, *table, time, can.data())?;
            self.counts.rows += 1;
        }
        Ok(())
    }
}

fn report(args: &ExportArgs, counts: &Counts, tables: usize, files: u64) {
    let Counts { read, rows, unknown, other } = *counts;
    if args.json {
        let totals = json!({
            "frames": read, "rows": rows, "unknown": unknown, "not_decoded": other,
            "tables": tables, "files": files,
        });
        if args.output.as_os_str() == "-" {
            eprintln!("{totals}");
        } else {
            println!("{totals}");
        }
    } else {
        let mut text = format!(
            "{} frames read: {} rows of {} messages in {} files",
            grouped(read),
            grouped(rows),
            grouped(tables as u64),
            grouped(files),
        );
        if unknown > 0 {
            text.push_str(&format!("; {} frames of unknown messages", grouped(unknown)));
        }
        if other > 0 {
            let what = "remote, error or serial, or of a bus without --decode";
            text.push_str(&format!("; {} not decoded ({what})", grouped(other)));
        }
        output::note(&text);
    }
    if rows == 0 && args.shape != Shape::Frames {
        output::warning("nothing was exported: no frame was one of the wanted messages");
    }
}
