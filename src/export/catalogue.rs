//! The tables of an export: where their rows come from, and how payloads become rows.

use std::sync::Arc;

use super::can_table::CanPlan;
use super::table::{Cell, Row, Table};
use crate::decode::can::CanDecoder;

/// A database that frames are decoded with.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Compiled.
    pub decoder: Arc<CanDecoder>,
    /// As a person knows it, e.g. the name of its file.
    pub name: String,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
}

/// Where the rows of a table come from.
#[derive(Clone, Debug)]
struct Origin {
    bus: Arc<str>,
    definition: u32,
    message: u32,
}

/// How payloads become rows of one table.
#[derive(Clone, Debug)]
pub enum Plan {
    /// Payloads are the data of CAN frames.
    Can(CanPlan),
}

impl Plan {
    /// Gives each value of a payload to `visit`, with its column.
    #[inline]
    pub fn visit(&self, payload: &[u8], visit: impl FnMut(usize, Cell)) {
        match self {
            Self::Can(plan) => plan.visit(payload, visit),
        }
    }

    /// Makes a row of a payload.
    pub fn row(&self, payload: &[u8], row: &mut Row) {
        match self {
            Self::Can(plan) => plan.row(payload, row),
        }
    }
}

/// The tables seen so far, by their number. Small, also with thousands of tables: what a table
/// looks like is worked out when it is asked for.
pub struct Catalogue {
    definitions: Vec<Definition>,
    origins: Vec<Origin>,
    wanted: Box<dyn Fn(&str) -> bool>,
}

impl Catalogue {
    /// Of messages of `definitions`, with the signals that are `wanted`.
    pub fn new(definitions: Vec<Definition>, wanted: Box<dyn Fn(&str) -> bool>) -> Self {
        Self { definitions, origins: Vec::new(), wanted }
    }

    /// The databases.
    pub fn definitions(&self) -> &[Definition] {
        &self.definitions
    }

    /// Adds the table of a message on a bus; its number. `None` when no signal of it is wanted.
    pub fn add(&mut self, bus: &Arc<str>, definition: usize, message: usize) -> Option<u32> {
        let database = self.definitions.get(definition)?.decoder.database();
        let signals = &database.messages.get(message)?.signals;
        if !signals.iter().any(|signal| (self.wanted)(&signal.name)) {
            return None;
        }
        let number = u32::try_from(self.origins.len()).ok()?;
        let (definition, message) = (u32::try_from(definition).ok()?, u32::try_from(message).ok()?);
        self.origins.push(Origin { bus: Arc::clone(bus), definition, message });
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
        let origin = self.origins.get(table as usize)?;
        let definition = self.definitions.get(origin.definition as usize)?;
        let message = origin.message as usize;
        let (plan, mut table) =
            CanPlan::new(&definition.decoder, message, &origin.bus, &self.wanted)?;
        table.facts.push(("definition".to_owned(), definition.name.clone()));
        table.facts.push(("definition_sha256".to_owned(), definition.sha256.clone()));
        Some((Plan::Can(plan), table))
    }
}
