//! Writes a configuration file.

use anyhow::{Context as _, Result};
use clap::{Arg, ArgAction, ArgMatches, Command};
use toml::Value;

use super::keys;
use crate::trigger::TriggerForm;

/// Columns of a comment.
const WIDTH: usize = 98;

/// What stands in the place of triggers where there are none.
pub const NO_TRIGGERS: &str = "
# What is waited for, as many as there are (docs/triggers.md), behind everything else
# [[trigger]]
# name = \"battery low\"
# when = \"BATMON_3.soc < 20\"
# until = \"BATMON_3.soc > 25\"
# hold-off = \"10m\"
# before = \"60s\"
# after = \"30s\"
# run = [\"logger\", \"battery low\"]
";

/// What is set.
pub fn plain(record: &Command, matches: &ArgMatches) -> String {
    let set = keys(record).filter_map(|(key, arg)| Some(line(key, &value(arg, matches)?)));
    set.collect()
}

/// Everything that can be set, with what it means.
pub fn explained(record: &Command, matches: &ArgMatches) -> String {
    let mut text = String::new();
    for (key, arg) in keys(record) {
        if !text.is_empty() {
            text.push('\n');
        }
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        comment(&help, &mut text);
        match value(arg, matches) {
            Some(value) => text.push_str(&line(key, &value)),
            None => text.extend(["# ", key, " = \"", &placeholder(arg), "\"\n"]),
        }
    }
    text
}

/// The triggers, behind everything else.
pub fn triggers(triggers: &[TriggerForm]) -> Result<String> {
    let tables = triggers.iter().map(|trigger| {
        let table = toml::to_string(trigger).context("a trigger cannot be written as TOML")?;
        Ok(format!("\n[[trigger]]\n{table}"))
    });
    tables.collect()
}

fn line(key: &str, value: &Value) -> String {
    format!("{key} = {value}\n")
}

fn placeholder(arg: &Arg) -> String {
    let names = arg.get_value_names().unwrap_or_default();
    names.first().map(ToString::to_string).unwrap_or_default()
}

fn value(arg: &Arg, matches: &ArgMatches) -> Option<Value> {
    let id = arg.get_id().as_str();
    if matches!(arg.get_action(), ArgAction::SetTrue) {
        return Some(Value::Boolean(matches.get_flag(id)));
    }
    let mut texts = matches.get_raw(id).into_iter().flatten().map(|text| text.to_string_lossy());
    if matches!(arg.get_action(), ArgAction::Append) {
        return Some(Value::Array(texts.map(|text| Value::String(text.into_owned())).collect()));
    }
    let text = texts.next()?;
    // Only what is read as the same text again.
    let number = text.parse::<i64>().ok().filter(|number| number.to_string() == text);
    Some(number.map_or_else(|| Value::String(text.into_owned()), Value::Integer))
}

fn comment(help: &str, out: &mut String) {
    let mut width = 0;
    for word in help.split_whitespace() {
        if width == 0 || width + 1 + word.chars().count() > WIDTH {
            out.push_str(if width == 0 { "#" } else { "\n#" });
            width = 1;
        }
        out.push(' ');
        out.push_str(word);
        width += 1 + word.chars().count();
    }
    out.push('\n');
}
