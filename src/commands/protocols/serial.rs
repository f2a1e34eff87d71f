//! Commands and fields of a serial protocol, for `bustape protocols show`.

use std::io::Write;

use anyhow::Result;
use serde_json::{Map, Value, json};

use super::show::{number, scale};
use crate::commands::output;
use crate::protocol::payload::{FieldPlan, Payload};
use crate::protocol::word::Values;
use crate::protocol::{Command, Protocol};
use crate::text::printable;

/// The command with this name or number.
pub fn find<'a>(protocol: &'a Protocol, name: &str) -> Option<&'a Command> {
    let named = protocol.commands.iter().find(|command| *command.name == *name);
    let found = named.or_else(|| {
        let id = number(name)?;
        protocol.commands.iter().find(|command| command.ids.contains(&id))
    });
    found.map(AsRef::as_ref)
}

/// All commands, a line each.
pub fn overview(out: &mut impl Write, protocol: &Protocol) -> Result<()> {
    let rows = protocol.commands.iter().map(|command| {
        vec![
            ids(command).join(" "),
            command.name.to_string(),
            command.operations.join(", "),
            bytes(&command.fields),
            command.fields.fields.len().to_string(),
            command.title.clone().unwrap_or_default(),
        ]
    });
    let head = ["id", "command", "operations", "bytes", "fields", "title"];
    write!(out, "{}", output::table(&head, &[3, 4], rows.collect()))?;
    Ok(())
}

/// One command and its fields.
pub fn command(out: &mut impl Write, command: &Command) -> Result<()> {
    let operations = command.operations.join(", ");
    let head = [&ids(command).join(" "), &*command.name, &operations].join(" ");
    output::heading(out, &printable(head.trim()))?;
    if let Some(title) = &command.title {
        writeln!(out, "  {}", printable(title))?;
    }
    if !command.args.fields.is_empty() {
        writeln!(out)?;
        output::heading(out, "Arguments of a request")?;
        fields(out, &command.args)?;
    }
    writeln!(out)?;
    output::heading(out, &format!("Fields, {} bytes", bytes(&command.fields)))?;
    fields(out, &command.fields)
}

fn fields(out: &mut impl Write, payload: &Payload) -> Result<()> {
    plans(out, payload.fields.iter().map(|field| &**field))
}

/// A table of fields.
pub fn plans<'a>(out: &mut impl Write, fields: impl Iterator<Item = &'a FieldPlan>) -> Result<()> {
    let rows = fields.map(|field| {
        vec![
            field.at.to_string(),
            field.name.to_string(),
            kind(field),
            field.scale.map_or("-".to_owned(), |(factor, offset)| scale(factor, offset)),
            field.unit.as_deref().unwrap_or("-").to_owned(),
            field.title.as_deref().unwrap_or_default().to_owned(),
            meanings(field.values.as_deref().or(field.flags.as_deref())),
        ]
    });
    let head = ["offset", "field", "type", "scale", "unit", "title", "values"];
    write!(out, "{}", output::table(&head, &[0], rows.collect()))?;
    Ok(())
}

/// The same as [`overview`].
pub fn overview_json(protocol: &Protocol) -> Value {
    let commands: Vec<Value> = protocol
        .commands
        .iter()
        .map(|command| {
            let mut object = head_json(command);
            object.insert("fields".to_owned(), command.fields.fields.len().into());
            object.into()
        })
        .collect();
    let (name, title) = (&protocol.name, &protocol.title);
    json!({ "protocol": name, "kind": "serial", "title": title, "commands": commands })
}

/// The same as [`command`].
pub fn command_json(command: &Command) -> Value {
    let list = |payload: &Payload| -> Value {
        payload.fields.iter().map(|field| field_json(field)).collect()
    };
    let mut object = head_json(command);
    object.insert("args".to_owned(), list(&command.args));
    object.insert("fields".to_owned(), list(&command.fields));
    object.into()
}

fn head_json(command: &Command) -> Map<String, Value> {
    let pairs = [
        ("ids", json!(ids(command))),
        ("command", json!(*command.name)),
        ("title", json!(command.title)),
        ("operations", json!(command.operations)),
        ("bytes", json!(command.fields.size)),
        ("records", json!(command.fields.records.is_some())),
    ];
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// A field, for a program.
pub fn field_json(field: &FieldPlan) -> Value {
    let table = |values: Option<&Values>| -> Map<String, Value> {
        let pairs = values.into_iter().flatten();
        pairs.map(|(value, text)| (value.to_string(), json!(**text))).collect()
    };
    json!({
        "field": *field.name,
        "offset": field.at,
        "type": kind(field),
        "bytes": field.size,
        "factor": field.scale.map(|(factor, _)| factor),
        "add": field.scale.map(|(_, offset)| offset),
        "unit": field.unit.as_deref(),
        "labels": table(field.values.as_deref()),
        "flags": table(field.flags.as_deref()),
        "title": field.title.as_deref(),
    })
}

fn ids(command: &Command) -> Vec<String> {
    command.ids.iter().map(|id| format!("0x{id:04x}")).collect()
}

/// Bytes of the data, `26 x n` of records.
fn bytes(payload: &Payload) -> String {
    match payload.records {
        Some(_) => format!("{} x n", payload.size),
        None => payload.size.to_string(),
    }
}

/// `u16`, `text 20`.
fn kind(field: &FieldPlan) -> String {
    let name = field.type_name();
    match field.size {
        Some(size) if matches!(&*name, "text" | "bytes") => format!("{name} {size}"),
        _ => name,
    }
}

fn meanings(values: Option<&Values>) -> String {
    let texts = values.into_iter().flatten().map(|(value, text)| format!("{value} {text}"));
    texts.collect::<Vec<String>>().join(", ")
}
