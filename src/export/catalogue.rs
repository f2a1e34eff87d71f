//! The tables of an export: where their rows come from, and how payloads become rows.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use super::can_table::{ADDRESSES, CanPlan};
use super::message_table::{Described, MessagePlan, compile};
use super::table::{Row, Table};
use crate::decode::dbc::names::Names;
use crate::decode::definition::CanDefinition;
use crate::frame::CanFrame;

/// A database that frames are decoded with.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Compiled.
    pub can: Arc<CanDefinition>,
    /// Its files: names, and SHA-256 in hexadecimal.
    files: Vec<(String, String)>,
    /// By message: its frames have addresses.
    grouped: Vec<bool>,
}

impl Definition {
    /// `can`, and its files: names, and SHA-256 in hexadecimal.
    pub fn new(can: Arc<CanDefinition>, files: Vec<(String, String)>) -> Self {
        let grouped = can.grouped();
        Self { can, files, grouped }
    }

    /// Of a message and a frame of it what [`Plan::Can`] makes rows of; `room` is used where that is
    /// more than the frame's data.
    #[inline]
    pub fn payload<'a>(
        &self,
        message: usize,
        frame: &'a CanFrame,
        room: &'a mut Vec<u8>,
    ) -> &'a [u8] {
        if !self.grouped.get(message).is_some_and(|is| *is) {
            return frame.data();
        }
        room.clear();
        room.extend_from_slice(frame.data());
        room.extend_from_slice(&frame.id.to_le_bytes());
        room
    }
}

/// Where the rows of a table come from.
#[derive(Clone, Debug)]
enum Origin {
    /// Frames of a bus that are a message of a definition.
    Can { bus: Arc<str>, definition: Arc<Definition>, message: u32 },
    /// A decoded channel.
    Message(Box<(MessagePlan, Table)>),
}

/// How payloads become rows of one table.
#[derive(Clone, Debug)]
pub enum Plan {
    /// Payloads are the data of CAN frames, see [`Definition::payload`].
    Can(CanPlan),
    /// Payloads are encoded messages.
    Message(MessagePlan),
}

impl Plan {
    /// Gives each row of a payload to `visit`; `row` is room for one.
    pub fn rows(&self, payload: &[u8], row: &mut Row, mut visit: impl FnMut(&Row)) {
        match self {
            Self::Can(plan) => {
                plan.row(payload, row);
                visit(row);
            }
            Self::Message(plan) => plan.rows(payload, row, visit),
        }
    }
}

/// The tables seen so far, by their number. Small, also with thousands of tables: what a table of
/// frames looks like is worked out when it is asked for.
pub struct Catalogue {
    origins: Vec<Origin>,
    /// By bus the names that tables of decoded channels have: their schemas may share one.
    names: HashMap<String, Names>,
    wanted: Box<dyn Fn(&str) -> bool>,
}

impl Catalogue {
    /// Of the signals that are `wanted`.
    pub fn new(wanted: Box<dyn Fn(&str) -> bool>) -> Self {
        Self { origins: Vec::new(), names: HashMap::new(), wanted }
    }

    /// Adds the table of a message on a bus; its number. `None` when no signal of it is wanted.
    pub fn add(
        &mut self,
        bus: &Arc<str>,
        definition: &Arc<Definition>,
        message: usize,
    ) -> Option<u32> {
        let signals = &definition.can.messages().get(message)?.signals;
        let grouped = definition.grouped.get(message).is_some_and(|is| *is);
        let names = signals.iter().map(|signal| signal.name.as_str());
        let names = names.chain(ADDRESSES.into_iter().filter(|_| grouped));
        if !names.into_iter().any(|name| (self.wanted)(name)) {
            return None;
        }
        let (bus, definition) = (Arc::clone(bus), Arc::clone(definition));
        self.push(Origin::Can { bus, definition, message: u32::try_from(message).ok()? })
    }

    /// Adds the tables of a decoded channel: one of its messages, and one for each field that
    /// repeats; their numbers. A name that another schema has already gets a number behind it.
    /// `files` are those of its definition, with their SHA-256.
    pub fn add_message(
        &mut self,
        described: &Described<'_>,
        files: &[(String, String)],
    ) -> Range<u32> {
        let first = u32::try_from(self.origins.len()).unwrap_or(u32::MAX);
        for (plan, mut table) in compile(described, &self.wanted) {
            let names = self.names.entry(table.bus.clone()).or_default();
            table.message = names.take(&table.message);
            add_files(&mut table, files);
            self.push(Origin::Message(Box::new((plan, table))));
        }
        first..u32::try_from(self.origins.len()).unwrap_or(u32::MAX)
    }

    fn push(&mut self, origin: Origin) -> Option<u32> {
        let number = u32::try_from(self.origins.len()).ok()?;
        self.origins.push(origin);
        Some(number)
    }

    /// How many kinds of messages there are.
    pub fn messages(&self) -> usize {
        let repeats =
            |origin: &&Origin| matches!(origin, Origin::Message(known) if known.1.repeats);
        self.origins.len() - self.origins.iter().filter(repeats).count()
    }

    /// What table number `table` looks like, and how payloads become its rows.
    pub fn table(&self, table: u32) -> Option<(Plan, Table)> {
        match self.origins.get(table as usize)? {
            Origin::Can { bus, definition, message } => {
                let message = *message as usize;
                let addresses = definition.grouped.get(message).is_some_and(|is| *is);
                let (plan, mut table) =
                    CanPlan::new(&definition.can, message, bus, addresses, &self.wanted)?;
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
        let numbers = 0..u32::try_from(self.origins.len()).unwrap_or(u32::MAX);
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
