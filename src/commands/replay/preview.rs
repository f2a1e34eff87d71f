//! `--dry-run`: what would go where.

use std::io::Write as _;
use std::time::Duration;

use anyhow::Result;
use serde_json::json;

use super::omitted_text;
use super::plan::Plan;
use crate::cli::replay::ReplayArgs;
use crate::commands::{Ended, output};
use crate::frame::{Frame, Timestamp};
use crate::permit::{Reach, grant};
use crate::recording::reader::Recording;
use crate::replay::feed::{Feed, FeedPlan, Next, Place};
use crate::replay::tally::Tally;
use crate::text::{grouped, rfc3339_millis};

/// Reads what would be played, once, and says how much it is.
pub fn show(
    args: &ReplayArgs,
    plan: &Plan,
    recording: &Recording,
    reaches: &[Reach],
) -> Result<Ended> {
    let once = FeedPlan { laps: Some(1), ..plan.feed.clone() };
    let mut tallies = vec![Tally::default(); plan.lane_of.len()];
    let mut span: Option<(Timestamp, Timestamp)> = None;
    let mut damage = Vec::new();
    std::thread::scope(|scope| {
        let from = *once.range.start();
        let mut feed = Feed::start(scope, recording, &once, Place { from, lap: 0, media: 0 });
        let mut left = args.count.unwrap_or(u64::MAX);
        loop {
            match feed.look() {
                Next::End => break,
                Next::NotYet => feed.wait(Duration::from_secs(1)),
                Next::At(_) => {
                    let Some(item) = feed.take() else { continue };
                    if left == 0 {
                        break;
                    }
                    let tally = &mut tallies[item.bus];
                    if matches!(item.frame, Frame::Gap(_)) {
                        tally.gaps += 1;
                        continue;
                    }
                    left -= 1;
                    tally.sent += 1;
                    span = Some((span.map_or(item.time, |span| span.0), item.time));
                }
            }
        }
        for (tally, omitted) in tallies.iter_mut().zip(feed.take_omitted()) {
            tally.omitted.merge(&omitted);
        }
        damage = feed.take_damage();
    });
    let refusal = grant(reaches, &args.transmit_on).err();
    if args.json {
        print_json(plan, reaches, &tallies, span, refusal.is_none())?;
    } else {
        print_table(plan, reaches, &tallies, span)?;
    }
    if let Some(refusal) = refusal {
        output::note(&format!("it would not run: {refusal}"));
    }
    plan.say_unmapped(recording);
    for sentence in &damage {
        output::warning(sentence);
    }
    super::say_intact(recording);
    let damaged = !damage.is_empty() || recording.unfinished().next().is_some();
    Ok(if damaged { Ended::WithLoss } else { Ended::Well })
}

fn print_table(
    plan: &Plan,
    reaches: &[Reach],
    tallies: &[Tally],
    span: Option<(Timestamp, Timestamp)>,
) -> Result<()> {
    let rows = plan.buses().map(|(bus, name, lane)| {
        let (reach, tally) = (&reaches[lane], &tallies[bus]);
        let real = if reach.is_virtual { "virtual" } else { "real" };
        let what = if plan.answers(bus) { "answers" } else { "plays" };
        vec![
            name.to_owned(),
            plan.targets[lane].text.clone(),
            format!("{real}, {}", reach.kind),
            what.to_owned(),
            grouped(tally.sent),
            omitted_text(tally.omitted.counts()),
        ]
    });
    let head = ["BUS", "TARGET", "KIND", "", "FRAMES", "NOT SENT"];
    let mut out = output::stdout();
    write!(out, "{}", output::table(&head, &[4], rows.collect()))?;
    if let Some((first, last)) = span {
        writeln!(out, "from {} to {}", rfc3339_millis(first), rfc3339_millis(last))?;
    }
    Ok(out.flush()?)
}

fn print_json(
    plan: &Plan,
    reaches: &[Reach],
    tallies: &[Tally],
    span: Option<(Timestamp, Timestamp)>,
    permitted: bool,
) -> Result<()> {
    let buses = plan.buses().map(|(bus, name, lane)| {
        let (reach, tally) = (&reaches[lane], &tallies[bus]);
        let omitted: serde_json::Map<_, _> = tally
            .omitted
            .counts()
            .map(|(why, count)| (why.name().to_owned(), json!(count)))
            .collect();
        json!({
            "bus": name,
            "target": plan.targets[lane].text,
            "virtual": reach.is_virtual,
            "kind": reach.kind,
            "answers": plan.answers(bus),
            "frames": tally.sent,
            "not_sent": omitted,
            "gaps": tally.gaps,
        })
    });
    let report = json!({
        "dry_run": true,
        "permitted": permitted,
        "from": span.map(|span| crate::text::rfc3339(span.0)),
        "to": span.map(|span| crate::text::rfc3339(span.1)),
        "buses": buses.collect::<Vec<_>>(),
    });
    let mut out = output::stdout();
    writeln!(out, "{report}")?;
    Ok(out.flush()?)
}
