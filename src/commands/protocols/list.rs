//! `bustape protocols list`: what is built in.

use std::io::Write as _;

use anyhow::Result;
use serde_json::json;

use super::{Definition, load_any};
use crate::cli::protocols::ListArgs;
use crate::commands::{Ended, output};
use crate::protocol::BUILT_IN;

/// Runs the command.
pub fn run(args: &ListArgs) -> Result<Ended> {
    let mut protocols = Vec::new();
    for name in std::iter::once("hmi-can").chain(BUILT_IN.iter().map(|(name, _)| *name)) {
        protocols.push((name, load_any(name)?));
    }
    let mut out = output::stdout();
    if args.json {
        let list: Vec<_> = protocols
            .iter()
            .map(|(name, definition)| {
                let (entries, values) = definition.counts();
                let [entry, value] = definition.words();
                json!({
                    "name": name,
                    "kind": definition.kind(),
                    "title": definition.title(),
                    entry: entries,
                    value: values,
                })
            })
            .collect();
        writeln!(out, "{}", json!({ "protocols": list }))?;
    } else {
        let rows = protocols.iter().map(|(name, definition)| row(name, definition)).collect();
        write!(out, "{}", output::table(&["name", "kind", "defines", "title"], &[], rows))?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn row(name: &str, definition: &Definition) -> Vec<String> {
    let (entries, values) = definition.counts();
    let [entry, value] = definition.words();
    let defines = format!("{entries} {entry}, {values} {value}");
    vec![name.to_owned(), definition.kind().to_owned(), defines, definition.title()]
}
