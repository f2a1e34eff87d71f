//! What the rules beside a DBC file define, for `bustape protocols show`.

use std::io::Write;

use anyhow::Result;
use serde_json::{Value, json};

use super::can::identifier;
use super::serial;
use crate::commands::output;
use crate::decode::assembly::Assembly;
use crate::decode::definition::RemoteMessage;
use crate::text::printable;

/// A remote frame that is a message.
pub fn remote(out: &mut impl Write, remote: &RemoteMessage) -> Result<()> {
    let id = identifier(remote.id, remote.extended);
    let direction = remote.direction.as_ref().map_or(String::new(), |way| format!(", {way}"));
    let head = format!("{id} {}, remote frame{direction}", remote.name);
    output::heading(out, &printable(&head))?;
    if let Some(title) = &remote.title {
        writeln!(out, "  {}", printable(title))?;
    }
    Ok(())
}

/// The same as [`remote`].
pub fn remote_json(remote: &RemoteMessage) -> Value {
    json!({
        "id": identifier(remote.id, remote.extended),
        "message": remote.name,
        "dir": remote.direction,
        "title": remote.title,
    })
}

/// A message of several frames.
pub fn assembly(out: &mut impl Write, assembly: &Assembly) -> Result<()> {
    let direction = assembly.direction.as_ref().map_or(String::new(), |way| format!(", {way}"));
    let head = format!("{}, {} of several frames{direction}", assembly.name, assembly.kind);
    output::heading(out, &printable(&head))?;
    if let Some(title) = &assembly.title {
        writeln!(out, "  {}", printable(title))?;
    }
    for (name, text) in &assembly.constants {
        writeln!(out, "  {} {}", printable(name), printable(text))?;
    }
    serial::plans(out, assembly.fields.iter().map(|field| &*field.plan))?;
    for field in assembly.fields.iter().filter(|field| field.repeated) {
        writeln!(out, "  {} repeats up to the end", printable(&field.plan.name))?;
    }
    Ok(())
}

/// The same as [`assembly`].
pub fn assembly_json(assembly: &Assembly) -> Value {
    let fields = assembly.fields.iter().map(|field| {
        let mut object = serial::field_json(&field.plan);
        object["repeated"] = field.repeated.into();
        object
    });
    json!({
        "message": &*assembly.name,
        "assembly": &*assembly.kind,
        "dir": assembly.direction,
        "title": assembly.title.as_deref(),
        "fields": fields.collect::<Vec<_>>(),
    })
}
