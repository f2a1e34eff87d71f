//! MDF 4 with bus logging, as data loggers and measuring tools write it.
//!
//! Sources: ASAM MDF 4.1 (blocks) and its associated standard for bus logging (names of fields), in
//! the reading of the public implementations asammdf (`blocks/v4_constants.py`) and python-can
//! (`can/io/mf4.py`). All numbers of blocks have their lowest byte first.
//!
//! Frames are records of channel groups that hold `CAN_DataFrame`, `CAN_ErrorFrame` or
//! `CAN_RemoteFrame`. Groups are read side by side and put together in the order of time. A file
//! whose recorder was cut off (`UnFinMF`) is read as far as its data go.

mod blocks;
mod channels;
mod data;
mod describe;
mod event;
mod field;
mod packed;
mod records;
mod signal;

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io::{Read, Seek};

use self::blocks::{BlockError, File};
use self::records::{Records, Told, Unfinished};
use super::little_endian::{u16_at, u64_at};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Skipped};
use crate::frame::{Frame, Stamped, Timestamp};

/// Frames given at a time.
const BATCH: usize = 4096;
/// Identification in front of the header block.
const IDENTIFICATION: usize = 64;

/// True if a file that begins so is an MDF file, of version 4 or an older one.
pub fn recognises(head: &[u8]) -> bool {
    head.starts_with(b"MDF  ") || head.starts_with(b"UnFinMF ")
}

/// Opens a log.
///
/// # Errors
/// It cannot be read, or is no MDF file of version 4.
pub fn open<R: Read + Seek>(input: R) -> Result<impl LogReader + use<R>, ImportError> {
    let mut file = File::new(input)?;
    let mut head = Vec::new();
    file.read(0, IDENTIFICATION, &mut head)?;
    let version = u16_at(&head, 28);
    match version {
        _ if !recognises(&head) => {
            return Err(ImportError::Format(
                "it is no MDF file: it does not begin with MDF".into(),
            ));
        }
        Some(400..=499) => {}
        Some(other) => {
            let text = format!("it is MDF of version {}.{:02}", other / 100, other % 100);
            return Err(ImportError::Format(format!("{text}; only version 4 has bus logging")));
        }
        None => return Err(ImportError::Format("it is no whole MDF file: it is too short".into())),
    }
    // Bit 2: length of the last data block, bit 6: places of values of any length.
    let flags = u16_at(&head, 60).unwrap_or(0);
    let cut = head.starts_with(b"UnFinMF");
    let unfinished = Unfinished { lengths: cut, offsets: cut && flags & 0x40 != 0 };
    let mut skipped = Skipped::default();
    let mut log = Mf4 {
        start: 0,
        sources: Vec::new(),
        order: BinaryHeap::new(),
        buses: Names::default(),
        notes: Vec::new(),
        skipped: Skipped::default(),
        file,
    };
    let header = match log.file.block(IDENTIFICATION as u64, *b"##HD") {
        Ok(header) => header,
        Err(BlockError::Odd(why)) => {
            return Err(ImportError::Format(format!("it is no whole MDF file: {why}")));
        }
        Err(BlockError::Read(error)) => return Err(error.into()),
    };
    log.start = u64_at(&header.data, 0).unwrap_or(0);
    if header.data.get(12).is_some_and(|flags| flags & 1 != 0) {
        log.notes.push("its start is in an unknown local time, and is read as UTC".into());
    }
    let description = describe::read(&mut log.file, header.link(0), &mut skipped);
    let description = description.map_err(read_error)?;
    if !description.others.is_empty() {
        let mut names: Vec<String> = description.others.keys().take(5).cloned().collect();
        names.retain(|name| !name.is_empty());
        let groups = description.others.len();
        let records: u64 = description.others.values().sum();
        let names =
            if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) };
        log.notes.push(format!(
            "{groups} kinds of channel groups{names} with {records} records hold no CAN frames"
        ));
    }
    for group in description.data_groups {
        if group.groups.iter().any(|group| group.event.is_some()) {
            log.sources.push(Records::new(group, unfinished));
        }
    }
    log.skipped = skipped;
    for index in 0..log.sources.len() {
        log.line_up(index)?;
    }
    Ok(log)
}

struct Mf4<R> {
    file: File<R>,
    /// Zero of the records' times, nanoseconds since 1970.
    start: u64,
    sources: Vec<Records>,
    /// Which source has the earliest frame.
    order: BinaryHeap<Reverse<(i64, usize)>>,
    buses: Names,
    notes: Vec<String>,
    skipped: Skipped,
}

impl<R: Read + Seek> LogReader for Mf4<R> {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let full = into.len() + BATCH;
        while let Some(Reverse((_, index))) = self.order.pop() {
            if let Some(told) = self.sources[index].ready.pop_front() {
                into.extend(self.told(index, told));
            }
            self.line_up(index)?;
            if into.len() >= full {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn buses(&self) -> &[String] {
        self.buses.list()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn times_are_relative(&self) -> bool {
        self.start == 0
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl<R: Read + Seek> Mf4<R> {
    /// Puts a source where its next frame belongs.
    fn line_up(&mut self, index: usize) -> Result<(), ImportError> {
        let source = &mut self.sources[index];
        if source.ready.is_empty() {
            source.fill(&mut self.file, &mut self.skipped).map_err(read_error)?;
        }
        if let Some(next) = source.ready.front() {
            self.order.push(Reverse((next.time, index)));
        }
        Ok(())
    }

    /// Gives a frame to its bus: the one of its record, or the one of its group.
    fn told(&mut self, source: usize, told: Told) -> Option<LogFrame> {
        let bus = if let Some(number) = told.channel {
            self.buses.numbered(number)
        } else {
            let event = self.sources[source].groups[told.group].event.as_ref();
            self.buses.index(event.map_or("", |event| &event.bus))
        };
        let time = Timestamp(self.start.saturating_add_signed(told.time));
        match bus {
            Ok(bus) => {
                let frame = Stamped { time, value: Frame::Can(told.frame) };
                Some(LogFrame { bus, frame })
            }
            Err(why) => {
                self.skipped.add(|| format!("the frame at {} ns", time.nanos()), || why);
                None
            }
        }
    }
}

fn read_error(error: BlockError) -> ImportError {
    match error {
        BlockError::Odd(why) => ImportError::Format(why),
        BlockError::Read(error) => error.into(),
    }
}

#[cfg(test)]
mod tests;
