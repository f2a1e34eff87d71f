//! Error frames by class.

use std::collections::BTreeMap;

use anyhow::Result;

use crate::commands::output;
use crate::frame::error::CLASSES;
use crate::recording::message::decode_can_error;
use crate::recording::reader::{Entry, Recording};
use crate::text::grouped;

/// How many error frames of each class each bus has; one may be of several.
pub struct Errors(BTreeMap<String, BTreeMap<&'static str, u64>>);

impl Errors {
    /// Counts them. Only chunks that hold one are read.
    pub fn of(recording: &Recording) -> Self {
        let mut errors = Self(BTreeMap::new());
        for entry in recording.entries(Recording::ALL, |topic| topic.ends_with("/errors")) {
            let Entry::Message { segment, channel, data } = entry.value else { continue };
            let segment = &recording.segments[segment];
            let Some(channel) = segment.channels.get(&channel) else { continue };
            let schema = segment.schemas.get(&channel.schema);
            let ours = schema.is_some_and(|schema| schema.name == "bustape.CanError");
            let (Some(bus), true) = (channel.metadata.get("bus"), ours) else { continue };
            let Some(classes) = decode_can_error(&data) else { continue };
            let of_bus = errors.0.entry(bus.clone()).or_default();
            for (_, _, name) in CLASSES.iter().filter(|(_, bit, _)| classes & bit != 0) {
                *of_bus.entry(name).or_default() += 1;
            }
        }
        errors
    }

    /// For a person; nothing where there are none.
    pub fn print(&self, out: &mut impl std::io::Write) -> Result<()> {
        let rows: Vec<Vec<String>> = self
            .0
            .iter()
            .flat_map(|(bus, classes)| {
                let row = |(class, count): (&&str, &u64)| {
                    vec![bus.clone(), (*class).to_owned(), grouped(*count)]
                };
                classes.iter().map(row).collect::<Vec<_>>()
            })
            .collect();
        if !rows.is_empty() {
            output::heading(out, "Error frames")?;
            write!(out, "{}", output::table(&["bus", "class", "frames"], &[2], rows))?;
        }
        Ok(())
    }

    /// For a program.
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!(self.0)
    }
}
