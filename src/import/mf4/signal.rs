//! Values of any length that stand apart from their records.

use std::collections::VecDeque;
use std::io::{Read, Seek};

use super::blocks::{BlockError, File};
use super::data::Data;
use crate::import::Skipped;
use crate::import::little_endian::u32_at;

/// The longest value that is believed; a frame has 64 bytes.
pub(super) const LONGEST: usize = 1 << 16;
/// Values and records that wait for each other, and how many bytes either may have.
const WAITING: usize = 1 << 16;
const WAITING_BYTES: usize = 16 << 20;
/// How often one may go back to the beginning of the data.
const RESTARTS: u32 = 100;

/// Signal data: each value behind its length in 4 bytes.
pub(super) struct Signal {
    link: u64,
    data: Data,
    unfinished: bool,
    restarts: u32,
}

impl Signal {
    pub fn new(link: u64, unfinished: bool) -> Self {
        Self { link, data: Data::new(link, unfinished), unfinished, restarts: 0 }
    }

    /// The value at `offset`, if it is there. Cheap when offsets rise.
    pub fn value<R: Read + Seek>(
        &mut self,
        offset: u64,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<Option<&[u8]>, BlockError> {
        if offset < self.data.offset {
            if self.restarts == RESTARTS {
                return Ok(None);
            }
            self.restarts += 1;
            self.data = Data::new(self.link, self.unfinished);
        }
        if !self.data.go_to(offset, file, skipped)? || !self.data.want(4, file, skipped)? {
            return Ok(None);
        }
        let length = u32_at(self.data.bytes(), 0).unwrap_or(0) as usize;
        if length > LONGEST || !self.data.want(4 + length, file, skipped)? {
            return Ok(None);
        }
        Ok(self.data.bytes().get(4..4 + length))
    }
}

/// Values in records of a group of their own, mixed with those that they belong to.
pub(super) struct Mixed {
    /// Address of their group.
    pub group: u64,
    /// Values belong to records by their order, as their places have not been written.
    by_order: bool,
    /// Place of the next value, counted as in signal data.
    offset: u64,
    values: VecDeque<(u64, Vec<u8>)>,
    value_bytes: usize,
    /// Records without their value.
    records: VecDeque<Waiting>,
    record_bytes: usize,
}

/// Which record it is.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Index of its group.
    pub group: usize,
    /// Its number in the group, from 0.
    pub number: u64,
    /// Nanoseconds since the start of the file.
    pub time: i64,
}

/// A record that waits for its value.
pub(super) struct Waiting {
    pub place: Place,
    /// Place of the value.
    pub offset: u64,
    pub record: Vec<u8>,
}

impl Mixed {
    pub fn new(group: u64, by_order: bool) -> Self {
        let (values, records) = (VecDeque::new(), VecDeque::new());
        Self { group, by_order, offset: 0, values, value_bytes: 0, records, record_bytes: 0 }
    }

    /// Adds a value. What is then too much is dropped, and missed later.
    pub fn add_value(&mut self, value: &[u8]) {
        self.values.push_back((self.offset, value.to_vec()));
        self.value_bytes += value.len();
        self.offset += 4 + value.len() as u64;
        while self.values.len() > WAITING || self.value_bytes > WAITING_BYTES {
            self.take_value();
        }
    }

    fn take_value(&mut self) -> Option<Vec<u8>> {
        let (_, value) = self.values.pop_front()?;
        self.value_bytes -= value.len();
        Some(value)
    }

    pub fn add_record(&mut self, waiting: Waiting) {
        self.record_bytes += waiting.record.len();
        self.records.push_back(waiting);
    }

    /// The next record and its value, once both are there; a record alone when its value cannot
    /// come any more, or too many wait.
    pub fn next(&mut self, ended: bool) -> Option<(Waiting, Option<Vec<u8>>)> {
        let wanted = self.records.front()?.offset;
        if !self.by_order {
            while self.values.front().is_some_and(|(offset, _)| *offset < wanted) {
                self.take_value();
            }
        }
        let fits = |(offset, _): &(u64, Vec<u8>)| self.by_order || *offset == wanted;
        let there = self.values.front().is_some_and(fits);
        let missed = ended
            || self.records.len() > WAITING
            || self.record_bytes > WAITING_BYTES
            || !self.by_order && !there && !self.values.is_empty();
        if !there && !missed {
            return None;
        }
        let value = if there { self.take_value() } else { None };
        let record = self.records.pop_front()?;
        self.record_bytes -= record.record.len();
        Some((record, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_nobody_asks_for_take_a_bounded_memory() {
        let mut mixed = Mixed::new(0, false);
        let value = vec![7; LONGEST];
        for _ in 0..1000 {
            mixed.add_value(&value);
        }
        let kept: usize = mixed.values.iter().map(|(_, value)| value.len()).sum();
        assert_eq!(kept, WAITING_BYTES);
        // The last one is still there for its record.
        let offset = 999 * (4 + LONGEST as u64);
        let place = Place { group: 0, number: 0, time: 0 };
        mixed.add_record(Waiting { place, offset, record: Vec::new() });
        assert!(mixed.next(false).is_some_and(|(_, found)| found == Some(value)));
        assert_eq!((mixed.value_bytes, mixed.record_bytes), (0, 0));
    }
}
