//! `bustape retime`: the times of a recording, put right by the clocks that it recorded.

mod clocks;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use serde_json::{Value, json};

use super::recover::Progress;
use super::{Ended, UsageError, output};
use crate::cli::RetimeArgs;
use crate::frame::Timestamp;
use crate::record::leftovers::{final_name, rewrite};
use crate::recording::definition::Facts;
use crate::recording::reader::Recording;
use crate::recording::rewrite::Report;
use crate::recording::shift::Shift;
use crate::text::{
    compact_utc, parse_compact_utc, printable, printable_json, rfc3339, signed_duration,
};
use clocks::{Boot, boots};

/// Nanoseconds.
const SECOND: i64 = 1_000_000_000;

/// Runs the command.
pub fn run(args: &RetimeArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    if args.output.is_some() && recording.segments.len() != 1 {
        bail!(UsageError(format!(
            "-o takes the new file of one FILE, and there are {}; use -d DIR",
            recording.segments.len()
        )));
    }
    let boots = boots(&recording);
    let mut moves = Vec::new();
    for boot in &boots {
        for known in &boot.segments {
            let file = recording.segments[known.index].path.clone();
            let shift = match args.offset {
                Some(offset) => offset,
                None => boot.shift(known, args.per_file, &file)?,
            };
            moves.push(Move { output: target(args, &file, shift), file, shift, report: None });
        }
    }
    moves.sort_by(|a, b| a.file.cmp(&b.file));
    if !args.dry_run {
        refuse_doubles(&moves)?;
        for one in &mut moves {
            one.carry_out(args)?;
        }
    }
    let mut out = output::stdout();
    if args.json {
        let boots: Vec<Value> = boots.iter().map(Boot::json).collect();
        let files: Vec<Value> = moves.iter().map(Move::json).collect();
        let text = json!({ "boots": boots, "files": files, "dry_run": args.dry_run }).to_string();
        writeln!(out, "{}", printable_json(&text))?;
    } else {
        boots.iter().try_for_each(|boot| boot.print(&mut out))?;
        moves.iter().try_for_each(|one| one.print(&mut out))?;
    }
    out.flush()?;
    let whole = moves.iter().all(|one| one.report.as_ref().is_none_or(Report::is_whole));
    Ok(if whole { Ended::Well } else { Ended::WithLoss })
}

/// A file whose times are moved.
struct Move {
    file: PathBuf,
    output: PathBuf,
    shift: i64,
    report: Option<Report>,
}

impl Move {
    fn carry_out(&mut self, args: &RetimeArgs) -> Result<()> {
        let by = match (args.offset, args.per_file) {
            (Some(_), _) => "--offset",
            (None, true) => "the recorded clock at the end of the file",
            (None, false) => "the recorded clock at the end of the boot",
        };
        let told = Facts::from([
            ("offset_ns".to_owned(), self.shift.to_string()),
            ("by".to_owned(), by.to_owned()),
        ]);
        let mut shift = Shift::new(self.shift, told);
        let mut progress = Progress::new(&self.file);
        let mut go_on = |at| progress.show(at);
        self.report = rewrite(&self.file, &self.output, Some(&mut shift), &mut go_on)?;
        Ok(())
    }

    fn json(&self) -> Value {
        json!({
            "input": self.file,
            "output": self.output,
            "offset_ns": self.shift,
            "messages": self.report.as_ref().map(|report| report.messages),
            "whole": self.report.as_ref().map(Report::is_whole),
        })
    }

    fn print(&self, out: &mut impl std::io::Write) -> Result<()> {
        let name = |path: &Path| printable(&path.display().to_string());
        let by = signed_duration(self.shift);
        writeln!(out, "{} -> {}: times moved by {by}", name(&self.file), name(&self.output))?;
        if let Some(report) = self.report.as_ref().filter(|report| !report.is_whole()) {
            writeln!(out, "  {}", printable(&report.sentence()))?;
        }
        Ok(())
    }
}

/// Where the new file goes; a time in the name is moved too.
fn target(args: &RetimeArgs, file: &Path, shift: i64) -> PathBuf {
    if let Some(output) = &args.output {
        return output.clone();
    }
    let name = final_name(file);
    let stem = name.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    // The time in a name is a whole second, which a shift of some nanoseconds must not make the
    // one before.
    let seconds = shift.saturating_add(SECOND / 2).div_euclid(SECOND).saturating_mul(SECOND);
    // Behind the time there can be the trigger of a window.
    let parts = stem.split('_').map(|part| match parse_compact_utc(part) {
        Some(time) => compact_utc(Timestamp(time.nanos().saturating_add_signed(seconds))),
        None => part.to_owned(),
    });
    let name = format!("{}.mcap", parts.collect::<Vec<_>>().join("_"));
    args.dir.clone().unwrap_or_else(|| ".".into()).join(name)
}

fn refuse_doubles(moves: &[Move]) -> Result<()> {
    let mut inputs = BTreeMap::new();
    for one in moves {
        if let Some(other) = inputs.insert(&one.output, &one.file) {
            bail!(UsageError(format!(
                "{} and {} would both become {}; put them into different folders",
                other.display(),
                one.file.display(),
                one.output.display()
            )));
        }
    }
    Ok(())
}

fn time(nanos: i128) -> String {
    rfc3339(Timestamp(u64::try_from(nanos).unwrap_or(0)))
}
