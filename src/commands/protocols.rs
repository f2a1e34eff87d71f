//! `bustape protocols`: the files that decoding goes by.

mod can;
mod layout;
mod list;
mod serial;
mod show;

use std::io::{Read as _, Write as _};
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::{Ended, UsageError, output};
use crate::cli::{CheckArgs, ProtocolsArgs, ProtocolsCommand};
use crate::decode::dbc::{self, Database, Oddity, Parsed};
use crate::decode::protocol::CanProtocol;
use crate::protocol::{BUILT_IN, Protocol};
use crate::text::{grouped, printable};

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
    /// A DBC file.
    Can(Database),
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
            // The first sentence: a comment may be as long as the whole manual.
            Self::Can(database) => {
                database.comment.split(". ").next().unwrap_or_default().to_owned()
            }
            Self::Serial(protocol) => protocol.title.clone().unwrap_or_default(),
        }
    }

    /// Messages and signals, or commands and fields.
    fn counts(&self) -> (usize, usize) {
        match self {
            Self::Can(Database { messages, .. }) => {
                (messages.len(), messages.iter().map(|message| message.signals.len()).sum())
            }
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
    let protocol = named(text)?;
    let Parsed { database, oddities } = load(&protocol)?;
    if oddities.lost() > 0 {
        output::warning(&format!(
            "{} things in it could not be loaded; \"bustape protocols check {text}\" lists them",
            oddities.lost()
        ));
    }
    Ok(Definition::Can(database))
}

/// The definition file, byte by byte.
fn source(text: &str) -> Result<Vec<u8>> {
    // Without settings, which no file name has behind its ending.
    let name = text.split_once(':').map_or(text, |(name, _)| name);
    if let Some((_, definition)) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name) {
        return Ok(definition.as_bytes().to_vec());
    }
    if Path::new(name).extension().is_some_and(|extension| extension == "toml") {
        return read(Path::new(name));
    }
    Ok(match named(text)? {
        CanProtocol::BuiltIn { text, .. } => text.as_bytes().to_vec(),
        CanProtocol::File { path, .. } => read(&path)?,
    })
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

/// Reads and parses it.
pub fn load(protocol: &CanProtocol) -> Result<Parsed> {
    let bytes = match protocol {
        CanProtocol::BuiltIn { text, .. } => text.as_bytes().to_vec(),
        CanProtocol::File { path, .. } => read(path)?,
    };
    dbc::parse(&bytes).with_context(|| format!("cannot use {}", protocol.name()))
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
    let parsed = load(&protocol)?;
    let mut out = output::stdout();
    if args.json {
        writeln!(out, "{}", summary_json(&protocol.name(), &parsed))?;
    } else {
        print(&mut out, &protocol.name(), &parsed)?;
    }
    out.flush()?;
    Ok(if parsed.oddities.lost() > 0 { Ended::WithLoss } else { Ended::Well })
}

/// A definition of a serial protocol loads as a whole or not at all.
fn check_serial(name: &str, protocol: &Protocol, as_json: bool) -> Result<Ended> {
    let commands = protocol.commands.len();
    let mut out = output::stdout();
    if as_json {
        writeln!(out, "{}", json!({ "protocol": name, "commands": commands }))?;
    } else {
        writeln!(out, "{}: {} commands; no faults", printable(name), grouped(commands as u64))?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn print(out: &mut impl std::io::Write, name: &str, parsed: &Parsed) -> Result<()> {
    let Parsed { database, oddities } = parsed;
    for oddity in oddities.list() {
        writeln!(out, "{}", printable(&oddity_text(name, oddity)))?;
    }
    if oddities.unlisted() > 0 {
        writeln!(out, "and {} more", grouped(oddities.unlisted()))?;
    }
    let signals: usize = database.messages.iter().map(|message| message.signals.len()).sum();
    writeln!(
        out,
        "{}: {} messages, {} signals; {} oddities, {} of them could not be loaded",
        printable(name),
        grouped(database.messages.len() as u64),
        grouped(signals as u64),
        grouped(oddities.list().len() as u64 + oddities.unlisted()),
        grouped(oddities.lost()),
    )?;
    Ok(())
}

fn summary_json(name: &str, parsed: &Parsed) -> serde_json::Value {
    let Parsed { database, oddities } = parsed;
    let list: Vec<_> = oddities
        .list()
        .iter()
        .map(|oddity| json!({ "line": oddity.line, "text": oddity.text, "lost": oddity.lost }))
        .collect();
    json!({
        "protocol": name,
        "version": database.version,
        "nodes": database.nodes,
        "messages": database.messages.len(),
        "signals": database.messages.iter().map(|message| message.signals.len()).sum::<usize>(),
        "oddities": list,
        "oddities_not_listed": oddities.unlisted(),
        "lost": oddities.lost(),
    })
}
