//! `--answer`: learns from the recording what a device says.

use std::sync::Arc;

use anyhow::Result;

use super::definitions::Definitions;
use super::plan::{Carries, Plan};
use super::usage;
use crate::cli::replay::{Delay, Repeat, ReplayArgs, Unknown};
use crate::commands::output;
use crate::frame::Frame;
use crate::recording::reader::{Entry, Recording};
use crate::replay::answer::{Answerer, Manner, by_bytes, by_frames, by_meaning};
use crate::text::grouped;

/// What answers at each target, by its number, and as which bus.
pub type Answerers = Vec<Option<(usize, Box<dyn Answerer>)>>;

/// Learns what every answered bus says.
pub fn learn(args: &ReplayArgs, plan: &Plan, recording: &Recording) -> Result<Answerers> {
    let mut answerers: Answerers = plan.targets.iter().map(|_| None).collect();
    let definitions = Definitions::of(&args.decode, recording)?;
    let manner = Manner {
        cycle: args.repeat == Repeat::Cycle,
        delay: args.delay == Delay::Recorded,
        error: args.unknown == Unknown::Error,
    };
    for (bus, name, lane) in plan.buses().filter(|(bus, ..)| plan.answers(*bus)) {
        let (answerer, answers, full) = match plan.carries(bus) {
            Carries::Serial => serial(plan, recording, name, &definitions, manner)?,
            Carries::Can => can(plan, recording, name, &definitions, manner)?,
        };
        output::note(&format!("{name}: {} recorded answers", grouped(answers as u64)));
        if full {
            output::warning(&format!(
                "{name}: the dialogue is too long to remember; only its first {answers} answers \
                 are given (choose a part with --start and --end)"
            ));
        }
        answerers[lane] = Some((bus, answerer));
    }
    Ok(answerers)
}

type Learnt = (Box<dyn Answerer>, usize, bool);

fn can(
    plan: &Plan,
    recording: &Recording,
    bus: &str,
    definitions: &Definitions<'_>,
    manner: Manner,
) -> Result<Learnt> {
    let Some(definition) = definitions.can(bus)? else {
        return usage(format!(
            "--answer {bus}: which frames answer which, a protocol has to say; name it with --decode \
             {bus}=PROTOCOL"
        ));
    };
    if definition.answers().is_empty() {
        return usage(format!(
            "--answer {bus}: the protocol {} has no [[answer]] rules",
            definition.name()
        ));
    }
    if manner.error {
        return usage(format!("--unknown error: {bus} is a CAN bus, which has no error answers"));
    }
    let topics = [format!("/{bus}/raw"), format!("/{bus}/gaps")];
    let range = plan.feed.range.clone();
    let mut entries = recording.entries(range, |topic| topics.iter().any(|own| own == topic));
    let mut learner = by_frames::Learner::new(definition.answers().to_vec());
    for entry in entries.by_ref() {
        match entry.value {
            Entry::Frame(_, Frame::Can(frame)) => learner.learn(entry.time, &frame),
            Entry::Frame(_, Frame::Gap(_)) => learner.gap(),
            _ => {}
        }
    }
    say_damage(entries.damage());
    let (device, answers, full) = learner.finish(manner);
    Ok((Box::new(device), answers, full))
}

fn serial(
    plan: &Plan,
    recording: &Recording,
    bus: &str,
    definitions: &Definitions<'_>,
    manner: Manner,
) -> Result<Learnt> {
    let topics = [format!("/{bus}/raw"), format!("/{bus}/gaps")];
    let range = plan.feed.range.clone();
    let mut entries = recording.entries(range, |topic| topics.iter().any(|own| own == topic));
    if let Some(protocol) = definitions.serial(bus)? {
        let protocol = Arc::new(protocol);
        if manner.error && !protocol.has_error_answer() {
            return usage(format!(
                "--unknown error: the definition {} has no [error_answer]",
                protocol.name
            ));
        }
        let mut learner = by_meaning::Learner::new(protocol);
        for entry in entries.by_ref() {
            match entry.value {
                Entry::Frame(_, Frame::Serial(bytes)) => learner.learn(entry.time, &bytes),
                Entry::Frame(_, Frame::Gap(_)) => learner.gap(),
                _ => {}
            }
        }
        say_damage(entries.damage());
        let (device, answers, full) = learner.finish(manner);
        return Ok((Box::new(device), answers, full));
    }
    if manner.error {
        return usage(format!(
            "--unknown error: without a definition nobody knows the error answer of {bus}; name \
             one with --decode {bus}=PROTOCOL"
        ));
    }
    output::note(&format!("{bus} has no protocol: requests are known by all their bytes"));
    let mut learner = by_bytes::Learner::default();
    for entry in entries.by_ref() {
        match entry.value {
            Entry::Frame(_, Frame::Serial(bytes)) => learner.learn(entry.time, &bytes),
            Entry::Frame(_, Frame::Gap(_)) => learner.gap(),
            _ => {}
        }
    }
    say_damage(entries.damage());
    let (device, answers, full) = learner.finish(manner);
    Ok((Box::new(device), answers, full))
}

fn say_damage(damage: &[String]) {
    for sentence in damage {
        output::warning(sentence);
    }
}
