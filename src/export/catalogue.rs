//! The tables of an export: where their rows come from, and how payloads become rows.

use std::collections::HashMap;
use std::sync::Arc;

use super::can_table::CanPlan;
use super::message_table::{Described, MessagePlan};
use super::table::{Row, Table};
use crate::decode::definition::CanDefinition;

/// A database that frames are decoded with.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Compiled.
    pub can: Arc<CanDefinition>,
    /// Its files: names, and SHA-256 in hexadecimal.
    pub files: Vec<(String, String)>,
}

/// Where the rows of a table come from.
#[derive(Clone, Debug)]
enum Origin {
    /// Frames of a bus that are a message of a definition.
    Can { bus: Arc<str>, definition: u32, message: u32 },
    /// A decoded channel.
    Message(Box<(MessagePlan, Table)>),
}

/// How payloads become rows of one table.
#[derive(Clone, Debug)]
pub enum Plan {
    /// Payloads are the data of CAN frames.
    Can(CanPlan),
    /// Payloads are encoded messages.
    Message(MessagePlan),
}

impl Plan {
    /// Makes a row of a payload.
    pub fn row(&self, payload: &[u8], row: &mut Row) {
        match self {
            Self::Can(plan) => plan.row(payload, row),
            Self::Message(plan) => plan.row(payload, row),
        }
    }
}

/// The tables seen so far, by their number. Small, also with thousands of tables: what a table of
/// frames looks like is worked out when it is asked for.
pub struct Catalogue {
    definitions: Vec<Definition>,
    origins: Vec<Origin>,
    /// How many tables have a name; those of decoded channels may share one.
    names: HashMap<(String, String), u32>,
    wanted: Box<dyn Fn(&str) -> bool>,
}

impl Catalogue {
    /// Of messages of `definitions`, with the signals that are `wanted`.
    pub fn new(definitions: Vec<Definition>, wanted: Box<dyn Fn(&str) -> bool>) -> Self {
        Self { definitions, origins: Vec::new(), names: HashMap::new(), wanted }
    }

    /// Adds the table of a message on a bus; its number. `None` when no signal of it is wanted.
    pub fn add(&mut self, bus: &Arc<str>, definition: usize, message: usize) -> Option<u32> {
        let messages = self.definitions.get(definition)?.can.messages();
        let signals = &messages.get(message)?.signals;
        if !signals.iter().any(|signal| (self.wanted)(&signal.name)) {
            return None;
        }
        let (definition, message) = (u32::try_from(definition).ok()?, u32::try_from(message).ok()?);
        self.push(Origin::Can { bus: Arc::clone(bus), definition, message })
    }

    /// Adds the table of a decoded channel; its number. A name that another schema has already gets
    /// a number behind it. `files` are those of its definition, with their SHA-256.
    pub fn add_message(
        &mut self,
        described: &Described<'_>,
        files: &[(String, String)],
    ) -> Option<u32> {
        let (plan, mut table) = MessagePlan::new(described, &self.wanted)?;
        let key = (table.bus.clone(), table.message.clone());
        let count = self.names.entry(key).or_default();
        *count += 1;
        if *count > 1 {
            table.message = format!("{}_{count}", table.message);
        }
        add_files(&mut table, files);
        self.push(Origin::Message(Box::new((plan, table))))
    }

    fn push(&mut self, origin: Origin) -> Option<u32> {
        let number = u32::try_from(self.origins.len()).ok()?;
        self.origins.push(origin);
        Some(number)
    }

    /// How many tables there are.
    pub fn len(&self) -> usize {
        self.origins.len()
    }

    /// True without any.
    pub fn is_empty(&self) -> bool {
        self.origins.is_empty()
    }

    /// What table number `table` looks like, and how payloads become its rows.
    pub fn table(&self, table: u32) -> Option<(Plan, Table)> {
        match self.origins.get(table as usize)? {
            Origin::Can { bus, definition, message } => {
                let definition = self.definitions.get(*definition as usize)?;
                let message = *message as usize;
                let (plan, mut table) = CanPlan::new(&definition.can, message, bus, &self.wanted)?;
                add_files(&mut table, &definition.files);
                Some((Plan::Can(plan), table))
            }
            Origin::Message(known) => {
                let (plan, table) = &**known;
                Some((Plan::Message(plan.clone()), table.clone()))
            }
        }
    }

    /// All tables.
    pub fn tables(&self) -> Vec<Table> {
        let numbers = 0..u32::try_from(self.len()).unwrap_or(u32::MAX);
        numbers.filter_map(|number| self.table(number)).map(|(_, table)| table).collect()
    }
}

/// Says what files a table was decoded with.
fn add_files(table: &mut Table, files: &[(String, String)]) {
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    let hashes: Vec<&str> = files.iter().map(|(_, hash)| hash.as_str()).collect();
    table.facts.push(("definition".to_owned(), names.join(" ")));
    table.facts.push(("definition_sha256".to_owned(), hashes.join(" ")));
}
