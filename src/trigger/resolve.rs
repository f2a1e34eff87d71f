//! Names in conditions become numbers of buses, messages and signals, before anything is recorded.

use super::listener::{Known, Listener};
use super::rule::Rule;
use super::watch::{Triggers, Watched};
use super::{Condition, TriggerForm, What, Window};
use crate::text::parse_duration;

/// Names that are at least so much alike are meant (Jaro-Winkler, 0 to 1).
const ALIKE: f64 = 0.7;

/// See [`Triggers::new`].
pub fn triggers(
    forms: &[TriggerForm],
    buses: Vec<(String, Option<Known>)>,
) -> Result<Triggers, String> {
    let watched = buses.into_iter().map(|(name, known)| Watched {
        name,
        listener: known.map(Listener::new),
        ..Watched::default()
    });
    let buses = watched.collect();
    let mut triggers = Triggers { rules: Vec::new(), buses, marks: Vec::new() };
    for form in forms {
        let named = form.name.as_deref().unwrap_or(&form.when);
        add(form, &mut triggers).map_err(|why| format!("trigger {named}: {why}"))?;
    }
    Ok(triggers)
}

fn add(form: &TriggerForm, triggers: &mut Triggers) -> Result<(), String> {
    let name = form.name.clone().unwrap_or_else(|| form.when.clone());
    let mut rule = Rule::new(name, form.when.clone());
    if let Some(time) = &form.hold_off {
        rule.hold_off = nanos(time)?;
    }
    if form.before.is_some() || form.after.is_some() {
        let time = |time: &Option<String>| time.as_deref().map_or(Ok(0), nanos);
        rule.window = Some(Window { before: time(&form.before)?, after: time(&form.after)? });
    }
    rule.has_until = form.until.is_some();
    rule.run.clone_from(&form.run);
    let number = triggers.rules.len();
    let when = Condition::parse(&form.when)?;
    if let What::Silence { nanos, .. } = when.what {
        rule.silence = Some(nanos);
    }
    if when.what == What::Mark {
        triggers.marks.push(number);
    }
    enter(&when, false, number, &mut triggers.buses)?;
    if let Some(until) = &form.until {
        let until = Condition::parse(until)?;
        if !matches!(until.what, What::Signal { .. } | What::Message(_)) {
            return Err("until has to be a message, or a comparison with a signal".to_owned());
        }
        if rule.silence.is_some() {
            return Err("a silence ends with the next message; it has no until".to_owned());
        }
        enter(&until, true, number, &mut triggers.buses)?;
    }
    triggers.rules.push(rule);
    Ok(())
}

fn nanos(time: &str) -> Result<u64, String> {
    Ok(u64::try_from(parse_duration(time)?.as_nanos()).unwrap_or(u64::MAX))
}

fn enter(
    condition: &Condition,
    until: bool,
    rule: usize,
    watched: &mut [Watched],
) -> Result<(), String> {
    let about = about(condition.bus.as_deref(), watched)?;
    let (message, signal) = match &condition.what {
        What::Mark => return Ok(()),
        What::Gap => {
            for bus in about {
                watched[bus].gaps.push(rule);
            }
            return Ok(());
        }
        What::ErrorFrame(class) => {
            for bus in about {
                watched[bus].error_frames.push((rule, class.clone()));
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
            (message, Some((signal.as_str(), *comparison, *value)))
        }
    };
    let mut found = false;
    for bus in &about {
        let Some(listener) = watched.get_mut(*bus).and_then(|bus| bus.listener.as_mut()) else {
            continue;
        };
        let entered = listener.enter(message, signal, (rule, until));
        if let (Some(Err(names)), Some((name, ..))) = (&entered, signal) {
            let what = format!("{message} has no signal {name}");
            return Err(suggest(&what, name, names.iter().map(String::as_str)));
        }
        found |= entered.is_some();
    }
    if found { Ok(()) } else { Err(unknown(message, &about, watched)) }
}

/// The buses that a condition is about.
fn about(bus: Option<&str>, watched: &[Watched]) -> Result<Vec<usize>, String> {
    let Some(bus) = bus else { return Ok((0..watched.len()).collect()) };
    let names = watched.iter().map(|watched| watched.name.as_str());
    let at = names.clone().position(|name| name == bus);
    at.map(|at| vec![at]).ok_or_else(|| suggest(&format!("there is no bus {bus}"), bus, names))
}

fn unknown(message: &str, about: &[usize], watched: &[Watched]) -> String {
    let about = about.iter().filter_map(|bus| watched.get(*bus)?.listener.as_ref());
    let names: Vec<Vec<String>> = about.map(Listener::names).collect();
    if names.is_empty() {
        return format!(
            "nobody knows the message {message}: no bus that it could be on is decoded; say with \
             which protocol, as in decode = [\"can0=car.dbc\"]"
        );
    }
    let names = names.iter().flatten().map(String::as_str);
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
