//! A folder of Parquet files that is read as one dataset:
//! `bus=<bus>/message=<Message>/part-0000.parquet`.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::columns::{SignalData, row_bytes};
use super::file::{NamedFile, TableFile};
use super::shelves::{Shelf, Spill, each_row};
use crate::export::TableWriter;
use crate::export::catalogue::{Catalogue, Plan};
use crate::export::output::{about, part_of};
use crate::export::path_name;
use crate::export::period::Split;
use crate::export::table::{Row, Table, Value};
use crate::frame::Timestamp;

/// Memory for rows that wait.
const WAITING: usize = 14 << 20;
/// Memory for the columns of a row group.
const GROUP: usize = 8 << 20;
/// Fewer rows than this become a row group only at the end.
const LEAST_ROWS: usize = 20_000;
/// So many files are open at a time at most.
const OPEN_FILES: usize = 128;
/// So many columns of row groups are remembered for the ends of files, at most.
const CHUNKS: usize = 16_000;

/// Writes a dataset.
pub struct Dataset {
    folder: PathBuf,
    level: i32,
    split: Split,
    tables: Vec<State>,
    spill: Spill,
    /// Bytes of all shelves.
    waiting: usize,
    open: BTreeMap<u32, Open>,
    /// Columns of row groups of all open files.
    chunks: usize,
    files: u64,
    ones: Vec<i16>,
}

#[derive(Default)]
struct State {
    shelf: Shelf,
    period: u64,
    parts: u32,
}

struct Open {
    file: TableFile<NamedFile>,
    chunks: usize,
}

impl Dataset {
    /// Into `folder`, with zstd of this level.
    pub fn new(folder: &Path, level: i32, split: Split) -> Self {
        Self {
            folder: folder.to_owned(),
            level,
            split,
            tables: Vec::new(),
            spill: Spill::new(folder),
            waiting: 0,
            open: BTreeMap::new(),
            chunks: 0,
            files: 0,
            ones: Vec::new(),
        }
    }

    /// Makes room in memory.
    #[cold]
    fn relieve(&mut self, catalogue: &Catalogue) -> io::Result<()> {
        let mut longest: Vec<(usize, u32)> = self
            .tables
            .iter()
            .zip(0..)
            .map(|(state, number)| (state.shelf.bytes(), number))
            .collect();
        longest.sort_unstable();
        while self.waiting > WAITING / 2 {
            let Some((bytes, table)) = longest.pop() else { break };
            let Some(state) = self.tables.get_mut(table as usize) else { break };
            if state.shelf.len() >= LEAST_ROWS {
                self.flush(catalogue, table)?;
            } else {
                self.spill.put(&mut state.shelf)?;
                self.waiting = self.waiting.saturating_sub(bytes);
            }
        }
        Ok(())
    }

    /// Writes all rows of a table as row groups.
    fn flush(&mut self, catalogue: &Catalogue, number: u32) -> io::Result<()> {
        let Some(state) = self.tables.get_mut(number as usize) else { return Ok(()) };
        if state.shelf.len() == 0 {
            return Ok(());
        }
        let Some((plan, table)) = catalogue.table(number) else { return Ok(()) };
        self.waiting = self.waiting.saturating_sub(state.shelf.bytes());
        let mut shelf = std::mem::take(&mut state.shelf);
        let mut open = match self.open.remove(&number) {
            Some(open) => open,
            None => self.open_file(number, &table)?,
        };
        let mut group = Group::new(&table, &plan);
        let ones = &mut self.ones;
        self.spill.take(&mut shelf, |rows| group.take(rows, &mut open.file, ones))?;
        group.write(&mut open.file, ones)?;
        let chunks = open.file.groups() * (1 + table.columns.len());
        self.chunks += chunks - open.chunks;
        open.chunks = chunks;
        self.open.insert(number, open);
        while self.open.len() > OPEN_FILES || self.chunks > CHUNKS {
            let largest = self.open.iter().max_by_key(|(_, open)| open.chunks);
            let Some((&number, _)) = largest else { break };
            self.close(number)?;
        }
        Ok(())
    }

    fn open_file(&mut self, number: u32, table: &Table) -> io::Result<Open> {
        let folder = self
            .folder
            .join(format!("bus={}", path_name(&table.bus)))
            .join(format!("message={}", path_name(&table.message)));
        fs::create_dir_all(&folder).map_err(|error| about(&folder, &error))?;
        let mut name = "part-".to_owned();
        if let Some(state) = self.tables.get_mut(number as usize) {
            let period = self.split.name(state.period);
            if !period.is_empty() {
                name = format!("{name}{period}-");
            }
            name = format!("{name}{:04}.parquet", state.parts);
            state.parts += 1;
        }
        self.files += 1;
        let out = NamedFile::create(&part_of(&folder.join(name)))?;
        Ok(Open { file: TableFile::create(out, table, self.level)?, chunks: 0 })
    }

    fn close(&mut self, number: u32) -> io::Result<()> {
        if let Some(open) = self.open.remove(&number) {
            self.chunks -= open.chunks;
            open.file.finish()?;
        }
        Ok(())
    }
}

impl TableWriter for Dataset {
    #[inline]
    fn write(
        &mut self,
        catalogue: &Catalogue,
        table: u32,
        time: Timestamp,
        payload: &[u8],
    ) -> io::Result<()> {
        let index = table as usize;
        if self.tables.len() <= index {
            self.tables.resize_with(index + 1, State::default);
        }
        let period = self.split.number(time);
        if self.tables.get(index).is_some_and(|state| state.period != period) {
            self.flush(catalogue, table)?;
            self.close(table)?;
        }
        let Some(state) = self.tables.get_mut(index) else { return Ok(()) };
        state.period = period;
        self.waiting += state.shelf.push(time.nanos(), payload);
        if self.waiting > WAITING {
            self.relieve(catalogue)?;
        }
        Ok(())
    }

    fn finish(&mut self, catalogue: &Catalogue) -> io::Result<()> {
        for number in 0..u32::try_from(self.tables.len()).unwrap_or(u32::MAX) {
            self.flush(catalogue, number)?;
            self.close(number)?;
        }
        Ok(())
    }

    fn files(&self) -> u64 {
        self.files
    }
}

/// A row group being filled.
struct Group<'a> {
    plan: &'a Plan,
    most: usize,
    times: Vec<i64>,
    columns: Vec<SignalData>,
    row: Row,
}

impl<'a> Group<'a> {
    fn new(table: &Table, plan: &'a Plan) -> Self {
        let most = (GROUP / row_bytes(&table.columns)).max(1);
        let columns = table.columns.iter().map(SignalData::new).collect();
        Self { plan, most, times: Vec::new(), columns, row: Row::default() }
    }

    /// Takes rows, and writes those that are enough for a group.
    fn take(
        &mut self,
        rows: &[u8],
        file: &mut TableFile<NamedFile>,
        ones: &mut Vec<i16>,
    ) -> io::Result<()> {
        let mut result = Ok(());
        each_row(rows, |time, payload| {
            if self.times.len() >= self.most && result.is_ok() {
                result = self.write(file, ones);
            }
            // Times end in the year 2262, where i64 ends too.
            let time = i64::try_from(time).unwrap_or(i64::MAX);
            let Self { plan, times, columns, row, .. } = self;
            match plan {
                Plan::Can(plan) => {
                    times.push(time);
                    plan.visit(payload, |column, cell| {
                        if let Some(column) = columns.get_mut(column) {
                            column.push(cell);
                        }
                    });
                    for column in columns.iter_mut() {
                        if column.values.rows() < times.len() {
                            column.push_absent();
                        }
                    }
                }
                Plan::Message(plan) => plan.rows(payload, row, |row| {
                    times.push(time);
                    for (column, cell) in columns.iter_mut().zip(&row.cells) {
                        match cell.value {
                            Value::Text(from, to) => {
                                let bytes = row.text(from, to).to_vec();
                                column.values.push_bytes(bytes.into());
                            }
                            _ => column.push(*cell),
                        }
                    }
                }),
            }
        });
        result
    }

    fn write(&mut self, file: &mut TableFile<NamedFile>, ones: &mut Vec<i16>) -> io::Result<()> {
        if self.times.is_empty() {
            return Ok(());
        }
        file.write(&self.times, &self.columns, ones)?;
        self.times.clear();
        self.columns.iter_mut().for_each(SignalData::clear);
        Ok(())
    }
}
