//! `bustape protocols`: the files that decoding goes by.

use std::io::{Read as _, Write as _};
use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::{Ended, UsageError, output};
use crate::cli::{CheckArgs, ProtocolsArgs, ProtocolsCommand};
use crate::decode::dbc::{self, Oddity, Parsed};
use crate::decode::protocol::CanProtocol;
use crate::text::{grouped, printable};

/// Runs the command.
pub fn run(args: &ProtocolsArgs) -> Result<Ended> {
    match &args.command {
        ProtocolsCommand::Check(args) => check(args),
    }
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
    load_with_bytes(protocol).map(|(parsed, _)| parsed)
}

/// The same, with the bytes of the file.
pub fn load_with_bytes(protocol: &CanProtocol) -> Result<(Parsed, Vec<u8>)> {
    let bytes = match protocol {
        CanProtocol::BuiltIn { text, .. } => text.as_bytes().to_vec(),
        CanProtocol::File { path, .. } => read(path)?,
    };
    let parsed = dbc::parse(&bytes).with_context(|| format!("cannot use {}", protocol.name()))?;
    Ok((parsed, bytes))
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
fn check_serial(name: &str, protocol: &crate::protocol::Protocol, as_json: bool) -> Result<Ended> {
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
