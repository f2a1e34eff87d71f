//! What of a bus is played, and under which names: the options that name a bus.

use std::sync::Arc;

use anyhow::Result;

use super::definitions::Definitions;
use super::plan::{Carries, Plan};
use super::usage;
use crate::capture::socketcan::CanSettings;
use crate::cli::replay::ReplayArgs;
use crate::frame::Direction;
use crate::replay::select::{Selection, Which, identifier};
use crate::replay::target::{TargetAddress, TargetSpec};

/// What is played of the bus of `spec`.
pub fn selection(
    args: &ReplayArgs,
    spec: &TargetSpec,
    carries: Carries,
    definitions: &Definitions<'_>,
) -> Result<Selection> {
    let bus = &spec.bus;
    let mut selection = Selection {
        error_frames: spec.address == TargetAddress::Trace,
        only: only(args, bus)?,
        filters: filters(args, bus, carries)?,
        messages: messages(args, bus),
        remap: remaps(args, bus)?,
        definition: None,
    };
    let by_name = selection.remap.iter().any(|(which, ..)| matches!(which, Which::Message(_)));
    if carries == Carries::Can && (by_name || !selection.messages.is_empty()) {
        name_messages(&mut selection, bus, definitions)?;
    }
    Ok(selection)
}

/// All filters of the bus together, as candump takes them.
fn filters(args: &ReplayArgs, bus: &str, carries: Carries) -> Result<CanSettings> {
    let mut all = String::from("x");
    let mut given = args.filters.iter().map(|text| text.split_once(',').unwrap_or((text, "")));
    while let Some((_, filters)) = given.find(|(name, _)| *name == bus) {
        if filters.is_empty() || carries != Carries::Can {
            return usage(format!(
                "--filter for {bus}: write it as {bus},123:7FF; only CAN buses have filters"
            ));
        }
        all.push(',');
        all.push_str(filters);
    }
    all.parse().or_else(|error| usage(format!("--filter for {bus}: {error}")))
}

fn messages(args: &ReplayArgs, bus: &str) -> Vec<String> {
    let of_bus = |text: &String| match text.split_once(':') {
        Some((name, message)) => (name == bus).then(|| message.to_owned()),
        None => Some(text.clone()),
    };
    args.messages.iter().filter_map(of_bus).collect()
}

fn remaps(args: &ReplayArgs, bus: &str) -> Result<Vec<(Which, u32, bool)>> {
    let mut remaps = Vec::new();
    for text in &args.remap {
        let Some((old, new)) = remap(text, bus)? else { continue };
        let Some((id, extended)) = identifier(new) else {
            return usage(format!(
                "--remap {text}: \"{new}\" is no identifier; write 3 hexadecimal digits for 11 \
                 bits, 8 for 29"
            ));
        };
        remaps.push((Which::parse(old), id, extended));
    }
    Ok(remaps)
}

/// Finds the database that tells messages apart, and checks that it has those asked for.
fn name_messages(
    selection: &mut Selection,
    bus: &str,
    definitions: &Definitions<'_>,
) -> Result<()> {
    let Some(definition) = definitions.can(bus)? else {
        return usage(format!(
            "messages of {bus} have no names without a database; name it with --decode \
             {bus}=PROTOCOL"
        ));
    };
    let renamed = selection.remap.iter().filter_map(|(which, ..)| match which {
        Which::Message(name) => Some(name),
        Which::Id { .. } => None,
    });
    for name in selection.messages.iter().chain(renamed) {
        let remote = definition.remotes().iter().any(|remote| remote.name == *name);
        if !remote && !definition.messages().iter().any(|message| message.name == *name) {
            return usage(format!("the database of {bus} has no message {name}"));
        }
    }
    selection.definition = Some(Arc::new(definition));
    Ok(())
}

fn only(args: &ReplayArgs, bus: &str) -> Result<Option<Direction>> {
    let mut only = None;
    for text in &args.only {
        let (name, way) = match text.split_once(':') {
            Some((name, way)) => (Some(name), way),
            None => (None, text.as_str()),
        };
        let way = match way {
            "rx" => Direction::Rx,
            "tx" => Direction::Tx,
            _ => return usage(format!("--only {text}: write rx or tx, or BUS:rx")),
        };
        if name.is_none_or(|name| name == bus) {
            only = Some(way);
        }
    }
    Ok(only)
}

/// `BUS:OLD=NEW` of this bus.
fn remap<'a>(text: &'a str, bus: &str) -> Result<Option<(&'a str, &'a str)>> {
    let Some((old, new)) = text.split_once('=') else {
        return usage(format!("--remap {text}: write it as BUS:OLD=NEW"));
    };
    match old.split_once(':') {
        Some((name, old)) if name == bus => Ok(Some((old, new))),
        _ => Ok(None),
    }
}

/// The name of a bus in a trace.
pub fn shown_name(args: &ReplayArgs, bus: &str) -> String {
    let mut renamed = args.remap.iter().filter_map(|text| text.split_once('='));
    renamed.find(|(old, _)| *old == bus).map_or(bus, |(_, new)| new).to_owned()
}

/// Options that name a bus must name one that is played; those of CAN frames one that has some.
pub fn check_options(args: &ReplayArgs, plan: &Plan) -> Result<()> {
    let named = |text: &str, end: &[char]| text.split(end).next().unwrap_or_default().to_owned();
    for text in &args.filters {
        if !text.contains(',') {
            return usage(format!("--filter {text}: write it as BUS,123:7FF, e.g. can0,123:7FF"));
        }
        played(plan, "filter", text, &named(text, &[',']))?;
    }
    for text in args.only.iter().filter(|text| text.contains(':')) {
        played(plan, "only", text, &named(text, &[':']))?;
    }
    for text in &args.remap {
        let carries = played(plan, "remap", text, &named(text, &[':', '=']))?;
        let identifiers = text.split('=').next().is_some_and(|old| old.contains(':'));
        if identifiers && carries != Carries::Can {
            return usage(format!("--remap {text}: a serial line has no identifiers"));
        }
    }
    for text in &args.messages {
        let is_can = match text.split_once(':') {
            Some((bus, _)) => played(plan, "message", text, bus)? == Carries::Can,
            None => (0..plan.feed.buses.len()).any(|bus| plan.carries(bus) == Carries::Can),
        };
        if !is_can {
            return usage(format!(
                "--message {text}: only CAN buses have messages to choose from, and none is played"
            ));
        }
    }
    Ok(())
}

/// What the bus called `name` carries, if it is one that is played.
fn played(plan: &Plan, option: &str, text: &str, name: &str) -> Result<Carries> {
    match plan.buses().find(|(_, bus, _)| *bus == name) {
        None => usage(format!("--{option} {text}: there is no --to for {name}")),
        Some((bus, ..)) if plan.answers(bus) => usage(format!(
            "--{option} {text}: {name} is answered, so nothing of it is played that could be chosen"
        )),
        Some((bus, ..)) => Ok(plan.carries(bus)),
    }
}
