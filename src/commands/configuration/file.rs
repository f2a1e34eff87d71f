//! Reads a configuration file.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context as _, Result};
use clap::{Arg, ArgAction, Command};
use toml::de::{DeTable, DeValue};

use super::keys;
use crate::commands::UsageError;
use crate::trigger::TriggerForm;

/// A file beyond this many bytes is not a configuration.
const MAX_FILE: u64 = 1 << 20;
/// Keys that are at least so much alike are meant (Jaro-Winkler, 0 to 1).
const ALIKE: f64 = 0.7;

/// What a file says of one option.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The option's long name; `bus` for the buses.
    pub key: String,
    /// `None` for a switch that is on.
    values: Option<Vec<String>>,
    /// File and line, for errors.
    pub place: String,
}

impl Setting {
    /// As it would be typed.
    pub fn as_typed(&self) -> Vec<String> {
        match (self.key.as_str(), &self.values) {
            ("bus", values) => values.clone().unwrap_or_default(),
            (key, None) => vec![format!("--{key}")],
            (key, Some(values)) => values.iter().map(|value| format!("--{key}={value}")).collect(),
        }
    }
}

/// The one key that is no option.
const TRIGGER: &str = "trigger";

/// The triggers of a file, beside what else is in it.
#[derive(serde::Deserialize)]
struct Waiting {
    #[serde(default)]
    trigger: Vec<TriggerForm>,
}

/// Reads `path`. What it may say is what `record` knows, and triggers.
pub fn read(path: &Path, record: &Command) -> Result<(Vec<Setting>, Option<Vec<TriggerForm>>)> {
    let name = path.display();
    let about = || format!("cannot read the configuration {name}");
    let bytes = path.metadata().with_context(about)?.len();
    if bytes > MAX_FILE {
        return Err(UsageError(format!("{name} is no configuration: it has {bytes} bytes")).into());
    }
    let text = std::fs::read_to_string(path).with_context(about)?;
    let file = File { path, text: &text };
    let table = DeTable::parse(&text).map_err(|error| file.toml(&error))?;
    let (mut settings, mut triggers) = (Vec::new(), None);
    for (key, value) in table.get_ref() {
        if key.get_ref().as_ref() == TRIGGER {
            file.check_keys_of_triggers(value.get_ref())?;
            let waiting = toml::from_str::<Waiting>(&text).map_err(|error| file.toml(&error))?;
            triggers = Some(waiting.trigger);
            continue;
        }
        let option = keys(record).find(|(known, _)| *known == key.get_ref().as_ref());
        let Some((known, arg)) = option else {
            return Err(file.unknown(key.get_ref(), key.span(), record));
        };
        let values = values(value.get_ref(), arg)
            .map_err(|expected| file.wrong(value.span(), &format!("{known} must be {expected}")))?;
        let Some(values) = values else { continue };
        settings.push(Setting { key: known.to_owned(), values, place: file.place(&key.span()) });
    }
    Ok((settings, triggers))
}

/// The values of an option, `Some(None)` for a switch that is on, `None` for one that is off. The
/// error is what is expected.
fn values(value: &DeValue<'_>, arg: &Arg) -> Result<Option<Option<Vec<String>>>, &'static str> {
    match (arg.get_action(), value) {
        (ArgAction::SetTrue, DeValue::Boolean(on)) => Ok(on.then_some(None)),
        (ArgAction::SetTrue, _) => Err("true or false"),
        (ArgAction::Append, DeValue::Array(list)) => {
            let texts = list.iter().map(|value| plain(value.get_ref())).collect::<Option<Vec<_>>>();
            // Nothing that begins so is a bus, and it would be taken for an option.
            let texts = texts.filter(|texts| !texts.iter().any(|text| text.starts_with('-')));
            let texts = texts.ok_or("a list of texts, none of which begins with \"-\"");
            texts.map(|texts| Some(Some(texts)))
        }
        (ArgAction::Append, _) => Err("a list, as in [\"one\", \"two\"]"),
        (_, value) => plain(value).map(|text| Some(Some(vec![text]))).ok_or("a text or a number"),
    }
}

fn plain(value: &DeValue<'_>) -> Option<String> {
    match value {
        DeValue::String(text) => Some(text.to_string()),
        DeValue::Integer(number) => Some(number.to_string()),
        DeValue::Float(number) => Some(number.to_string()),
        _ => None,
    }
}

/// The key that was probably meant.
fn nearest<'a>(key: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let likeness = |known: &str| strsim::jaro_winkler(key, known);
    let nearest = known.max_by(|a, b| likeness(a).total_cmp(&likeness(b)));
    nearest.filter(|known| likeness(known) >= ALIKE)
}

struct File<'a> {
    path: &'a Path,
    text: &'a str,
}

impl File<'_> {
    fn place(&self, span: &Range<usize>) -> String {
        let before = self.text.as_bytes().get(..span.start).unwrap_or_default();
        let line = before.split(|byte| *byte == b'\n').count();
        format!("{}, line {line}", self.path.display())
    }

    fn toml(&self, error: &toml::de::Error) -> anyhow::Error {
        self.wrong(error.span().unwrap_or(0..0), error.message())
    }

    fn wrong(&self, span: Range<usize>, text: &str) -> anyhow::Error {
        UsageError(format!("{}: {text}", self.place(&span))).into()
    }

    fn unknown(&self, key: &str, span: Range<usize>, record: &Command) -> anyhow::Error {
        let nearest = nearest(key, keys(record).map(|(known, _)| known));
        let text = match nearest {
            Some(known) => format!("there is no key \"{key}\"; did you mean \"{known}\"?"),
            None => {
                format!("there is no key \"{key}\"; \"bustape record --print-config\" lists them")
            }
        };
        self.wrong(span, &text)
    }

    fn check_keys_of_triggers(&self, value: &DeValue<'_>) -> Result<()> {
        // What is no list of tables is refused by its type.
        let DeValue::Array(list) = value else { return Ok(()) };
        let tables = list.iter().filter_map(|value| match value.get_ref() {
            DeValue::Table(table) => Some(table),
            _ => None,
        });
        for key in tables.flat_map(|table| table.keys()) {
            let name = key.get_ref().as_ref();
            if TriggerForm::KEYS.contains(&name) {
                continue;
            }
            let text = match nearest(name, TriggerForm::KEYS.into_iter()) {
                Some(known) => format!("a trigger has no {name}; did you mean \"{known}\"?"),
                None => {
                    format!("a trigger has no {name}, only {}", TriggerForm::KEYS.join(", "))
                }
            };
            return Err(self.wrong(key.span(), &text));
        }
        Ok(())
    }
}
