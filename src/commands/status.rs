//! `bustape status`: what the recorders of this machine are doing.

use std::io::Write as _;
use std::time::Duration;

use anyhow::{Result, bail};
use serde_json::{Value, json};

use super::running::{self, Running};
use super::{Ended, output};
use crate::cli::StatusArgs;
use crate::text::{duration, grouped, printable, printable_json, size};

/// A status that was not renewed for so long means that the recorder hangs.
const STALE: Duration = Duration::from_secs(5);

/// Runs the command.
pub fn run(args: &StatusArgs) -> Result<Ended> {
    let mut all = running::all();
    all.retain(|recorder| args.name.as_ref().is_none_or(|name| recorder.name == *name));
    let mut out = output::stdout();
    if args.json {
        let all: Vec<Value> = all.iter().map(as_json).collect();
        writeln!(out, "{}", printable_json(&Value::Array(all).to_string()))?;
    }
    if all.is_empty() {
        out.flush()?;
        bail!(running::nobody(args.name.as_deref()));
    }
    for recorder in all.iter().filter(|_| !args.json) {
        print(&mut out, recorder)?;
    }
    out.flush()?;
    let lost = |bus: &Value| bus["dropped"] != 0 || bus["outages"] != 0;
    let mut buses = all.iter().flat_map(|r| r.status["buses"].as_array().into_iter().flatten());
    Ok(if buses.any(lost) { Ended::WithLoss } else { Ended::Well })
}

fn as_json(recorder: &Running) -> Value {
    let mut status = recorder.status.clone();
    status["age_s"] = json!(recorder.age.as_secs_f64());
    status
}

fn print(out: &mut impl std::io::Write, recorder: &Running) -> Result<()> {
    let Running { name, pid, status, age, .. } = recorder;
    let number = |value: &Value| value.as_u64().unwrap_or(0);
    let seconds = |value: &Value| duration(number(value).saturating_mul(1_000_000_000));
    writeln!(out, "{} (process {pid}), up {}", printable(name), seconds(&status["uptime_s"]))?;
    if *age > STALE {
        writeln!(out, "  it has said nothing for {} s", age.as_secs())?;
    }
    let rows = status["buses"].as_array().into_iter().flatten().map(|bus| {
        let cell = |key: &str| grouped(number(&bus[key]));
        let rate = format!("{:.0}/s", bus["rate"].as_f64().unwrap_or(0.0));
        let text = |key: &str| bus[key].as_str().unwrap_or_default().to_owned();
        let away = cell("outages");
        vec![
            text("bus"),
            text("unit"),
            rate,
            cell("received"),
            cell("written"),
            cell("dropped"),
            away,
        ]
    });
    let head = ["bus", "unit", "rate", "received", "written", "dropped", "outages"];
    out.write_all(output::table(&head, &[2, 3, 4, 5, 6], rows.collect()).as_bytes())?;
    if let Some(file) = status["file"].as_str().filter(|file| !file.is_empty()) {
        let bytes = size(number(&status["file_bytes"]));
        writeln!(out, "  writing {} ({bytes})", printable(file))?;
    }
    if let Some(window) = status["window"].as_str() {
        let count = grouped(number(&status["windows"]));
        writeln!(out, "  {count} windows around triggers, the latest {}", printable(window))?;
    }
    let synced = match status["synced_ms_ago"].as_u64() {
        Some(ago) => format!("{} before", duration(ago.saturating_mul(1_000_000))),
        None => "not yet".to_owned(),
    };
    writeln!(out, "  last sync {synced}, {} waiting", size(number(&status["queued_bytes"])))?;
    writeln!(out, "  {} free on the disk", size(number(&status["free_bytes"])))?;
    Ok(())
}
