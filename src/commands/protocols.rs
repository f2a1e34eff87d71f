//! `bustape protocols`: the files that decoding goes by.

mod can;
mod layout;
mod list;
mod rules;
mod serial;
mod show;

use std::io::{Read as _, Write as _};
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::{Ended, UsageError, output};
use crate::cli::{CheckArgs, ProtocolsArgs, ProtocolsCommand};
use crate::decode::dbc::{self, Oddities, Oddity};
use crate::decode::definition::CanDefinition;
use crate::decode::protocol::CanProtocol;
use crate::decode::rules::Rules;
use crate::protocol::{BUILT_IN, Protocol};
use crate::text::{grouped, printable, printable_json};

/// Runs the command.
pub fn run(args: &ProtocolsArgs) -> Result<Ended> {
    match &args.command {
        ProtocolsCommand::Check(args) => check(args),
        ProtocolsCommand::List(args) => list::run(args),
        ProtocolsCommand::Show(args) => show::run(args),
        ProtocolsCommand::Layout(args) => layout::run(args),
    }
}

/// What a PROTOCOL of either kind defines.
pub enum Definition {
    /// A DBC file, with its rules if there are any.
    Can(Box<CanDefinition>),
    /// A definition in TOML.
    Serial(Box<Protocol>),
}

impl Definition {
    fn kind(&self) -> &'static str {
        match self {
            Self::Can(_) => "can",
            Self::Serial(_) => "serial",
        }
    }

    fn title(&self) -> String {
        match self {
            Self::Can(definition) => definition.title().map_or_else(
                // The first sentence: a comment may be as long as the whole manual.
                || definition.database().comment.split(". ").next().unwrap_or_default().to_owned(),
                str::to_owned,
            ),
            Self::Serial(protocol) => protocol.title.clone().unwrap_or_default(),
        }
    }

    /// Messages and signals, or commands and fields.
    fn counts(&self) -> (usize, usize) {
        match self {
            Self::Can(definition) => (definition.messages().len(), signals(definition)),
            Self::Serial(protocol) => {
                let fields = protocol.commands.iter().map(|command| command.fields.fields.len());
                (protocol.commands.len(), fields.sum())
            }
        }
    }

    /// What they are called.
    fn words(&self) -> [&'static str; 2] {
        match self {
            Self::Can(_) => ["messages", "signals"],
            Self::Serial(_) => ["commands", "fields"],
        }
    }
}

/// The definition a person means, of either kind.
fn load_any(text: &str) -> Result<Definition> {
    if let Some(protocol) = super::explain::serial::load(text)? {
        return Ok(Definition::Serial(Box::new(protocol)));
    }
    let CanFiles { definition, oddities, .. } = load(&named(text)?)?;
    if oddities.lost() > 0 {
        output::warning(&format!(
            "{} things in it could not be loaded; \"bustape protocols check {text}\" lists them",
            oddities.lost()
        ));
    }
    Ok(Definition::Can(Box::new(definition)))
}

/// The files of a definition, byte by byte, and their names.
fn source(text: &str) -> Result<Vec<(String, Vec<u8>)>> {
    // Without settings, which no file name has behind its ending.
    let name = text.split_once(':').map_or(text, |(name, _)| name);
    if let Some((_, definition)) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name) {
        return Ok(vec![(format!("{name}.toml"), definition.as_bytes().to_vec())]);
    }
    if super::explain::serial::load(text)?.is_some() {
        return Ok(vec![(name.to_owned(), read(Path::new(name))?)]);
    }
    Ok(load(&named(text)?)?.files)
}

/// The protocol a person means.
pub fn named(text: &str) -> Result<CanProtocol> {
    match CanProtocol::parse(text) {
        Some(Ok(protocol)) => Ok(protocol),
        Some(Err(why)) => Err(UsageError(why).into()),
        None => {
            let text = format!(
                "\"{text}\" is no protocol; give hmi-can, zhongheng-09, a .dbc or a .toml file"
            );
            Err(UsageError(text).into())
        }
    }
}

/// A protocol for CAN, ready to decode with, and the files it was made of.
#[derive(Debug)]
pub struct CanFiles {
    /// What frames mean.
    pub definition: CanDefinition,
    /// What was odd about the DBC file.
    pub oddities: Oddities,
    /// The DBC file's name in messages.
    pub database: String,
    /// Each file's name and content, byte by byte: the DBC file, then the rules if there are any.
    pub files: Vec<(String, Vec<u8>)>,
}

/// Reads and parses it.
pub fn load(protocol: &CanProtocol) -> Result<CanFiles> {
    let name = protocol.name();
    match protocol {
        CanProtocol::BuiltIn { name, database, rules } => {
            let rules = (format!("{name}.toml"), rules.as_bytes().to_vec());
            with_rules(rules, |dbc| Ok((dbc.to_owned(), database.as_bytes().to_vec())))
        }
        CanProtocol::Rules { path } => {
            let folder = path.parent().unwrap_or(Path::new(""));
            with_rules((name, read(path)?), |dbc| {
                let path = folder.join(dbc);
                Ok((path.display().to_string(), read(&path)?))
            })
        }
        CanProtocol::File { path, j1939 } => {
            let bytes = read(path)?;
            let parsed = dbc::parse(&bytes).with_context(|| format!("cannot use {name}"))?;
            Ok(CanFiles {
                definition: CanDefinition::of_database(&stem(path), parsed.database, *j1939),
                oddities: parsed.oddities,
                database: name.clone(),
                files: vec![(name, bytes)],
            })
        }
    }
}

/// Joins rules to the DBC file that they name.
fn with_rules(
    (name, bytes): (String, Vec<u8>),
    read: impl FnOnce(&str) -> Result<(String, Vec<u8>)>,
) -> Result<CanFiles> {
    let text = str::from_utf8(&bytes).with_context(|| format!("{name} is not UTF-8 text"))?;
    let rules = Rules::read(&name, text)?;
    let (database, dbc) = read(rules.dbc()).with_context(|| format!("cannot use {name}"))?;
    let parsed = dbc::parse(&dbc).with_context(|| format!("cannot use {database}"))?;
    Ok(CanFiles {
        definition: rules.join(parsed.database)?,
        oddities: parsed.oddities,
        files: vec![(database.clone(), dbc), (name, bytes)],
        database,
    })
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

// Reads one byte more than is allowed, so that the parser sees what is too large.
fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let limit = dbc::MAX_FILE as u64 + 1;
    std::fs::File::open(path)
        .and_then(|file| file.take(limit).read_to_end(&mut bytes))
        .with_context(|| format!("cannot read {}", path.display()))?;
    Ok(bytes)
}

/// `FILE:LINE: TEXT`.
pub fn oddity_text(name: &str, oddity: &Oddity) -> String {
    format!("{name}:{}: {}", oddity.line, oddity.text)
}

fn check(args: &CheckArgs) -> Result<Ended> {
    if let Some(protocol) = super::explain::serial::load(&args.protocol)? {
        return check_serial(&args.protocol, &protocol, args.json);
    }
    let protocol = named(&args.protocol)?;
    let loaded = load(&protocol)?;
    let mut out = output::stdout();
    if args.json {
        writeln!(out, "{}", printable_json(&summary_json(&protocol.name(), &loaded).to_string()))?;
    } else {
        print(&mut out, &protocol.name(), &loaded)?;
    }
    out.flush()?;
    Ok(if loaded.oddities.lost() > 0 { Ended::WithLoss } else { Ended::Well })
}

/// A definition of a serial protocol loads as a whole or not at all.
fn check_serial(name: &str, protocol: &Protocol, as_json: bool) -> Result<Ended> {
    let commands = protocol.commands.len();
    let mut out = output::stdout();
    if as_json {
        let report = json!({ "protocol": name, "commands": commands });
        writeln!(out, "{}", printable_json(&report.to_string()))?;
    } else {
        writeln!(out, "{}: {} commands; no faults", printable(name), grouped(commands as u64))?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn print(out: &mut impl std::io::Write, name: &str, loaded: &CanFiles) -> Result<()> {
    let CanFiles { definition, oddities, database, .. } = loaded;
    for oddity in oddities.list() {
        writeln!(out, "{}", printable(&oddity_text(database, oddity)))?;
    }
    if oddities.unlisted() > 0 {
        writeln!(out, "and {} more", grouped(oddities.unlisted()))?;
    }
    let rules = [
        (definition.remotes().len(), "remote"),
        (definition.contexts(), "context"),
        (definition.assemblies().len(), "assembly"),
    ];
    let rules = rules.iter().filter(|(count, _)| *count > 0);
    let rules: Vec<_> = rules.map(|(count, kind)| format!(", {count} {kind} rules")).collect();
    writeln!(
        out,
        "{}: {} messages, {} signals{}; {} oddities, {} of them could not be loaded",
        printable(name),
        grouped(definition.messages().len() as u64),
        grouped(signals(definition) as u64),
        rules.concat(),
        grouped(oddities.list().len() as u64 + oddities.unlisted()),
        grouped(oddities.lost()),
    )?;
    Ok(())
}

fn signals(definition: &CanDefinition) -> usize {
    definition.messages().iter().map(|message| message.signals.len()).sum()
}

fn summary_json(name: &str, loaded: &CanFiles) -> serde_json::Value {
    let CanFiles { definition, oddities, .. } = loaded;
    let list: Vec<_> = oddities
        .list()
        .iter()
        .map(|oddity| json!({ "line": oddity.line, "text": oddity.text, "lost": oddity.lost }))
        .collect();
    let files: Vec<_> = loaded
        .files
        .iter()
        .map(|(name, bytes)| json!({ "name": name, "bytes": bytes.len() }))
        .collect();
    json!({
        "protocol": name,
        "files": files,
        "version": definition.database().version,
        "nodes": definition.database().nodes,
        "messages": definition.messages().len(),
        "signals": signals(definition),
        "remotes": definition.remotes().len(),
        "contexts": definition.contexts(),
        "assemblies": definition.assemblies().len(),
        "oddities": list,
        "oddities_not_listed": oddities.unlisted(),
        "lost": oddities.lost(),
    })
}
