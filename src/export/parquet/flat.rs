//! One table as one Parquet file, or as one for each day or hour.

use std::collections::HashMap;
use std::io::{self, Write};
use std::path::PathBuf;

use parquet::data_type::ByteArray;

use super::columns::{SignalData, row_bytes};
use super::file::{NamedFile, TableFile};
use crate::export::output::{Output, part_of};
use crate::export::period::Split;
use crate::export::rows::FlatWriter;
use crate::export::table::{Row, Table, Value};
use crate::frame::Timestamp;

/// Memory for the columns of a row group.
const GROUP: usize = 16 << 20;

/// Where the files go.
pub enum Place {
    /// To one file.
    File(Option<Output>),
    /// Into a folder, `2026-11-22.parquet` and so on.
    Folder(PathBuf, Split),
}

/// Writes one table.
pub struct FlatParquet {
    table: Table,
    level: i32,
    place: Place,
    file: Option<TableFile<Box<dyn Finish>>>,
    period: u64,
    /// Files of each period, which times that go back may ask for again.
    parts: HashMap<u64, u32>,
    files: u64,
    most: usize,
    times: Vec<i64>,
    columns: Vec<SignalData>,
    known: Vec<ByteArray>,
    ones: Vec<i16>,
}

/// A file that may get its name when it is complete.
trait Finish: Write + Send {
    fn finish(self: Box<Self>) -> io::Result<()>;
}

impl Finish for Output {
    fn finish(self: Box<Self>) -> io::Result<()> {
        Output::finish(*self).map_err(io::Error::other)
    }
}

impl Finish for NamedFile {
    fn finish(self: Box<Self>) -> io::Result<()> {
        Ok(())
    }
}

impl FlatParquet {
    /// Writes `table` with zstd of this level.
    pub fn new(table: Table, place: Place, level: i32) -> Self {
        let most = (GROUP / row_bytes(&table.columns)).clamp(1, 1 << 20);
        let columns: Vec<_> = table.columns.iter().map(SignalData::new).collect();
        Self {
            table,
            level,
            place,
            file: None,
            period: 0,
            parts: HashMap::new(),
            files: 0,
            most,
            times: Vec::new(),
            columns,
            known: Vec::new(),
            ones: Vec::new(),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.times.is_empty() {
            return Ok(());
        }
        self.open()?;
        if let Some(file) = &mut self.file {
            file.write(&self.times, &self.columns, &mut self.ones)?;
        }
        self.times.clear();
        self.columns.iter_mut().for_each(SignalData::clear);
        Ok(())
    }

    fn open(&mut self) -> io::Result<()> {
        if self.file.is_some() {
            return Ok(());
        }
        let out: Box<dyn Finish> = match &mut self.place {
            Place::File(output) => match output.take() {
                Some(output) => Box::new(output),
                None => return Err(io::Error::other("the file is complete already")),
            },
            Place::Folder(folder, split) => {
                let part = self.parts.entry(self.period).or_default();
                let name = split.name(self.period);
                let name = match *part {
                    0 => format!("{name}.parquet"),
                    part => format!("{name}-{part}.parquet"),
                };
                *part += 1;
                Box::new(NamedFile::create(&part_of(&folder.join(name)))?)
            }
        };
        self.file = Some(TableFile::create(out, &self.table, self.level)?);
        self.files += 1;
        Ok(())
    }

    fn close(&mut self) -> io::Result<()> {
        match self.file.take() {
            Some(file) => file.finish()?.finish(),
            None => Ok(()),
        }
    }
}

impl FlatWriter for FlatParquet {
    fn know(&mut self, text: &str) -> u32 {
        self.known.push(text.as_bytes().to_vec().into());
        u32::try_from(self.known.len() - 1).unwrap_or(u32::MAX)
    }

    fn row(&mut self, time: Timestamp, row: &Row) -> io::Result<()> {
        if let Place::Folder(_, split) = &self.place {
            let period = split.number(time);
            if period != self.period {
                self.flush()?;
                self.close()?;
                self.period = period;
            }
        }
        // Times end in the year 2262, where i64 ends too.
        self.times.push(i64::try_from(time.nanos()).unwrap_or(i64::MAX));
        for (column, cell) in self.columns.iter_mut().zip(&row.cells) {
            match cell.value {
                Value::Known(number) => match self.known.get(number as usize) {
                    Some(text) => column.values.push_bytes(text.clone()),
                    None => column.push_absent(),
                },
                Value::Text(from, to) => {
                    column.values.push_bytes(row.text(from, to).to_vec().into());
                }
                _ => column.push(*cell),
            }
        }
        if self.times.len() >= self.most { self.flush() } else { Ok(()) }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        if matches!(self.place, Place::File(_)) {
            // A file without rows still tells its columns.
            self.open()?;
        }
        self.close()
    }

    fn files(&self) -> u64 {
        self.files
    }
}
