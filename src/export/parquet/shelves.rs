//! Where rows wait until there are enough for a row group: a shelf for each table.
//!
//! Rows wait as they came, a time and a payload, which takes a fraction of the room of columns.
//! When memory is full, the longest shelves become row groups; where those would be too small (many
//! tables), rows go to a temporary file and come back when their turn has come. So memory does not
//! grow, whatever the number of rows and tables, and row groups do not become small.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

use crate::export::foreign::WAITING_ROWS;
use crate::export::output::about;

/// Length of a payload that does not fit into one byte.
const LONG: u8 = u8::MAX;
/// No block.
const NONE: u64 = u64::MAX;
/// Of a block in the temporary file: where the block before it is, its length.
const HEAD: usize = 12;

/// The rows of one table.
#[derive(Debug)]
pub struct Shelf {
    rows: Vec<u8>,
    /// Rows in memory.
    count: usize,
    /// Rows in the file.
    spilled: usize,
    /// Where the last block in the file is.
    last: u64,
}

impl Default for Shelf {
    fn default() -> Self {
        Self { rows: Vec::new(), count: 0, spilled: 0, last: NONE }
    }
}

impl Shelf {
    /// Rows in memory and file.
    pub fn len(&self) -> usize {
        self.count + self.spilled
    }

    /// Bytes it takes in memory.
    pub fn bytes(&self) -> usize {
        self.rows.capacity()
    }

    /// Adds a row; how many bytes of memory more it takes now.
    #[inline]
    pub fn push(&mut self, time: u64, payload: &[u8]) -> usize {
        let before = self.rows.capacity();
        let needed = self.rows.len() + 13 + payload.len();
        if needed > before {
            // Slower growth than by doubling: half of the memory would be empty.
            self.rows.reserve_exact((before / 4).max(13 + payload.len()).max(64));
        }
        self.rows.extend_from_slice(&time.to_le_bytes());
        match u8::try_from(payload.len()) {
            Ok(length) if length != LONG => self.rows.push(length),
            _ => {
                self.rows.push(LONG);
                let length = u32::try_from(payload.len()).unwrap_or(u32::MAX);
                self.rows.extend_from_slice(&length.to_le_bytes());
            }
        }
        self.rows.extend_from_slice(payload);
        self.count += 1;
        self.rows.capacity() - before
    }
}

/// Gives each row of `bytes` to `visit`: time and payload.
pub fn each_row(mut bytes: &[u8], mut visit: impl FnMut(u64, &[u8])) {
    while let Some((head, rest)) = bytes.split_first_chunk::<9>() {
        let [time @ .., length] = *head;
        let (length, rest) = match (length, rest.split_first_chunk::<4>()) {
            (LONG, Some((length, rest))) => (u32::from_le_bytes(*length) as usize, rest),
            (LONG, None) => return,
            _ => (usize::from(length), rest),
        };
        let Some((payload, rest)) = rest.split_at_checked(length) else { return };
        visit(u64::from_le_bytes(time), payload);
        bytes = rest;
    }
}

/// A temporary file for rows; it has no name, so that nothing is left of it whatever happens.
#[derive(Debug)]
pub struct Spill {
    folder: PathBuf,
    file: Option<File>,
    end: u64,
    /// Blocks that are still needed.
    blocks: usize,
}

impl Spill {
    /// In `folder`, once it is needed.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None, end: 0, blocks: 0 }
    }

    /// Moves the rows of a shelf into the file.
    pub fn put(&mut self, shelf: &mut Shelf) -> io::Result<()> {
        if shelf.count == 0 {
            return Ok(());
        }
        let mut head = [0; HEAD];
        head[..8].copy_from_slice(&shelf.last.to_le_bytes());
        let length = u32::try_from(shelf.rows.len()).map_err(io::Error::other)?;
        head[8..].copy_from_slice(&length.to_le_bytes());
        let (at, body) = (self.end, self.end + HEAD as u64);
        let file = self.file()?;
        file.write_all_at(&head, at)
            .and_then(|()| file.write_all_at(&shelf.rows, body))
            .map_err(|error| self.failed(&error))?;
        self.end = body + u64::from(length);
        self.blocks += 1;
        shelf.spilled += shelf.count;
        shelf.last = at;
        (shelf.rows, shelf.count) = (Vec::new(), 0);
        Ok(())
    }

    /// Takes everything from a shelf: each piece of rows goes to `visit`, in the order they came.
    pub fn take(
        &mut self,
        shelf: &mut Shelf,
        mut visit: impl FnMut(&[u8]) -> io::Result<()>,
    ) -> io::Result<()> {
        let shelf = std::mem::take(shelf);
        let mut places = Vec::new();
        let mut at = shelf.last;
        while at != NONE {
            let mut head = [0; HEAD];
            let file = self.file()?;
            file.read_exact_at(&mut head, at).map_err(|error| self.failed(&error))?;
            let [before @ .., a, b, c, d] = head;
            places.push((at + HEAD as u64, u32::from_le_bytes([a, b, c, d])));
            at = u64::from_le_bytes(before);
        }
        let mut rows = Vec::new();
        for (at, length) in places.into_iter().rev() {
            rows.resize(length as usize, 0);
            let file = self.file()?;
            file.read_exact_at(&mut rows, at).map_err(|error| self.failed(&error))?;
            self.blocks -= 1;
            visit(&rows)?;
        }
        if self.blocks == 0 {
            self.end = 0;
        }
        visit(&shelf.rows)
    }

    fn file(&mut self) -> io::Result<&File> {
        if self.file.is_none() {
            let path = self.folder.join(WAITING_ROWS);
            let mut options = File::options();
            let file = options.read(true).write(true).create_new(true).open(&path);
            let file = file.map_err(|error| about(&path, &error))?;
            std::fs::remove_file(&path).map_err(|error| about(&path, &error))?;
            self.file = Some(file);
        }
        self.file.as_ref().ok_or_else(|| io::Error::other("there is no temporary file"))
    }

    fn failed(&self, error: &io::Error) -> io::Error {
        about(&self.folder, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_in_the_order_they_came_whether_spilled_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let mut spill = Spill::new(folder.path());
        let mut shelves = [Shelf::default(), Shelf::default()];
        let payload = |number: u64| vec![number as u8; (number as usize % 400) + 1];
        for number in 0..2000_u64 {
            let shelf = &mut shelves[number as usize % 2];
            shelf.push(number, &payload(number));
            if number % 97 == 0 {
                spill.put(shelf).unwrap();
            }
        }
        for (start, shelf) in (0..).zip(&mut shelves) {
            assert_eq!(shelf.len(), 1000);
            let mut next = start;
            let take = |rows: &[u8]| {
                each_row(rows, |time, bytes| {
                    assert_eq!((time, bytes), (next, &payload(next)[..]));
                    next += 2;
                });
                Ok(())
            };
            spill.take(shelf, take).unwrap();
            assert_eq!(next, start + 2000);
        }
        assert_eq!((spill.blocks, spill.end), (0, 0));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
