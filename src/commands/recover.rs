//! `bustape recover`: a sound copy of what is left of a recording.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use serde_json::{Value, json};

use super::{Ended, UsageError, output};
use crate::cli::RecoverArgs;
use crate::frame::Timestamp;
use crate::record::leftovers::{Recovered, final_name, nothing_in, recover_in_place, rewrite};
use crate::recording::reader::files_of;
use crate::recording::rewrite::{Lost, Report};
use crate::text::{grouped, printable, printable_json, rfc3339, size};

/// Losses printed before the rest is only counted; `--json` has up to 1000.
const LOSSES_SHOWN: usize = 20;

/// Runs the command.
pub fn run(args: &RecoverArgs) -> Result<Ended> {
    let mut files = Vec::new();
    for path in &args.files {
        files.extend(files_of(path)?);
    }
    if args.output.is_some() && files.len() != 1 {
        bail!(UsageError(format!(
            "-o takes the copy of one file, and there are {}; use -d DIR or --in-place",
            files.len()
        )));
    }
    let (mut done, mut failed) = (Vec::new(), 0);
    for file in &files {
        match one(args, file) {
            Ok(one) => done.extend(one),
            Err(error) if files.len() == 1 => return Err(error),
            // The others may be better off.
            Err(error) => {
                output::warning(&error.to_string());
                failed += 1;
            }
        }
    }
    let mut out = output::stdout();
    if args.json {
        let files: Vec<Value> = done.iter().map(Done::json).collect();
        writeln!(out, "{}", printable_json(&json!({ "files": files }).to_string()))?;
    } else {
        for one in &done {
            one.print(&mut out)?;
        }
    }
    out.flush()?;
    for one in done.iter().filter(|one| !one.report.is_whole()) {
        output::warning(&format!("{}: not all of it could be recovered", one.input.display()));
    }
    if failed > 0 {
        bail!(
            "{failed} of {} files could not be recovered; a warning above says why for each",
            files.len()
        );
    }
    let whole = done.iter().all(|one| one.report.is_whole());
    Ok(if whole { Ended::Well } else { Ended::WithLoss })
}

/// A file that was recovered.
struct Done {
    input: PathBuf,
    output: PathBuf,
    aside: Option<PathBuf>,
    report: Report,
}

/// `None` if there was nothing in it.
fn one(args: &RecoverArgs, file: &Path) -> Result<Option<Done>> {
    let mut progress = Progress::new(file);
    let mut go_on = |at| progress.show(at);
    let input = file.to_owned();
    if args.in_place {
        return Ok(match recover_in_place(file, &mut go_on)? {
            Recovered::Sound(report) => {
                Some(Done { output: input.clone(), input, aside: None, report })
            }
            Recovered::Anew { file, aside, report } => {
                Some(Done { input, output: file, aside, report })
            }
            Recovered::Nothing { aside } => {
                output::note(&nothing_in(file, aside.as_deref()));
                None
            }
            Recovered::Stopped => bail!("interrupted"),
        });
    }
    let output = match (&args.output, &args.dir) {
        (Some(output), _) => output.clone(),
        (None, folder) => {
            let name = final_name(file);
            let name = name.file_name().unwrap_or_default();
            folder.clone().unwrap_or_else(|| ".".into()).join(name)
        }
    };
    let Some(report) = rewrite(file, &output, None, &mut go_on)? else { bail!("interrupted") };
    Ok(Some(Done { input, output, aside: None, report }))
}

impl Done {
    fn json(&self) -> Value {
        let report = &self.report;
        let (messages, exact) = report.lost_messages();
        json!({
            "input": self.input,
            "output": self.output,
            "set_aside": self.aside,
            "was_finished": report.finished,
            "whole": report.is_whole(),
            "kept": {
                "messages": report.messages,
                "unverified_messages": report.unverified,
                "chunks_copied": report.copied_chunks,
                "chunks_made_anew": report.remade_chunks,
                "metadata": report.metadata,
                "attachments": report.attachments,
            },
            "lost": {
                "bytes": report.lost_bytes,
                "messages": messages,
                "messages_exact": exact,
                "ranges": report.lost.iter().map(lost_json).collect::<Vec<_>>(),
                "more_ranges": report.more_lost,
            },
            "index_bytes_damaged": report.index_bytes,
        })
    }

    fn print(&self, out: &mut impl std::io::Write) -> Result<()> {
        let report = &self.report;
        let name = |path: &Path| printable(&path.display().to_string());
        if self.output == self.input {
            writeln!(out, "{}: sound, left as it is", name(&self.input))?;
        } else {
            writeln!(out, "{} -> {}", name(&self.input), name(&self.output))?;
        }
        if let Some(aside) = &self.aside {
            writeln!(out, "  the original is now {}", name(aside))?;
        }
        writeln!(out, "  {}", printable(&report.sentence()))?;
        for lost in report.lost.iter().take(LOSSES_SHOWN) {
            writeln!(out, "  lost {}", printable(&lost_text(lost)))?;
        }
        let more = report.lost.len().saturating_sub(LOSSES_SHOWN) as u64 + report.more_lost;
        if more > 0 {
            writeln!(out, "  and {} more places; --json tells up to 1,000", grouped(more))?;
        }
        Ok(())
    }
}

fn lost_json(lost: &Lost) -> Value {
    let time = |nanos: Option<u64>| nanos.map(|nanos| rfc3339(Timestamp(nanos)));
    json!({
        "from": lost.from,
        "to": lost.to,
        "what": lost.what,
        "not_before": time(lost.after),
        "not_after": time(lost.before),
        "messages": lost.messages,
    })
}

fn lost_text(lost: &Lost) -> String {
    let time = |nanos: Option<u64>, otherwise: &str| {
        nanos.map_or(otherwise.to_owned(), |nanos| rfc3339(Timestamp(nanos)))
    };
    let messages = lost.messages.map(|count| format!("; {} messages", grouped(count)));
    format!(
        "bytes {} to {} ({}), {} to {}: {}{}",
        grouped(lost.from),
        grouped(lost.to),
        size(lost.to - lost.from),
        time(lost.after, "its start"),
        time(lost.before, "its end"),
        lost.what,
        messages.unwrap_or_default(),
    )
}

/// Percent on a terminal.
pub struct Progress {
    size: u64,
    shown: u64,
    on_terminal: bool,
}

impl Progress {
    /// For work through `file`.
    pub fn new(file: &Path) -> Self {
        let size = std::fs::metadata(file).map_or(0, |about| about.len());
        Self { size, shown: 0, on_terminal: std::io::stderr().is_terminal() }
    }

    /// The work has come to byte `at`. Always says to go on.
    pub fn show(&mut self, at: u64) -> bool {
        let percent = at * 100 / self.size.max(1);
        if self.on_terminal && percent != self.shown {
            self.shown = percent;
            anstream::eprint!("\r{percent:3} %\r");
        }
        true
    }
}
