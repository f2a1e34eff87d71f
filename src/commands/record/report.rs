//! The books, for a person or a program, and what they mean for the exit status.

use std::io::Write as _;

use anyhow::{Result, bail};
use serde_json::json;

use super::Recorded;
use crate::commands::{Ended, definitions, output};
use crate::frame::GapReason;
use crate::queue::Totals;
use crate::text::{grouped, printable, printable_json, size};

/// Prints the books, and says how it went.
pub fn report(recorded: &Recorded, as_json: bool) -> Result<Ended> {
    let mut out = output::stdout();
    if as_json {
        writeln!(out, "{}", printable_json(&report_json(recorded).to_string()))?;
    } else {
        report_text(&mut out, recorded)?;
    }
    out.flush()?;
    if let Some(error) = &recorded.outcome.error {
        bail!("{error}");
    }
    if !recorded.errors.is_empty() {
        return Ok(Ended::WithLoss);
    }
    if recorded.outcome.full {
        return Ok(Ended::WithLoss);
    }
    let stopped = recorded.outcome.streams.iter().any(|stream| stream.stopped().is_some());
    let complete = recorded.outcome.totals.iter().all(Totals::complete) && !stopped;
    Ok(if complete { Ended::Well } else { Ended::WithLoss })
}

fn report_text(out: &mut impl std::io::Write, recorded: &Recorded) -> Result<()> {
    for ((name, unit), totals) in recorded.buses.iter().zip(&recorded.outcome.totals) {
        write!(
            out,
            "{name}: received {} = written {} + dropped {} {}",
            grouped(totals.received),
            grouped(totals.written),
            grouped(totals.lost()),
            unit.name(),
        )?;
        let reasons: Vec<String> = GapReason::ALL
            .into_iter()
            .filter(|reason| totals.lost_to(*reason) > 0)
            .map(|reason| format!("{} {}", reason.name(), grouped(totals.lost_to(reason))))
            .collect();
        if !reasons.is_empty() {
            write!(out, " ({})", reasons.join(", "))?;
        }
        if totals.outages > 0 {
            write!(out, "; away {} times, for which nobody knows the number", totals.outages)?;
        }
        writeln!(out)?;
    }
    for stream in &recorded.outcome.streams {
        writeln!(out, "{}", printable(&definitions::sentence(stream)))?;
    }
    for file in recorded.files() {
        let bytes = std::fs::metadata(file).map_or(0, |m| m.len());
        let name = printable(&file.display().to_string());
        writeln!(out, "{name} ({})", size(bytes))?;
    }
    Ok(())
}

fn report_json(recorded: &Recorded) -> serde_json::Value {
    let buses =
        recorded.buses.iter().zip(&recorded.outcome.totals).map(|((name, unit), totals)| {
            let dropped = GapReason::ALL.into_iter().filter(|reason| totals.lost_to(*reason) > 0);
            let dropped: serde_json::Map<_, _> = dropped
                .map(|reason| (reason.name().to_owned(), json!(totals.lost_to(reason))))
                .collect();
            json!({
                "bus": name,
                "unit": unit.name(),
                "received": totals.received,
                "written": totals.written,
                "dropped": totals.lost(),
                "dropped_by_reason": dropped,
            "outages": totals.outages,
            })
        });
    json!({
        "reason": recorded.reason,
        "buses": buses.collect::<Vec<_>>(),
        "decoded": recorded.outcome.streams.iter().map(definitions::as_json).collect::<Vec<_>>(),
        "files": recorded.files(),
        "errors": recorded.errors,
    })
}
