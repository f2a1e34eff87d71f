//! `bustape protocols show`: what a definition says, in tables.

use std::io::Write as _;

use anyhow::Result;

use super::{Definition, can, load_any, serial, source};
use crate::cli::protocols::ShowArgs;
use crate::commands::{Ended, UsageError, output};
use crate::text::{printable, printable_json};

/// Runs the command.
pub fn run(args: &ShowArgs) -> Result<Ended> {
    let mut out = output::stdout();
    if args.source {
        let files = source(&args.protocol)?;
        for (name, bytes) in &files {
            if files.len() > 1 {
                output::heading(&mut out, &printable(name))?;
            }
            out.write_all(bytes)?;
        }
        out.flush()?;
        return Ok(Ended::Well);
    }
    let definition = load_any(&args.protocol)?;
    if args.json {
        let object = match (&definition, &args.name) {
            (Definition::Can(can), None) => can::overview_json(&args.protocol, can),
            (Definition::Can(can), Some(name)) => {
                can::show_json(can.database(), find(args, can::find(can, name))?)
            }
            (Definition::Serial(protocol), None) => serial::overview_json(protocol),
            (Definition::Serial(protocol), Some(name)) => {
                serial::command_json(find(args, serial::find(protocol, name))?)
            }
        };
        writeln!(out, "{}", printable_json(&object.to_string()))?;
    } else {
        match (&definition, &args.name) {
            (Definition::Can(can), None) => can::overview(&mut out, can)?,
            (Definition::Can(can), Some(name)) => {
                can::show(&mut out, can.database(), find(args, can::find(can, name))?)?;
            }
            (Definition::Serial(protocol), None) => serial::overview(&mut out, protocol)?,
            (Definition::Serial(protocol), Some(name)) => {
                serial::command(&mut out, find(args, serial::find(protocol, name))?)?;
            }
        }
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn find<T>(args: &ShowArgs, found: Option<T>) -> Result<T> {
    found.ok_or_else(|| {
        let (protocol, name) = (&args.protocol, args.name.as_deref().unwrap_or_default());
        let text = format!(
            "{protocol} defines nothing that is called \"{name}\"; \"bustape protocols show \
             {protocol}\" lists what it defines"
        );
        UsageError(text).into()
    })
}

/// The number that a person wrote as `0x64` or `100`.
pub fn number(text: &str) -> Option<u64> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u64::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

/// How a value is made of its raw number; `-` when it is that number.
pub fn scale(factor: f64, offset: f64) -> String {
    match offset {
        0.0 if (factor - 1.0).abs() < f64::EPSILON => "-".to_owned(),
        0.0 => format!("x {factor}"),
        _ if offset < 0.0 => format!("x {factor} - {}", -offset),
        _ => format!("x {factor} + {offset}"),
    }
}
