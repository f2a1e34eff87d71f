//! A row for each step of time, a column for each signal of all messages.
//!
//! The row of time t stands for all that happened from t on until before the next row, as
//! `resample` of pandas has it (`.last()`, `.last().ffill()`, `.mean()`).

use std::io;

use super::survey::MOST_ELEMENTS;
use super::table;
use crate::export::rows::{FlatWriter, RowWriter};
use crate::export::table::{Cell, Column, Kind, Row, Table, Value};
use crate::frame::Timestamp;

/// A pause of more steps than this has no rows: a wrong clock could ask for billions.
const LONGEST_PAUSE: u64 = 1_000_000;

/// What stands where nothing was seen in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fill {
    /// The value before.
    Hold,
    /// Nothing, and means where there are several values.
    Mean,
    /// Nothing.
    None,
}

/// What the table of these tables looks like: columns `<bus>.<Message>.<Signal>`, and
/// `<bus>.<Message>.<field>.<Signal>.<index>` for each of the elements of what repeats; without
/// texts. `lengths` says how many elements there are, for each table.
pub fn layout(tables: &[Table], lengths: &[u64], fill: Fill) -> Table {
    let mut columns = Vec::new();
    for (of, length) in tables.iter().zip(lengths) {
        for index in 0..*length {
            for column in numbers(of) {
                let name = format!("{}.{}.{}", of.bus, of.message, column.name);
                columns.push(Column {
                    name: if of.repeats { format!("{name}.{index}") } else { name },
                    kind: if fill == Fill::Mean { Kind::Float64 } else { column.kind },
                    labels: None,
                    ..column.clone()
                });
            }
        }
    }
    table(columns)
}

/// The columns of a table that have a place in a wide one.
fn numbers(table: &Table) -> impl Iterator<Item = &Column> {
    let values = table.columns.iter().skip(usize::from(table.repeats));
    values.filter(|column| is_number(column))
}

fn is_number(column: &Column) -> bool {
    !matches!(column.kind, Kind::Text | Kind::Bytes)
}

/// Writes a row for each step.
pub struct Wide {
    out: Box<dyn FlatWriter>,
    step: u64,
    fill: Fill,
    /// By number of the table.
    places: Vec<Place>,
    /// Start of the step that is being collected.
    now: Option<u64>,
    row: Row,
    /// Sum and count of the values of the step, for means.
    sums: Vec<(f64, u32)>,
    pauses: u64,
    late: u64,
    beyond: u64,
}

/// Where the values of a table go.
#[derive(Clone, Copy)]
struct Place {
    first: usize,
    /// Columns of one element.
    width: usize,
    /// Elements that have columns.
    length: u64,
}

impl Wide {
    /// To `out`, which has the [`layout`] of `tables` and `lengths`; a step is `step` nanoseconds.
    pub fn new(
        out: Box<dyn FlatWriter>,
        tables: &[Table],
        lengths: &[u64],
        step: u64,
        fill: Fill,
    ) -> Self {
        let mut columns = 0;
        let places = tables.iter().zip(lengths).map(|(table, length)| {
            let (first, width) = (columns, numbers(table).count());
            columns += width * usize::try_from(*length).unwrap_or(usize::MAX);
            Place { first, width, length: *length }
        });
        let places = places.collect();
        let mut row = Row::default();
        row.clear(columns);
        let sums = vec![(0.0, 0); columns];
        let (pauses, late, beyond) = (0, 0, 0);
        Self { out, step: step.max(1), fill, places, now: None, row, sums, pauses, late, beyond }
    }

    /// Writes the rows of all steps before `time`.
    fn advance(&mut self, time: u64) -> io::Result<()> {
        let start = time / self.step * self.step;
        let Some(mut now) = self.now.replace(start) else { return Ok(()) };
        if start < now {
            // A log whose times go back: the value counts for the step that is open.
            self.late += 1;
            self.now = Some(now);
            return Ok(());
        }
        let pause = (start - now) / self.step > LONGEST_PAUSE;
        while now < start {
            self.emit(now)?;
            now = if pause { start } else { now + self.step };
        }
        self.pauses += u64::from(pause);
        Ok(())
    }

    fn emit(&mut self, now: u64) -> io::Result<()> {
        if self.fill == Fill::Mean {
            for (cell, (sum, count)) in self.row.cells.iter_mut().zip(&mut self.sums) {
                if *count > 0 {
                    cell.value = Value::Float(*sum / f64::from(*count));
                }
                (*sum, *count) = (0.0, 0);
            }
        }
        self.out.row(Timestamp(now), &self.row)?;
        if self.fill != Fill::Hold {
            self.row.clear(self.sums.len());
        }
        Ok(())
    }
}

impl RowWriter for Wide {
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        if self.now.is_none_or(|now| time.nanos() < now || time.nanos() - now >= self.step) {
            self.advance(time.nanos())?;
        }
        let Some(place) = self.places.get(number as usize).copied() else { return Ok(()) };
        let (index, values) = table.values(row);
        let index = index.unwrap_or(0);
        if index >= place.length {
            self.beyond += 1;
            return Ok(());
        }
        let first = place.first + place.width * usize::try_from(index).unwrap_or(usize::MAX);
        let values = values.filter(|(column, _)| is_number(column));
        for (at, (_, cell)) in (first..).zip(values) {
            let number = match cell.value {
                Value::Absent | Value::Text(..) | Value::Known(_) => continue,
                Value::Unsigned(number) => number as f64,
                Value::Signed(number) => number as f64,
                Value::Float(number) => number,
            };
            if self.fill == Fill::Mean {
                if let Some((sum, count)) = self.sums.get_mut(at) {
                    *sum += number;
                    *count += 1;
                }
            } else if let Some(place) = self.row.cells.get_mut(at) {
                *place = Cell { value: cell.value, label: None };
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        if let Some(now) = self.now {
            self.emit(now)?;
        }
        self.out.finish()
    }

    fn files(&self) -> u64 {
        self.out.files()
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.pauses > 0 {
            notes.push(format!(
                "{} pauses of more than {LONGEST_PAUSE} steps have no rows",
                self.pauses
            ));
        }
        if self.late > 0 {
            notes.push(format!(
                "{} messages came with an earlier time than those before; they count for the step \
                 that was open",
                self.late
            ));
        }
        if self.beyond > 0 {
            notes.push(format!(
                "{} values have no column: of what repeats, the first {MOST_ELEMENTS} have one",
                self.beyond
            ));
        }
        notes
    }
}
