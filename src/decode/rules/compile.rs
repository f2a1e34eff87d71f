//! Joins rules to their database.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;

use toml::Spanned;

use super::forms::{ContextForm, LevelForm, RemoteForm, Rules, RulesForm};
use super::{answers, assemblies};
use crate::decode::assembly::Assembly;
use crate::decode::can::{CanDecoder, key};
use crate::decode::context::{After, Meaning, Seen};
use crate::decode::dbc::{Database, Format};
use crate::decode::definition::{CanDefinition, Event, RemoteMessage};
use crate::frame::Level;
use crate::protocol::DefinitionError;
use crate::protocol::definition::OneOrMany;
use crate::protocol::definition::values::name;
use crate::protocol::error::Fault;

/// Largest 29-bit and 11-bit identifiers.
const MAX_EXTENDED: u32 = 0x1FFF_FFFF;
const MAX_STANDARD: u32 = 0x7FF;

/// Most rules of each kind.
const MOST: usize = 256;

impl Rules {
    /// Compiles the rules for `database`, which has been read from [`Rules::dbc`].
    pub fn join(self, database: Database) -> Result<CanDefinition, DefinitionError> {
        let Self { file, text, form } = self;
        join(form, database).map_err(|fault| fault.in_file(&file, &text))
    }
}

fn join(mut form: RulesForm, mut database: Database) -> Result<CanDefinition, Fault> {
    let kinds = [
        form.remote.len(),
        form.context.len(),
        form.assembly.len(),
        form.answer.len(),
        form.log.len(),
    ];
    for count in kinds {
        if count > MOST {
            let text = format!("{count} rules of a kind; expected {MOST} at most");
            return Err(Fault { span: None, text });
        }
    }
    let mut names: HashSet<String> = database.messages.iter().map(|m| m.name.clone()).collect();
    let mut remotes = Vec::new();
    for remote in &form.remote {
        remotes.push(self::remote(remote.get_ref(), &remotes, &database, &mut names)?);
    }
    let from_file = database.messages.len();
    for context in &form.context {
        add_meaning(context.get_ref(), &mut database, &mut names)?;
    }
    let added = database.messages.len() - from_file;
    let meanings = form.context.iter().map(|context| meaning(context, &database, &remotes));
    let meanings = meanings.collect::<Result<Vec<_>, _>>()?;
    let answers = answers::compile(&form, &database, &remotes)?;
    let assemblies = assemblies::compile(&mut form, &database, &mut names)?;
    let events = events(&form, &database)?;
    let ruled = ruled(&form, &database, &meanings, &assemblies);
    Ok(CanDefinition {
        name: form.name,
        title: form.title,
        decoder: CanDecoder::with_meanings(database, form.j1939, added),
        remotes,
        meanings,
        assemblies,
        answers,
        ruled,
        events,
    })
}

/// `[[log]]`: by message, sorted; the first rule about a message counts.
fn events(form: &RulesForm, database: &Database) -> Result<Vec<(usize, Event)>, Fault> {
    let messages = database.messages.iter().map(|m| m.name.as_str()).zip(0..);
    let places: HashMap<&str, usize> = messages.collect();
    let mut events = BTreeMap::new();
    for log in form.log.iter().map(Spanned::get_ref) {
        let level = match log.level {
            LevelForm::Info => Level::Info,
            LevelForm::Warning => Level::Warning,
            LevelForm::Error => Level::Error,
        };
        for name in log.messages.get_ref() {
            let Some(&index) = places.get(name.as_str()) else {
                let text = format!("there is no message \"{name}\"; expected one of the database");
                return Err(Fault::at(log.messages.span(), text));
            };
            events.entry(index).or_insert(Event { level, text: log.text.clone() });
        }
    }
    Ok(events.into_iter().collect())
}

/// By message: whether a rule is about its frames.
fn ruled(
    form: &RulesForm,
    database: &Database,
    meanings: &[Meaning],
    assemblies: &[Assembly],
) -> Vec<bool> {
    let messages = database.messages.iter().enumerate();
    let about = |(index, message): (usize, &crate::decode::dbc::Message)| {
        let key = key(message.id, message.extended);
        // Frames of a parameter group have many identifiers.
        let by_group = message.extended && (form.j1939 || message.format == Format::J1939);
        let meant = |m: &Meaning| m.message == index || m.key == key || m.watches(key);
        let part = |a: &Assembly| a.number(key, Some(index)).is_some();
        by_group || meanings.iter().any(meant) || assemblies.iter().any(part)
    };
    messages.map(about).collect()
}

/// An identifier, and whether it has 29 bits: those above 0x7FF have, others when it is said.
fn identifier(id: &Spanned<u32>, extended: Option<bool>) -> Result<(u32, bool), Fault> {
    let extended = extended.unwrap_or(*id.get_ref() > MAX_STANDARD);
    let most = if extended { MAX_EXTENDED } else { MAX_STANDARD };
    if *id.get_ref() <= most {
        return Ok((*id.get_ref(), extended));
    }
    let text = format!("identifier {:#x}; expected {most:#x} at most", id.get_ref());
    Err(Fault::at(id.span(), text))
}

/// A name that no other message has: it becomes a topic and a schema.
pub(super) fn new_name(
    text: &Spanned<String>,
    names: &mut HashSet<String>,
) -> Result<String, Fault> {
    name(text.get_ref(), &text.span())?;
    if names.insert(text.get_ref().clone()) {
        return Ok(text.get_ref().clone());
    }
    let text2 = format!("there is another message \"{}\"; expected a new name", text.get_ref());
    Err(Fault::at(text.span(), text2))
}

/// The place of a message in the database.
pub(super) fn message(text: &Spanned<String>, database: &Database) -> Result<usize, Fault> {
    find(text.get_ref(), &text.span(), database)
}

fn find(wanted: &str, span: &Range<usize>, database: &Database) -> Result<usize, Fault> {
    let found = database.messages.iter().position(|message| message.name == wanted);
    found.ok_or_else(|| {
        let text = format!("there is no message \"{wanted}\"; expected one of the DBC file");
        Fault::at(span.clone(), text)
    })
}

fn remote(
    form: &RemoteForm,
    others: &[RemoteMessage],
    database: &Database,
    names: &mut HashSet<String>,
) -> Result<RemoteMessage, Fault> {
    let (id, extended) = identifier(&form.id, form.extended)?;
    if let Some(other) = others.iter().find(|other| (other.id, other.extended) == (id, extended)) {
        let text = format!("remote frame {id:#x} is \"{}\" already; expected one name", other.name);
        return Err(Fault::at(form.id.span(), text));
    }
    let direction = match &form.sender {
        None => None,
        Some(sender) => Some(direction(sender, &database.nodes)?),
    };
    let name = new_name(&form.name, names)?;
    Ok(RemoteMessage { id, extended, name, title: form.title.clone(), direction })
}

/// From `sender` to the other one of two nodes.
fn direction(sender: &Spanned<String>, nodes: &[String]) -> Result<String, Fault> {
    match nodes {
        [a, b] if a == sender.get_ref() => Ok(format!("{a}-to-{b}")),
        [a, b] if b == sender.get_ref() => Ok(format!("{b}-to-{a}")),
        _ => {
            let text = format!(
                "sender \"{}\"; expected one of the two nodes of the DBC file, which names {}: {}",
                sender.get_ref(),
                nodes.len(),
                nodes.join(", ")
            );
            Err(Fault::at(sender.span(), text))
        }
    }
}

/// Adds the message of a rule that is not in the database yet.
fn add_meaning(
    form: &ContextForm,
    database: &mut Database,
    names: &mut HashSet<String>,
) -> Result<(), Fault> {
    let Some(like) = &form.like else { return Ok(()) };
    let (id, extended) = identifier(&form.id, form.extended)?;
    let mut added = database.messages[message(like, database)?].clone();
    added.id = id;
    added.extended = extended;
    added.name = new_name(&form.message, names)?;
    added.comment = form.title.clone().unwrap_or_default();
    database.messages.push(added);
    Ok(())
}

fn meaning(
    spanned: &Spanned<ContextForm>,
    database: &Database,
    remotes: &[RemoteMessage],
) -> Result<Meaning, Fault> {
    let form = spanned.get_ref();
    let (id, extended) = identifier(&form.id, form.extended)?;
    let lengths = match &form.length {
        None => Vec::new(),
        Some(OneOrMany::One(length)) => vec![*length],
        Some(OneOrMany::Many(lengths)) => lengths.clone(),
    };
    let after = match (&form.after, &form.among) {
        (Some(names), Some(among)) => {
            let (span, names) = (names.span(), names.get_ref());
            let names = match names {
                OneOrMany::One(name) => std::slice::from_ref(name),
                OneOrMany::Many(names) => names,
            };
            let seen = names.iter().map(|name| seen(name, &span, database, remotes));
            let among = among.get_ref();
            Some(After {
                any_of: seen.collect::<Result<_, _>>()?,
                mask: key(among.mask & MAX_EXTENDED, true),
                key: key(among.id & among.mask & MAX_EXTENDED, extended),
                within: form.within_ms.map(|ms| ms.saturating_mul(1_000_000)),
            })
        }
        (None, None) if form.within_ms.is_none() && !lengths.is_empty() => None,
        _ => {
            let text = "a context without a condition; expected length, or after with among";
            return Err(Fault::at(spanned.span(), text));
        }
    };
    let message = message(&form.message, database)?;
    Ok(Meaning { key: key(id, extended), message, lengths, after })
}

fn seen(
    name: &str,
    span: &Range<usize>,
    database: &Database,
    remotes: &[RemoteMessage],
) -> Result<Seen, Fault> {
    match remotes.iter().position(|remote| remote.name == name) {
        Some(remote) => Ok(Seen::Remote(remote)),
        None => find(name, span, database).map(Seen::Message),
    }
}
