//! `--answer`: learns from the recording what a device says.

use std::sync::Arc;

use anyhow::Result;

use super::definitions::Definitions;
use super::plan::{Carries, Plan};
use super::usage;
use crate::cli::replay::{Delay, Repeat, ReplayArgs, Unknown};
use crate::commands::output;
use crate::recording::reader::{Entry, Recording};
use crate::replay::answer::{Answerer, Manner, Pupil, by_bytes, by_frames, by_meaning};
use crate::text::grouped;

/// What was learnt.
pub struct Answers {
    /// What answers at each target, by its number, and as which bus.
    pub answerers: Vec<Option<(usize, Box<dyn Answerer>)>>,
    /// True if some of the dialogue could not be read, which was said.
    pub damaged: bool,
}

/// Learns what every answered bus says.
pub fn learn(args: &ReplayArgs, plan: &Plan, recording: &Recording) -> Result<Answers> {
    let answerers = plan.targets.iter().map(|_| None).collect();
    let mut learnt = Answers { answerers, damaged: false };
    let definitions = Definitions::of(&args.decode, recording)?;
    let manner = Manner {
        cycle: args.repeat == Repeat::Cycle,
        delay: args.delay == Delay::Recorded,
        error: args.unknown == Unknown::Error,
    };
    for (bus, name, lane) in plan.buses().filter(|(bus, ..)| plan.answers(*bus)) {
        let mut pupil = match plan.carries(bus) {
            Carries::Serial => of_line(name, &definitions, manner)?,
            Carries::Can => of_bus(name, &definitions, manner)?,
        };
        learnt.damaged |= teach(&mut *pupil, plan, recording, name);
        let device = pupil.graduate(manner);
        output::note(&format!("{name}: {} recorded answers", grouped(device.answers as u64)));
        if device.full {
            output::warning(&format!(
                "{name}: the dialogue is too long to remember; only its first {} answers are \
                 given (choose a part with --start and --end)",
                device.answers
            ));
        }
        learnt.answerers[lane] = Some((bus, device.device));
    }
    Ok(learnt)
}

/// What can learn the dialogue on a CAN bus.
fn of_bus(bus: &str, definitions: &Definitions<'_>, manner: Manner) -> Result<Box<dyn Pupil>> {
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
    Ok(Box::new(by_frames::Learner::new(definition.answers().to_vec())))
}

/// What can learn the dialogue on a serial line.
fn of_line(bus: &str, definitions: &Definitions<'_>, manner: Manner) -> Result<Box<dyn Pupil>> {
    let Some(protocol) = definitions.serial(bus)? else {
        if manner.error {
            return usage(format!(
                "--unknown error: without a definition nobody knows the error answer of {bus}; \
                 name one with --decode {bus}=PROTOCOL"
            ));
        }
        output::note(&format!("{bus} has no protocol: requests are known by all their bytes"));
        return Ok(Box::new(by_bytes::Learner::default()));
    };
    if manner.error && !protocol.has_error_answer() {
        return usage(format!(
            "--unknown error: the definition {} has no [error_answer]",
            protocol.name
        ));
    }
    Ok(Box::new(by_meaning::Learner::new(Arc::new(protocol))))
}

/// Lets `pupil` hear the bus. True if some of it cannot be read, which is said.
fn teach(pupil: &mut dyn Pupil, plan: &Plan, recording: &Recording, bus: &str) -> bool {
    let topics = [format!("/{bus}/raw"), format!("/{bus}/gaps")];
    let range = plan.feed.range.clone();
    let mut entries = recording.entries(range, |topic| topics.iter().any(|own| own == topic));
    for entry in entries.by_ref() {
        if let Entry::Frame(_, frame) = entry.value {
            pupil.take(entry.time, &frame);
        }
    }
    for sentence in entries.damage() {
        output::warning(sentence);
    }
    !entries.damage().is_empty()
}
