//! The configuration of `bustape record`: files give what the command line does not.
//!
//! A key is an option's long name, and its value goes the way of the option's: what a file says is
//! put on the command line in front of what was typed, and parsed by the same definitions.

mod file;
mod print;

use std::ffi::OsString;
use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::error::{ContextKind, ContextValue};
use clap::parser::ValueSource;
use clap::{Arg, ArgMatches, Command, CommandFactory as _, FromArgMatches as _};

use super::UsageError;
use crate::cli::{self, Cli, RecordArgs};
use crate::recording::definition::Attachment;
use crate::trigger::TriggerForm;
use file::Setting;

/// Name of the attachment with the effective configuration.
pub const ATTACHMENT: &str = "bustape.toml";

/// Where the configuration of the machine is.
const OF_MACHINE: &str = "/etc/bustape/bustape.toml";
/// Options that are about one call only.
const OF_A_CALL: [&str; 5] = ["config", "print-config", "json", "help", "version"];

/// What `record` does, from the command line and files.
pub struct Configured {
    /// All options.
    pub args: RecordArgs,
    /// What is waited for; files only.
    pub triggers: Vec<TriggerForm>,
    matches: ArgMatches,
}

impl Configured {
    /// As a configuration file, with what each option means.
    pub fn explained(&self) -> Result<String> {
        let triggers = match &self.triggers[..] {
            [] => print::NO_TRIGGERS.to_owned(),
            triggers => print::triggers(triggers)?,
        };
        Ok(print::explained(&record(), &self.matches) + &triggers)
    }

    /// As a configuration file, to be attached to each segment.
    pub fn attachment(&self) -> Result<Attachment> {
        let text = print::plain(&record(), &self.matches) + &print::triggers(&self.triggers)?;
        let data = text.into_bytes();
        let media_type = "application/toml".to_owned();
        Ok(Attachment { name: ATTACHMENT.to_owned(), media_type, data })
    }
}

/// Adds what the files say to what was typed.
pub fn configured(typed: &RecordArgs, matches: &ArgMatches) -> Result<Configured> {
    let record = record();
    let Some(matches) = matches.subcommand_matches(record.get_name()) else {
        bail!("the options of record are missing");
    };
    let mut settings: Vec<Setting> = Vec::new();
    let mut triggers = Vec::new();
    for path in files(typed) {
        let (found, waited_for) = file::read(&path, &record)?;
        triggers = waited_for.unwrap_or(triggers);
        settings.retain(|old| !found.iter().any(|new| new.key == old.key));
        settings.extend(found);
    }
    if !typed.buses.is_empty() {
        // What is waited for belongs to the buses.
        triggers.clear();
    }
    settings.retain(|setting| !is_overruled(setting, &record, matches));
    let mut all = vec![OsString::from("bustape"), record.get_name().into()];
    all.extend(settings.iter().flat_map(Setting::as_typed).map(OsString::from));
    all.extend(std::env::args_os().skip(2));
    let parsed = Cli::command().try_get_matches_from(all);
    let parsed = parsed.map_err(|error| explain(error, &settings))?;
    let cli = Cli::from_arg_matches(&parsed).map_err(|error| explain(error, &settings))?;
    let (cli::Command::Record(args), Some((_, matches))) = (cli.command, parsed.subcommand())
    else {
        bail!("the options of record are missing");
    };
    // Without a bus, what is printed is a template.
    if !args.print_config || !args.buses.is_empty() {
        complete(&args)?;
    }
    Ok(Configured { args: *args, triggers, matches: matches.clone() })
}

/// What has no default has to be said somewhere.
fn complete(args: &RecordArgs) -> Result<()> {
    if args.buses.is_empty() {
        bail!(UsageError(
            "there is nothing to record: name at least one <BUS>, or set \"bus\" in a configuration \
             file (see \"bustape record --help\")"
                .to_owned()
        ));
    }
    if args.output.is_none() && args.dir.is_none() {
        bail!(UsageError(
            "there is no place to record to: give one of <--output <FILE>|--dir <DIR>>, or set one \
             in a configuration file"
                .to_owned()
        ));
    }
    Ok(())
}

fn record() -> Command {
    let command = Cli::command();
    command.find_subcommand("record").cloned().unwrap_or(command)
}

/// The files to read; what a later one says counts.
fn files(typed: &RecordArgs) -> Vec<PathBuf> {
    if let Some(file) = &typed.config {
        return vec![file.clone()];
    }
    let folder = std::env::var_os("XDG_CONFIG_HOME").filter(|folder| !folder.is_empty());
    let folder = folder.map(PathBuf::from).or_else(|| {
        let home = std::env::var_os("HOME").filter(|home| !home.is_empty());
        home.map(|home| PathBuf::from(home).join(".config"))
    });
    let own = folder.map(|folder| folder.join("bustape").join(ATTACHMENT));
    let all = [PathBuf::from(OF_MACHINE)].into_iter().chain(own);
    all.filter(|file| file.exists()).collect()
}

/// The options that a file may set, under their keys.
fn keys(record: &Command) -> impl Iterator<Item = (&str, &Arg)> {
    record.get_arguments().filter_map(|arg| match arg.get_long() {
        Some(long) if OF_A_CALL.contains(&long) => None,
        Some(long) => Some((long, arg)),
        None => Some(("bus", arg)),
    })
}

/// True if the command line says something else, or something that excludes it.
fn is_overruled(setting: &Setting, record: &Command, matches: &ArgMatches) -> bool {
    let typed =
        |arg: &Arg| matches.value_source(arg.get_id().as_str()) == Some(ValueSource::CommandLine);
    let Some((_, arg)) = keys(record).find(|(key, _)| *key == setting.key) else { return true };
    // What is decoded belongs to the buses.
    let buses = keys(record).any(|(key, arg)| key == "bus" && typed(arg));
    if typed(arg) || buses && matches!(setting.key.as_str(), "decode" | "windows-only") {
        return true;
    }
    let mut others = keys(record).map(|(_, other)| other).filter(|other| typed(other));
    others.any(|other| excludes(record, arg, other) || excludes(record, other, arg))
}

fn excludes(record: &Command, one: &Arg, other: &Arg) -> bool {
    let mut groups = record.get_groups().cloned();
    let both = [one.get_id(), other.get_id()];
    groups.any(|mut group| {
        !group.is_multiple()
            && both.iter().all(|id| group.get_args().any(|of_group| of_group == *id))
    }) || record.get_arg_conflicts_with(one).iter().any(|arg| arg.get_id() == other.get_id())
}

/// An error of the command line, with the place in the file that it comes from.
fn explain(error: clap::Error, settings: &[Setting]) -> anyhow::Error {
    let invalid = match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(invalid)) => invalid.clone(),
        _ => String::new(),
    };
    let option = invalid.split([' ', '=']).next().unwrap_or_default().trim_start_matches('-');
    let Some(setting) = settings.iter().find(|setting| setting.key == option) else {
        error.exit();
    };
    let text = error.to_string();
    let lines = text.trim_start_matches("error: ").lines().take_while(|line| !line.is_empty());
    let sentence = lines.map(str::trim).collect::<Vec<_>>().join(" ");
    UsageError(format!("{}: {sentence}", setting.place)).into()
}
