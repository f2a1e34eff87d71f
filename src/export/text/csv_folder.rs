//! A folder of CSV files, one for each message: `<bus>/<Message>.csv`.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::csv::{Style, put_head, put_row};
use super::{Clock, Known};
use crate::export::output::{about, part_of};
use crate::export::path_name;
use crate::export::period::Split;
use crate::export::rows::RowWriter;
use crate::export::stream::append;
use crate::export::table::{Row, Table};
use crate::frame::Timestamp;

/// Text of one table that is written at once.
const PIECE: usize = 64 << 10;
/// Text of all tables that waits to be written.
const WAITING: usize = 8 << 20;

/// Writes the files.
pub struct CsvFolder {
    folder: PathBuf,
    style: Style,
    split: Split,
    clock: Clock,
    /// None: rows of messages have texts of their own.
    known: Known,
    tables: Vec<File>,
    /// Bytes in all buffers.
    waiting: usize,
    files: u64,
}

#[derive(Default)]
struct File {
    path: PathBuf,
    period: Option<u64>,
    buffer: Vec<u8>,
}

impl CsvFolder {
    /// Into `folder`.
    pub fn new(folder: &Path, style: Style, split: Split) -> Self {
        Self {
            folder: folder.to_owned(),
            style,
            split,
            clock: Clock::new(style.time),
            known: Known::default(),
            tables: Vec::new(),
            waiting: 0,
            files: 0,
        }
    }

    /// Begins the file of a period.
    fn begin(&mut self, index: usize, table: &Table, period: u64) -> io::Result<()> {
        self.flush(index)?;
        let folder = self.folder.join(path_name(&table.bus));
        fs::create_dir_all(&folder).map_err(|error| about(&folder, &error))?;
        let mut name = path_name(&table.message);
        let of_period = self.split.name(period);
        if !of_period.is_empty() {
            name = format!("{name}-{of_period}");
        }
        let path = part_of(&folder.join(format!("{name}.csv")));
        let new = !path.exists();
        let Some(file) = self.tables.get_mut(index) else { return Ok(()) };
        (file.path, file.period) = (path, Some(period));
        if new {
            put_head(&mut file.buffer, table, self.style);
            self.waiting += file.buffer.len();
            self.files += 1;
        }
        // What is not there yet would be begun again when times go back and forth.
        if self.split == Split::Never { Ok(()) } else { self.flush(index) }
    }

    fn flush(&mut self, index: usize) -> io::Result<()> {
        let Some(file) = self.tables.get_mut(index) else { return Ok(()) };
        if !file.buffer.is_empty() {
            append(&file.path, &file.buffer)?;
            self.waiting -= file.buffer.len();
            file.buffer.clear();
            // With many tables each buffer is small, and kept small.
            file.buffer.shrink_to(PIECE / 8);
        }
        Ok(())
    }

    fn flush_all(&mut self) -> io::Result<()> {
        (0..self.tables.len()).try_for_each(|index| self.flush(index))
    }
}

impl RowWriter for CsvFolder {
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        let index = number as usize;
        if self.tables.len() <= index {
            self.tables.resize_with(index + 1, File::default);
        }
        let period = self.split.number(time);
        if self.tables.get(index).is_some_and(|file| file.period != Some(period)) {
            self.begin(index, table, period)?;
        }
        let Some(file) = self.tables.get_mut(index) else { return Ok(()) };
        let before = file.buffer.len();
        let Self { clock, known, .. } = self;
        put_row(&mut file.buffer, table, known, clock, (time, row), self.style);
        self.waiting += file.buffer.len() - before;
        if file.buffer.len() >= PIECE {
            self.flush(index)?;
        }
        if self.waiting > WAITING { self.flush_all() } else { Ok(()) }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.flush_all()
    }

    fn files(&self) -> u64 {
        self.files
    }
}
