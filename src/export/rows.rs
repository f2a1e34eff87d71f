//! Rows one by one, for formats that are written row by row.

use std::io;

use super::TableWriter;
use super::catalogue::{Catalogue, Plan};
use super::table::{Row, Table};
use crate::frame::Timestamp;

/// Writes rows of many tables, decoded.
pub trait RowWriter {
    /// Writes a row of table number `number`.
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()>;
    /// Completes the output.
    fn finish(&mut self) -> io::Result<()>;
    /// Files written so far.
    fn files(&self) -> u64;
    /// Sentences about what was done differently from what one might expect.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

/// Writes rows of one table.
pub trait FlatWriter {
    /// Remembers a text that stands in many rows: the number for [`super::table::Value::Known`].
    fn know(&mut self, text: &str) -> u32;
    /// Writes a row.
    fn row(&mut self, time: Timestamp, row: &Row) -> io::Result<()>;
    /// Completes the output.
    fn finish(&mut self) -> io::Result<()>;
    /// Files written so far.
    fn files(&self) -> u64;
}

/// Decodes payloads for a [`RowWriter`].
pub struct Rows<W> {
    writer: W,
    tables: Vec<Option<Box<(Plan, Table)>>>,
    row: Row,
}

impl<W: RowWriter> Rows<W> {
    /// For `writer`.
    pub fn new(writer: W) -> Self {
        Self { writer, tables: Vec::new(), row: Row::default() }
    }
}

impl<W: RowWriter> TableWriter for Rows<W> {
    fn write(
        &mut self,
        catalogue: &Catalogue,
        number: u32,
        time: Timestamp,
        payload: &[u8],
    ) -> io::Result<()> {
        let index = number as usize;
        if self.tables.len() <= index {
            self.tables.resize_with(index + 1, || None);
        }
        let Some(place) = self.tables.get_mut(index) else { return Ok(()) };
        if place.is_none() {
            *place = catalogue.table(number).map(Box::new);
        }
        let Some(known) = place else { return Ok(()) };
        let (plan, table) = &**known;
        let (writer, mut done) = (&mut self.writer, Ok(()));
        plan.rows(payload, &mut self.row, |row| {
            if done.is_ok() {
                done = writer.row(number, table, time, row);
            }
        });
        done
    }

    fn finish(&mut self, _: &Catalogue) -> io::Result<()> {
        self.writer.finish()
    }

    fn files(&self) -> u64 {
        self.writer.files()
    }

    fn notes(&self) -> Vec<String> {
        self.writer.notes()
    }
}
