//! One Parquet file.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;
use parquet::file::writer::SerializedFileWriter;

use super::columns::{ColumnData, SignalData};
use super::schema;
use crate::export::output::about;
use crate::export::table::Table;

/// A file whose errors say which one it is.
#[derive(Debug)]
pub struct NamedFile {
    file: File,
    path: PathBuf,
}

impl NamedFile {
    /// Creates `path`.
    pub fn create(path: &Path) -> io::Result<Self> {
        let file = File::create_new(path).map_err(|error| about(path, &error))?;
        Ok(Self { file, path: path.to_owned() })
    }
}

impl Write for NamedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes).map_err(|error| about(&self.path, &error))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A file of rows of one table.
pub struct TableFile<W: Write + Send> {
    writer: SerializedFileWriter<W>,
}

impl<W: Write + Send> TableFile<W> {
    /// Begins a file.
    pub fn create(out: W, table: &Table, level: i32) -> io::Result<Self> {
        let schema = schema::schema(&table.columns).map_err(from_parquet)?;
        let properties = schema::properties(table, level).map_err(from_parquet)?;
        let writer = SerializedFileWriter::new(out, schema, properties).map_err(from_parquet)?;
        Ok(Self { writer })
    }

    /// Writes a row group. `ones` is scratch space.
    pub fn write(
        &mut self,
        times: &[i64],
        columns: &[SignalData],
        ones: &mut Vec<i16>,
    ) -> io::Result<()> {
        ones.resize(times.len().max(ones.len()), 1);
        let ones = ones.get(..times.len()).unwrap_or_default();
        let columns = columns.iter().flat_map(SignalData::columns);
        self.write_group(times, columns, ones).map_err(from_parquet)
    }

    fn write_group<'a>(
        &mut self,
        times: &[i64],
        columns: impl Iterator<Item = &'a ColumnData>,
        ones: &[i16],
    ) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        if let Some(mut column) = group.next_column()? {
            column.typed::<parquet::data_type::Int64Type>().write_batch(times, None, None)?;
            column.close()?;
        }
        for data in columns {
            if let Some(mut column) = group.next_column()? {
                data.write(column.untyped(), ones)?;
                column.close()?;
            }
        }
        group.close()?;
        Ok(())
    }

    /// Row groups so far.
    pub fn groups(&self) -> usize {
        self.writer.flushed_row_groups().len()
    }

    /// Writes the end.
    pub fn finish(self) -> io::Result<W> {
        self.writer.into_inner().map_err(from_parquet)
    }
}

/// The error of the system inside, if it is one.
fn from_parquet(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(inner) => match inner.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    }
}
