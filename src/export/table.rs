//! A table: what its columns are, and what is in a row.

use std::sync::Arc;

/// What a column holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Integers from 0, of so many bits (1 to 64).
    Unsigned(u8),
    /// Integers, of so many bits.
    Signed(u8),
    /// IEEE 754, 32 bits.
    Float32,
    /// IEEE 754, 64 bits.
    #[default]
    Float64,
    /// UTF-8.
    Text,
    /// Bytes.
    Bytes,
}

/// A column.
#[derive(Clone, Debug, Default)]
pub struct Column {
    /// Its name; unique in the table.
    pub name: String,
    /// What it holds.
    pub kind: Kind,
    /// Unit of its values, may be empty.
    pub unit: String,
    /// What it is, may be empty.
    pub comment: String,
    /// It has at most 256 different values.
    pub few_values: bool,
    /// Texts of some of its values; a cell says which by its index. A table has another column for
    /// them, [`Column::label_name`].
    pub labels: Option<Arc<[Box<str>]>>,
}

impl Column {
    /// Name of the column with the texts of its values.
    pub fn label_name(&self) -> String {
        format!("{}_label", self.name)
    }
}

/// A table: each time a message was seen on a bus.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Name of the bus.
    pub bus: String,
    /// Name of the message.
    pub message: String,
    /// What the message is, may be empty.
    pub comment: String,
    /// What else is known about it: names and texts.
    pub facts: Vec<(String, String)>,
    /// The columns but the time, which every table has.
    pub columns: Vec<Column>,
    /// It has a row for each element of something that repeats in a message; its first column
    /// counts them, from 0.
    pub repeats: bool,
}

impl Table {
    /// The columns and cells of values, and which element of a message they are about, where it
    /// has many.
    pub fn values<'a>(
        &'a self,
        row: &'a Row,
    ) -> (Option<u64>, impl Iterator<Item = (&'a Column, &'a Cell)>) {
        let index = match row.cells.first() {
            Some(Cell { value: Value::Unsigned(index), .. }) if self.repeats => Some(*index),
            _ => None,
        };
        let values = self.columns.iter().zip(&row.cells);
        (index, values.skip(usize::from(self.repeats)))
    }
}

/// One value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Value {
    /// Not in the frame.
    #[default]
    Absent,
    /// An integer from 0.
    Unsigned(u64),
    /// An integer.
    Signed(i64),
    /// A float.
    Float(f64),
    /// Text or bytes: from and to in [`Row::text`].
    Text(u32, u32),
    /// A text that the writer knows by this number; see [`super::rows::FlatWriter::know`].
    Known(u32),
}

/// One value and the index of its label, if it has one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cell {
    /// The value.
    pub value: Value,
    /// Index in [`Column::labels`].
    pub label: Option<u32>,
}

/// A row without its time, used again for each.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// One for each column.
    pub cells: Vec<Cell>,
    /// What text values are cut from.
    pub text: Vec<u8>,
}

impl Row {
    /// Makes it a row of `columns` absent values.
    pub fn clear(&mut self, columns: usize) {
        self.cells.clear();
        self.cells.resize(columns, Cell::default());
        self.text.clear();
    }

    /// Appends a value.
    pub fn push(&mut self, value: Value) {
        self.cells.push(Cell { value, label: None });
    }

    /// Appends bytes.
    pub fn push_bytes(&mut self, bytes: &[u8]) {
        let place = |at| u32::try_from(at).unwrap_or(u32::MAX);
        let from = place(self.text.len());
        self.text.extend_from_slice(bytes);
        self.push(Value::Text(from, place(self.text.len())));
    }

    /// Appends a text that the writer knows, or its absence.
    pub fn push_known(&mut self, text: Option<u32>) {
        self.push(text.map_or(Value::Absent, Value::Known));
    }

    /// The bytes of a value that is a text in this row.
    pub fn bytes(&self, value: Value) -> &[u8] {
        match value {
            Value::Text(from, to) => self.text(from, to),
            _ => &[],
        }
    }

    /// The bytes of a text value.
    pub fn text(&self, from: u32, to: u32) -> &[u8] {
        self.text.get(from as usize..to as usize).unwrap_or_default()
    }
}

/// Names that every table has already.
const TAKEN: [&str; 3] = ["time", "bus", "message"];

/// Makes names of columns unique: an underscore is put behind those that are taken, by the time
/// and the folders `bus=` and `message=` of a dataset, or by another column or its labels.
pub fn make_unique(columns: &mut [Column]) {
    let mut taken: std::collections::HashSet<String> =
        TAKEN.iter().map(|name| (*name).to_owned()).collect();
    for column in columns {
        while taken.contains(&column.name.to_ascii_lowercase())
            || column.labels.is_some() && taken.contains(&column.label_name().to_ascii_lowercase())
        {
            column.name.push('_');
        }
        // Some readers (DuckDB) take upper and lower case for the same.
        taken.insert(column.name.to_ascii_lowercase());
        if column.labels.is_some() {
            taken.insert(column.label_name().to_ascii_lowercase());
        }
    }
}
