//! What is said when an import has ended.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::{Value, json};

use super::books::Books;
use super::{Log, output};
use crate::commands::Ended;
use crate::import::Skipped;
use crate::import::merge::{Merge, WINDOW};
use crate::text::{grouped, printable_json, size};

/// How an import went.
pub struct Report {
    output: PathBuf,
    books: Books,
    logs: Vec<OfLog>,
    disordered: u64,
}

/// How it went with one log.
struct OfLog {
    path: PathBuf,
    format: &'static str,
    frames: u64,
    skipped: Skipped,
    notes: Vec<String>,
    relative: bool,
}

impl Report {
    /// Gathers what there is to say.
    pub fn new(output: &Path, logs: &[Log], merge: &Merge, books: Books) -> Self {
        let of_log = |(log, source): (&Log, &crate::import::merge::Source)| OfLog {
            path: log.path.clone(),
            format: log.format.name(),
            frames: source.read(),
            skipped: source.skipped().clone(),
            notes: source.notes().to_vec(),
            relative: source.is_relative(),
        };
        Self {
            output: output.to_owned(),
            books,
            logs: logs.iter().zip(merge.sources()).map(of_log).collect(),
            disordered: merge.disordered(),
        }
    }

    /// Says it, and how the command ended.
    pub fn say(&self, json: bool) -> Result<Ended> {
        let read: u64 = self.logs.iter().map(|log| log.frames).sum();
        let skipped: u64 = self.logs.iter().map(|log| log.skipped.count).sum();
        for log in &self.logs {
            log.say();
        }
        if self.disordered > 0 {
            output::note(&format!(
                "{} frames stood more than {} frames too late in their log; readers of the \
                 recording sort them",
                grouped(self.disordered),
                grouped(WINDOW as u64),
            ));
        }
        if json {
            let text = printable_json(&self.json(skipped).to_string());
            output::result(&format!("{text}\n"))?;
        } else {
            let written = std::fs::metadata(&self.output).map_or(0, |about| about.len());
            output::note(&format!(
                "{}: {} frames in = {} written, {} lines or objects skipped; {} bus(es), {}",
                self.output.display(),
                grouped(read),
                grouped(self.books.frames),
                grouped(skipped),
                self.books.buses(),
                size(written),
            ));
        }
        let complete = skipped == 0 && read == self.books.frames;
        Ok(if complete { Ended::Well } else { Ended::WithLoss })
    }

    fn json(&self, skipped: u64) -> Value {
        let buses = self.books.list().map(|bus| {
            let totals = bus.tally.totals();
            let unit = bus.facts.unit.unwrap_or(crate::frame::Unit::Frames).name();
            json!({ "name": bus.name, "unit": unit, "written": totals.written, "dropped": totals.lost() })
        });
        json!({
            "output": self.output.display().to_string(),
            "frames": self.books.frames,
            "error_frames": self.books.error_frames,
            "remote_frames": self.books.remote_frames,
            "gaps": self.books.gaps,
            "skipped": skipped,
            "out_of_order": self.disordered,
            "buses": buses.collect::<Vec<_>>(),
            "logs": self.logs.iter().map(OfLog::json).collect::<Vec<_>>(),
        })
    }
}

impl OfLog {
    fn say(&self) {
        let name = self.path.display();
        for (place, reason) in &self.skipped.first {
            output::warning(&format!("{name}: {place}: {reason}"));
        }
        let more = self.skipped.count.saturating_sub(self.skipped.first.len() as u64);
        if more > 0 {
            output::warning(&format!("{name}: {} more like these", grouped(more)));
        }
        for sentence in &self.notes {
            output::note(&format!("{name}: {sentence}"));
        }
        if self.relative {
            output::note(&format!(
                "{name}: its times are no dates but count from its own start, which --start gives"
            ));
        }
    }

    fn json(&self) -> Value {
        let first = self.skipped.first.iter();
        let first = first.map(|(place, reason)| json!({ "place": place, "reason": reason }));
        json!({
            "file": self.path.display().to_string(),
            "format": self.format,
            "frames": self.frames,
            "skipped": self.skipped.count,
            "first_skipped": first.collect::<Vec<_>>(),
            "relative_times": self.relative,
            "notes": self.notes,
        })
    }
}
