//! What a replay says of itself at its end.

use std::fmt::Write as _;
use std::io::Write as _;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::omitted_text;
use super::plan::Plan;
use crate::cli::replay::ReplayArgs;
use crate::commands::output;
use crate::replay::ReplayError;
use crate::replay::answer::Counts;
use crate::replay::lateness::Lateness;
use crate::replay::sink::trace::READER_GONE;
use crate::replay::stage::{Ending, Outcome, Stage};
use crate::replay::tally::{Tally, Waits};
use crate::replay::target::TargetAddress;
use crate::replay::verify::Verdict;
use crate::text::{duration, grouped, rfc3339};

/// Prints it: on stdout, or on stderr where a trace has stdout.
pub fn report(
    args: &ReplayArgs,
    plan: &Plan,
    stage: &Stage<'_>,
    outcome: &Outcome,
    verdicts: &[Option<Verdict>],
) -> Result<()> {
    let text = if args.json {
        format!("{}\n", as_json(plan, stage, outcome, verdicts))
    } else {
        as_table(plan, stage, outcome, verdicts)
    };
    if plan.targets.iter().any(|target| target.address == TargetAddress::Trace) {
        let mut stderr = std::io::stderr();
        return stderr.write_all(text.as_bytes()).context("cannot write the report to stderr");
    }
    Ok(output::result(&text)?)
}

fn reason(outcome: &Outcome) -> &'static str {
    match outcome.ending {
        Ok(Ending::Finished) => "finished",
        Ok(Ending::Count) => "count",
        Ok(Ending::Quit) => "quit",
        Ok(Ending::Signal(name)) => name,
        Err(ReplayError(ref text)) if text == READER_GONE => "reader gone",
        Err(_) => "error",
    }
}

fn as_table(
    plan: &Plan,
    stage: &Stage<'_>,
    outcome: &Outcome,
    verdicts: &[Option<Verdict>],
) -> String {
    let micros = |tally: &Tally, nanos: u64| match tally.lateness.count() {
        0 => "-".to_owned(),
        _ => format!("{}.{}", grouped(nanos / 1000), nanos / 100 % 10),
    };
    let rows = plan.buses().map(|(bus, name, lane)| {
        let tally = &outcome.tallies[bus];
        let lateness = &tally.lateness;
        vec![
            name.to_owned(),
            plan.targets[lane].text.clone(),
            grouped(tally.sent),
            waits_text(stage.lanes[lane].waits),
            micros(tally, lateness.percentile(50)),
            micros(tally, lateness.percentile(99)),
            micros(tally, lateness.max()),
            omitted_text(tally.omitted.counts()),
        ]
    });
    let head = ["BUS", "TARGET", "SENT", "WAITED", "LATE p50 us", "p99 us", "MAX us", "NOT SENT"];
    let mut text = output::table(&head, &[2, 3, 4, 5, 6], rows.collect());
    for (lane, verdict) in stage.lanes.iter().zip(verdicts) {
        if let Some(Verdict { same, error, difference: None }) = verdict {
            let _ = writeln!(
                text,
                " {}: {} compared and the same; off by p50 {} us, p99 {} us, at most {} us",
                lane.target,
                grouped(*same),
                grouped(error.percentile(50) / 1000),
                grouped(error.percentile(99) / 1000),
                grouped(error.max() / 1000),
            );
        }
    }
    for (bus, answerer) in stage.answerers.iter().flatten() {
        let name = plan.buses().nth(*bus).map_or("", |(_, name, _)| name);
        text.push_str(&answers_text(name, answerer.counts()));
    }
    let gaps: u64 = outcome.tallies.iter().map(|tally| tally.gaps).sum();
    let gaps = if gaps > 0 { format!("; {gaps} gaps in the recording") } else { String::new() };
    let _ = writeln!(text, " {} after {}{gaps}", reason(outcome), duration(outcome.took));
    text
}

fn waits_text(waits: Waits) -> String {
    match waits.count {
        0 => "-".to_owned(),
        count => format!("{}x, {}", grouped(count), duration(waits.nanos)),
    }
}

fn as_json(
    plan: &Plan,
    stage: &Stage<'_>,
    outcome: &Outcome,
    verdicts: &[Option<Verdict>],
) -> Value {
    let answers = |bus: usize| {
        let found = stage.answerers.iter().flatten().find(|(own, _)| *own == bus);
        found.map(|(_, answerer)| {
            let counts = answerer.counts();
            json!({
                "requests": counts.requests,
                "answered": counts.answered,
                "silent": counts.silent,
                "never_recorded": counts.misses(),
                "kinds_never_recorded": counts.unknown,
                "damaged": counts.damaged,
            })
        })
    };
    let buses = plan.buses().map(|(bus, name, lane)| {
        let (tally, waits) = (&outcome.tallies[bus], stage.lanes[lane].waits);
        let lateness = &tally.lateness;
        let omitted: serde_json::Map<_, _> = tally
            .omitted
            .counts()
            .map(|(why, count)| (why.name().to_owned(), json!(count)))
            .collect();
        json!({
            "bus": name,
            "target": plan.targets[lane].text,
            "sent": tally.sent,
            "bytes": tally.bytes,
            "not_sent": omitted,
            "gaps": tally.gaps,
            "waits": waits.count,
            "waited_ns": waits.nanos,
            "lateness_ns": percentiles(lateness),
            "verify": verdicts[lane].as_ref().map(|verdict| json!({
                "same": verdict.same,
                "error_ns": percentiles(&verdict.error),
                "difference": verdict.difference,
            })),
            "answers": answers(bus),
        })
    });
    let marks = outcome.marks.iter().map(
        |(time, text)| json!({ "time": rfc3339(*time), "time_ns": time.nanos(), "text": text }),
    );
    json!({
        "reason": reason(outcome),
        "took_ns": outcome.took,
        "buses": buses.collect::<Vec<_>>(),
        "marks": marks.collect::<Vec<_>>(),
        "damage": outcome.damage,
    })
}

fn percentiles(times: &Lateness) -> Option<Value> {
    (times.count() > 0).then(|| {
        json!({
            "p50": times.percentile(50),
            "p99": times.percentile(99),
            "max": times.max(),
        })
    })
}

fn answers_text(bus: &str, counts: &Counts) -> String {
    let mut text = format!(
        " {bus}: {} requests, {} answered",
        grouped(counts.requests),
        grouped(counts.answered)
    );
    for (count, what) in [
        (counts.silent, "not answered in the recording either"),
        (counts.misses(), "never recorded"),
        (counts.damaged, "damaged"),
    ] {
        if count > 0 {
            let _ = write!(text, ", {} {what}", grouped(count));
        }
    }
    text.push('\n');
    text
}
