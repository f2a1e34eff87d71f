//! A row for each value: time, bus, message, signal, value, label, unit.

use std::io;

use super::{column, table, texts};
use crate::export::rows::{FlatWriter, RowWriter};
use crate::export::table::{Cell, Column, Kind, Row, Table, Value};
use crate::export::text::put_hex;
use crate::frame::Timestamp;

/// Names of so many elements of something that repeats are remembered.
const ELEMENTS: u64 = 1024;

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
    /// By number of the table.
    tables: Vec<Option<Names>>,
}

/// The texts of a table, as the writer knows them.
struct Names {
    bus: u32,
    message: u32,
    /// By column.
    columns: Vec<Texts>,
}

struct Texts {
    /// Names of the signal: one, or one for each element.
    signals: Vec<u32>,
    /// By index in [`Column::labels`], those that have come up.
    labels: Vec<Option<u32>>,
    unit: Option<u32>,
}

impl Long {
    /// To `out`, which has the layout of [`layout`].
    pub fn new(out: Box<dyn FlatWriter>) -> Self {
        Self { out, row: Row::default(), tables: Vec::new() }
    }
}

impl Names {
    fn of(table: &Table, out: &mut dyn FlatWriter) -> Self {
        let (bus, message) = (out.know(&table.bus), out.know(&table.message));
        let columns = table.columns.iter().map(|column| Texts {
            signals: Vec::new(),
            labels: Vec::new(),
            unit: (!column.unit.is_empty()).then(|| out.know(&column.unit)),
        });
        Self { bus, message, columns: columns.collect() }
    }
}

impl Texts {
    /// The name of a signal, or of an element of it.
    fn signal(&mut self, column: &Column, index: Option<u64>, out: &mut dyn FlatWriter) -> Value {
        let at = index.unwrap_or(0).min(ELEMENTS) as usize;
        while self.signals.len() <= at {
            let known = match index {
                None => out.know(&column.name),
                Some(_) if self.signals.len() as u64 == ELEMENTS => return Value::Absent,
                Some(_) => out.know(&format!("{}.{}", column.name, self.signals.len())),
            };
            self.signals.push(known);
        }
        self.signals.get(at).map_or(Value::Absent, |known| Value::Known(*known))
    }

    fn label(&mut self, column: &Column, cell: Cell, out: &mut dyn FlatWriter) -> Option<u32> {
        let label = cell.label? as usize;
        let text = column.labels.as_ref()?.get(label)?;
        if self.labels.len() <= label {
            self.labels.resize(label + 1, None);
        }
        let known = self.labels.get_mut(label)?;
        Some(*known.get_or_insert_with(|| out.know(text)))
    }
}

impl RowWriter for Long {
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        let Self { out, row: long, tables } = self;
        let number = number as usize;
        if tables.len() <= number {
            tables.resize_with(number + 1, || None);
        }
        let Some(place) = tables.get_mut(number) else { return Ok(()) };
        let Names { bus, message, columns } =
            place.get_or_insert_with(|| Names::of(table, &mut **out));
        let (index, values) = table.values(row);
        let columns = columns.iter_mut().skip(usize::from(table.repeats));
        for ((column, cell), texts) in values.zip(columns) {
            if cell.value == Value::Absent {
                continue;
            }
            long.clear(0);
            long.push(Value::Known(*bus));
            long.push(Value::Known(*message));
            match texts.signal(column, index, &mut **out) {
                Value::Absent => {
                    long.push_bytes(format!("{}.{}", column.name, index.unwrap_or(0)).as_bytes());
                }
                known => long.push(known),
            }
            match cell.value {
                // A value that is a text has no number, and is its own label.
                Value::Text(from, to) if column.kind == Kind::Text => {
                    long.push(Value::Absent);
                    long.push_bytes(String::from_utf8_lossy(row.text(from, to)).as_bytes());
                }
                Value::Text(from, to) => {
                    long.push(Value::Absent);
                    let mut digits = Vec::new();
                    put_hex(&mut digits, row.text(from, to));
                    long.push_bytes(&digits);
                }
                value => {
                    long.push(value);
                    long.push_known(texts.label(column, *cell, &mut **out));
                }
            }
            long.push_known(texts.unit);
            out.row(time, long)?;
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
