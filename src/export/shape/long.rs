//! A row for each value: time, bus, message, signal, value, label, unit.

use std::io;

use super::{column, table, texts};
use crate::export::rows::{FlatWriter, RowWriter};
use crate::export::table::{Kind, Row, Table, Value};
use crate::frame::Timestamp;

/// What the table looks like.
pub fn layout() -> Table {
    table(vec![
        texts("bus"),
        texts("message"),
        texts("signal"),
        column("value", Kind::Float64),
        texts("label"),
        texts("unit"),
    ])
}

/// Writes a row for each value that is there.
pub struct Long {
    out: Box<dyn FlatWriter>,
    row: Row,
}

impl Long {
    /// To `out`, which has the layout of [`layout`].
    pub fn new(out: Box<dyn FlatWriter>) -> Self {
        Self { out, row: Row::default() }
    }
}

impl RowWriter for Long {
    fn row(&mut self, _: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        for (column, cell) in table.columns.iter().zip(&row.cells) {
            if cell.value == Value::Absent {
                continue;
            }
            self.row.clear(0);
            self.row.push_text(Some(&table.bus));
            self.row.push_text(Some(&table.message));
            self.row.push_text(Some(&column.name));
            let labels = column.labels.as_ref();
            let mut label =
                labels.and_then(|labels| labels.get(cell.label? as usize)).map(|t| &**t);
            match cell.value {
                // A value that is a text has no number.
                Value::Text(from, to) => {
                    self.row.push(Value::Absent);
                    label = str::from_utf8(row.text(from, to)).ok();
                }
                value => self.row.push(value),
            }
            self.row.push_text(label);
            self.row.push_text(Some(column.unit.as_str()).filter(|unit| !unit.is_empty()));
            self.out.row(time, &self.row)?;
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.finish()
    }

    fn files(&self) -> u64 {
        self.out.files()
    }
}
