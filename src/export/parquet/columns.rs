//! Columns in memory, in the physical types of Parquet.

use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::Result;

use crate::export::table::{Cell, Column, Kind, Value};

/// Values of a column. Unsigned integers are stored bit by bit as signed ones, as Parquet does.
#[derive(Debug)]
enum Values {
    Int32(Vec<i32>),
    Int64(Vec<i64>),
    Float(Vec<f32>),
    Double(Vec<f64>),
    Bytes(Vec<ByteArray>),
}

/// A column of a row group: the values that are there, and which rows have one.
#[derive(Debug)]
pub struct ColumnData {
    values: Values,
    /// 1 where a row has a value; not kept while every row has one.
    levels: Vec<i16>,
    rows: usize,
}

/// A column and the texts of its values.
#[derive(Debug)]
pub struct SignalData {
    /// The values.
    pub values: ColumnData,
    /// The texts, and the column they go to.
    pub labels: Option<(Vec<ByteArray>, ColumnData)>,
}

impl ColumnData {
    /// An empty column.
    pub fn new(kind: Kind) -> Self {
        let values = match kind {
            Kind::Unsigned(bits) | Kind::Signed(bits) if bits <= 32 => Values::Int32(Vec::new()),
            Kind::Unsigned(_) | Kind::Signed(_) => Values::Int64(Vec::new()),
            Kind::Float32 => Values::Float(Vec::new()),
            Kind::Float64 => Values::Double(Vec::new()),
            Kind::Text | Kind::Bytes => Values::Bytes(Vec::new()),
        };
        Self { values, levels: Vec::new(), rows: 0 }
    }

    /// How many rows it has.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Appends a number.
    #[inline]
    #[allow(clippy::cast_possible_truncation, reason = "the kind of the column bounds its values")]
    pub fn push(&mut self, value: Value) {
        match (&mut self.values, value) {
            (Values::Int32(values), Value::Unsigned(number)) => values.push(number as i32),
            (Values::Int32(values), Value::Signed(number)) => values.push(number as i32),
            (Values::Int64(values), Value::Unsigned(number)) => values.push(number as i64),
            (Values::Int64(values), Value::Signed(number)) => values.push(number),
            (Values::Double(values), Value::Float(number)) => values.push(number),
            (Values::Double(values), Value::Unsigned(number)) => values.push(number as f64),
            (Values::Double(values), Value::Signed(number)) => values.push(number as f64),
            (Values::Float(values), Value::Float(number)) => values.push(number as f32),
            _ => return self.push_absent(),
        }
        self.present();
    }

    /// Appends a text or bytes.
    pub fn push_bytes(&mut self, bytes: ByteArray) {
        if let Values::Bytes(values) = &mut self.values {
            values.push(bytes);
            self.present();
        }
    }

    /// Appends a row without a value.
    #[inline]
    pub fn push_absent(&mut self) {
        if self.levels.is_empty() {
            self.levels.resize(self.rows, 1);
        }
        self.levels.push(0);
        self.rows += 1;
    }

    #[inline]
    fn present(&mut self) {
        if !self.levels.is_empty() {
            self.levels.push(1);
        }
        self.rows += 1;
    }

    /// Makes it empty.
    pub fn clear(&mut self) {
        match &mut self.values {
            Values::Int32(values) => values.clear(),
            Values::Int64(values) => values.clear(),
            Values::Float(values) => values.clear(),
            Values::Double(values) => values.clear(),
            Values::Bytes(values) => values.clear(),
        }
        self.levels.clear();
        self.rows = 0;
    }

    /// Writes it. `ones` is as long as the column, all 1.
    pub fn write(&self, out: &mut ColumnWriter<'_>, ones: &[i16]) -> Result<()> {
        let levels = if self.rows > 0 && self.levels.is_empty() { ones } else { &self.levels };
        let levels = Some(levels);
        match (&self.values, out) {
            (Values::Int32(values), ColumnWriter::Int32ColumnWriter(out)) => {
                out.write_batch(values, levels, None)?
            }
            (Values::Int64(values), ColumnWriter::Int64ColumnWriter(out)) => {
                out.write_batch(values, levels, None)?
            }
            (Values::Float(values), ColumnWriter::FloatColumnWriter(out)) => {
                out.write_batch(values, levels, None)?
            }
            (Values::Double(values), ColumnWriter::DoubleColumnWriter(out)) => {
                out.write_batch(values, levels, None)?
            }
            (Values::Bytes(values), ColumnWriter::ByteArrayColumnWriter(out)) => {
                out.write_batch(values, levels, None)?
            }
            _ => 0,
        };
        Ok(())
    }
}

impl SignalData {
    /// Empty columns for `column`.
    pub fn new(column: &Column) -> Self {
        let labels = column.labels.as_ref().map(|labels| {
            let texts = labels.iter().map(|text| ByteArray::from(text.as_bytes().to_vec()));
            (texts.collect(), ColumnData::new(Kind::Text))
        });
        Self { values: ColumnData::new(column.kind), labels }
    }

    /// Appends a number and its label.
    #[inline]
    pub fn push(&mut self, cell: Cell) {
        self.values.push(cell.value);
        if let Some((texts, column)) = &mut self.labels {
            match cell.label.and_then(|label| texts.get(label as usize)) {
                Some(text) => column.push_bytes(text.clone()),
                None => column.push_absent(),
            }
        }
    }

    /// Appends a row without a value.
    #[inline]
    pub fn push_absent(&mut self) {
        self.push(Cell::default());
    }

    /// Makes it empty.
    pub fn clear(&mut self) {
        self.values.clear();
        if let Some((_, column)) = &mut self.labels {
            column.clear();
        }
    }

    /// The columns of the file, one or two.
    pub fn columns(&self) -> impl Iterator<Item = &ColumnData> {
        std::iter::once(&self.values).chain(self.labels.as_ref().map(|(_, column)| column))
    }
}

/// Bytes a row of these columns takes in memory.
pub fn row_bytes(columns: &[Column]) -> usize {
    let of = |column: &Column| {
        let label = if column.labels.is_some() { size_of::<ByteArray>() } else { 0 };
        label
            + match column.kind {
                Kind::Unsigned(bits) | Kind::Signed(bits) if bits <= 32 => 4,
                Kind::Float32 => 4,
                Kind::Unsigned(_) | Kind::Signed(_) | Kind::Float64 => 8,
                Kind::Text | Kind::Bytes => size_of::<ByteArray>() + 32,
            }
    };
    8 + columns.iter().map(of).sum::<usize>()
}
