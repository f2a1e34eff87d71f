//! Names in conditions become numbers of buses, messages and signals, before anything is recorded.

use std::sync::Arc;

use super::rule::Rule;
use super::watch::{Probe, Triggers, Watched};
use super::{Condition, TriggerForm, What};
use crate::decode::bus::CanBus;
use crate::decode::definition::CanDefinition;
use crate::text::parse_duration;

type Buses<'a> = &'a [(String, Option<Arc<CanDefinition>>)];

/// Names that are at least so much alike are meant (Jaro-Winkler, 0 to 1).
const ALIKE: f64 = 0.7;

/// See [`Triggers::new`].
pub fn triggers(forms: &[TriggerForm], buses: Buses<'_>) -> Result<Triggers, String> {
    let watched = buses.iter().map(|(name, definition)| Watched {
        name: name.clone(),
        can: definition.clone().map(CanBus::new),
        messages: vec![Vec::new(); definition.as_ref().map_or(0, |d| d.messages().len())],
        ..Watched::default()
    });
    let mut triggers = Triggers { rules: Vec::new(), buses: watched.collect() };
    for form in forms {
        let named = form.name.as_deref().unwrap_or(&form.when);
        add(form, buses, &mut triggers).map_err(|why| format!("trigger {named}: {why}"))?;
    }
    Ok(triggers)
}

fn add(form: &TriggerForm, buses: Buses<'_>, triggers: &mut Triggers) -> Result<(), String> {
    let name = form.name.clone().unwrap_or_else(|| form.when.clone());
    let mut rule = Rule::new(name, form.when.clone());
    if let Some(time) = &form.hold_off {
        rule.hold_off = u64::try_from(parse_duration(time)?.as_nanos()).unwrap_or(u64::MAX);
    }
    rule.has_until = form.until.is_some();
    rule.run.clone_from(&form.run);
    let number = triggers.rules.len();
    let when = Condition::parse(&form.when)?;
    if let What::Silence { nanos, .. } = when.what {
        rule.silence = Some(nanos);
    }
    enter(&when, false, number, buses, &mut triggers.buses)?;
    if let Some(until) = &form.until {
        let until = Condition::parse(until)?;
        if !matches!(until.what, What::Signal { .. } | What::Message(_)) {
            return Err("until has to be a message, or a comparison with a signal".to_owned());
        }
        if rule.silence.is_some() {
            return Err("a silence ends with the next message; it has no until".to_owned());
        }
        enter(&until, true, number, buses, &mut triggers.buses)?;
    }
    triggers.rules.push(rule);
    Ok(())
}

fn enter(
    condition: &Condition,
    until: bool,
    rule: usize,
    buses: Buses<'_>,
    watched: &mut [Watched],
) -> Result<(), String> {
    let about = about(condition.bus.as_deref(), buses)?;
    let (message, signal) = match &condition.what {
        What::Gap => {
            for bus in about {
                watched[bus].gaps.push(rule);
            }
            return Ok(());
        }
        What::ErrorFrame => {
            for bus in about {
                watched[bus].error_frames.push(rule);
            }
            return Ok(());
        }
        What::Silence { message: None, .. } => {
            for bus in about {
                watched[bus].frames.push(rule);
            }
            return Ok(());
        }
        What::Silence { message: Some(message), .. } | What::Message(message) => (message, None),
        What::Signal { message, signal, comparison, value } => {
            (message, Some((signal, *comparison, *value)))
        }
    };
    let mut found = false;
    for (bus, definition) in
        about.iter().filter_map(|bus| Some((*bus, buses.get(*bus)?.1.as_ref()?)))
    {
        let of_name = definition.messages().iter().enumerate();
        for (index, known) in of_name.filter(|(_, known)| known.name == *message) {
            found = true;
            let signal = match signal {
                None => None,
                Some((name, comparison, value)) => {
                    let names = known.signals.iter().map(|signal| signal.name.as_str());
                    let at = names.clone().position(|known| known == name);
                    let what = format!("{message} has no signal {name}");
                    Some((at.ok_or_else(|| suggest(&what, name, names))?, comparison, value))
                }
            };
            watched[bus].messages[index].push(Probe { rule, until, signal });
        }
    }
    if found { Ok(()) } else { Err(unknown(message, &about, buses)) }
}

/// The buses that a condition is about.
fn about(bus: Option<&str>, buses: Buses<'_>) -> Result<Vec<usize>, String> {
    let Some(bus) = bus else { return Ok((0..buses.len()).collect()) };
    let names = buses.iter().map(|(name, _)| name.as_str());
    let at = names.clone().position(|name| name == bus);
    at.map(|at| vec![at]).ok_or_else(|| suggest(&format!("there is no bus {bus}"), bus, names))
}

fn unknown(message: &str, about: &[usize], buses: Buses<'_>) -> String {
    let about = about.iter().filter_map(|bus| buses.get(*bus));
    let definitions: Vec<_> = about.filter_map(|(_, definition)| definition.as_ref()).collect();
    if definitions.is_empty() {
        return format!(
            "nobody knows the message {message}: no CAN bus that it could be on is decoded; say with \
             which protocol, as in decode = [\"can0=car.dbc\"]"
        );
    }
    let names = definitions.iter().flat_map(|definition| definition.messages());
    let names = names.map(|message| message.name.as_str());
    suggest(&format!("there is no message {message}"), message, names)
}

fn suggest<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let likeness = |known: &str| strsim::jaro_winkler(&name.to_lowercase(), &known.to_lowercase());
    let nearest = known.max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    match nearest.filter(|known| likeness(known) >= ALIKE) {
        Some(known) => format!("{what}; did you mean {known}?"),
        None => what.to_owned(),
    }
}
