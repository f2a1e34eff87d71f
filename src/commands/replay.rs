//! `bustape replay`: a recording, back onto buses.

mod answers;
mod choice;
mod definitions;
mod opening;
mod permission;
mod plan;
mod preview;
mod report;
mod screen;

use std::io::IsTerminal as _;
use std::path::Path;

use anyhow::{Context as _, Result, bail};

use super::{Ended, UsageError, info, output};
use crate::cli::replay::ReplayArgs;
use crate::permit::Reach;
use crate::recording::reader::Recording;
use crate::replay::ReplayError;
use crate::replay::control::{Controls, Script};
use crate::replay::keys::{self, Keys};
use crate::replay::lane::Lane;
use crate::replay::player::play;
use crate::replay::sink::trace::READER_GONE;
use crate::replay::stage::{Options, Outcome, Stage};
use crate::replay::tally::NotSent;
use plan::Plan;
use screen::Screen;

/// Runs the command.
pub fn run(args: &ReplayArgs) -> Result<Ended> {
    let plan = Plan::check(args)?;
    let recording = Recording::open(&args.files)?;
    let plan = plan.complete(args, &recording)?;
    if args.verify {
        plan.check_verify()?;
    }
    let reaches = plan.reaches()?;
    if args.dry_run {
        plan.check_fd(&recording, &reaches)?;
        return preview::show(args, &plan, &recording, &reaches);
    }
    let permit = permission::permit(args, &reaches)?;
    permission::confirm(args, &reaches)?;
    plan.check_fd(&recording, &reaches)?;
    say_intact(&recording);
    plan.say_unmapped(&recording);
    let learnt = answers::learn(args, &plan, &recording)?;

    // From here on signals are heard by the player, and the links of pseudo-terminals are
    // removed at the end.
    let mut controls = controls(args)?;
    let mut lanes = plan.open(args, &reaches, &permit)?;
    say_notes(&mut lanes);
    if args.verify {
        plan.watch(&mut lanes, &reaches)?;
    }
    let mut stage = Stage {
        recording: &recording,
        plan: &plan.feed,
        lanes,
        lane_of: plan.lane_of.clone(),
        answerers: learnt.answerers,
    };
    let options =
        Options { rate: args.rate, count: args.count, precise: args.precise, paused: args.paused };
    let mut screen = Screen::new(&plan, &recording, !args.json);
    let outcome = play(&mut stage, &mut controls, &mut screen, options);
    screen.clear();
    drop(controls);
    say_notes(&mut stage.lanes);
    let verdicts: Vec<_> = stage.lanes.iter_mut().map(Lane::verdict).collect();
    let reported = report::report(args, &plan, &stage, &outcome, &verdicts);
    drop(stage);
    let ended = ended(outcome, &recording, learnt.damaged)?;
    reported?;
    match verdicts.into_iter().flatten().find_map(|verdict| verdict.difference) {
        Some(difference) => bail!("what arrived is not what was sent: {difference}"),
        None => Ok(ended),
    }
}

/// What a person should know of the targets.
fn say_notes(lanes: &mut [Lane]) {
    for note in lanes.iter_mut().flat_map(|lane| lane.sink().notes()) {
        output::warning(&note);
    }
}

/// Keys on a terminal, commands where they are asked for.
fn controls(args: &ReplayArgs) -> Result<Controls> {
    let script = match &args.control {
        Some(path) if path == Path::new("-") => Some(Script::stdin().context("stdin is closed")?),
        Some(path) => Some(Script::fifo(path)?),
        None => None,
    };
    let by_hand = script.is_none() && std::io::stdin().is_terminal();
    let keys = if by_hand && std::io::stderr().is_terminal() { Keys::new().ok() } else { None };
    if keys.is_some() {
        output::note(keys::HELP);
    }
    Controls::new(script, keys).context("cannot listen to signals")
}

/// What of the recording cannot be played, as far as it is known before.
fn say_intact(recording: &Recording) {
    for segment in recording.unfinished() {
        output::warning(&info::unfinished(segment));
    }
}

fn ended(outcome: Outcome, recording: &Recording, damaged: bool) -> Result<Ended> {
    for sentence in &outcome.damage {
        output::warning(sentence);
    }
    match outcome.ending {
        Err(ReplayError(text)) if text == READER_GONE => {}
        Err(error) => bail!(error),
        Ok(_) => {}
    }
    let lost = outcome.tallies.iter().any(|t| t.omitted.counts().any(|(why, _)| why.is_loss()));
    let damaged = damaged || !outcome.damage.is_empty() || recording.unfinished().next().is_some();
    Ok(if lost || damaged { Ended::WithLoss } else { Ended::Well })
}

/// True if something is not virtual.
fn any_real(reaches: &[Reach]) -> bool {
    reaches.iter().any(|reach| !reach.is_virtual)
}

/// What was typed makes no sense.
fn usage<T>(text: String) -> Result<T> {
    bail!(UsageError(text))
}

/// `12 filtered, 3 error frames`.
fn omitted_text(counts: impl Iterator<Item = (NotSent, u64)>) -> String {
    let parts: Vec<String> = counts
        .map(|(why, count)| format!("{} {}", crate::text::grouped(count), why.text()))
        .collect();
    parts.join(", ")
}
