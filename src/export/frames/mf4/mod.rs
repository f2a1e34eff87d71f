//! MDF 4.11 with bus logging, as asammdf, python-can and the tools of the car industry read it.
//!
//! Sources: ASAM MDF 4.1 (blocks) and its associated standard for bus logging (`CAN_DataFrame`,
//! `CAN_ErrorFrame`, `CAN_RemoteFrame` and the names of their fields), in the reading of the public
//! implementation asammdf (`blocks/v4_constants.py`) and python-can (`can/io/mf4.py`).
//!
//! Each bus has a channel group for each kind of frame it carries: classic, FD, error, remote. The
//! records of a group are compressed in blocks (DZ, transposed: the first bytes of all records, then
//! the second ones, ...), which a list (HL, DL) at the end of the file holds together. Blocks are
//! written as they fill up; the description of all goes to the end.

mod block;
mod groups;
mod record;

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};

use self::block::{Blocks, block, text};
use self::groups::Group;
use self::record::Kind;
use super::super::{BusHead, FrameWriter};
use super::channels::Channels;
use super::kept::Unkept;
use super::start::Start;
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};

/// What the identification says: MDF 4.11, written by this program.
const VERSION: u16 = 411;
const IDENTIFICATION: usize = 64;
/// Records of all groups that wait to be written, bytes; more is written before its block is full.
const WAITING: usize = 16 << 20;

/// Starts a file. `out` is at its beginning, which [`FrameWriter::finish`] writes again.
pub fn create<W: Write + Seek>(
    mut out: W,
    buses: &[BusHead],
) -> io::Result<impl FrameWriter + use<W>> {
    let history = history(IDENTIFICATION as u64 + 104);
    let head = [identification(), header(0, 0), history].concat();
    out.write_all(&head)?;
    Ok(Mf4 {
        out,
        at: head.len() as u64,
        channels: Channels::of(buses),
        start: Start::default(),
        groups: BTreeMap::new(),
        waiting: 0,
        unkept: Unkept::default(),
    })
}

struct Mf4<W> {
    out: W,
    /// Bytes written.
    at: u64,
    channels: Channels,
    start: Start,
    groups: BTreeMap<(u16, Kind), Group>,
    /// Bytes of records in all groups.
    waiting: usize,
    unkept: Unkept,
}

impl<W: Write + Seek> FrameWriter for Mf4<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.channels.add(bus);
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        match &frame.value {
            Frame::Can(can) => self.can(bus, frame.time, can)?,
            other => self.unkept.frame(other),
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        for group in self.groups.values_mut() {
            self.at += group.write_block(&mut self.out, self.at)?;
        }
        let mut blocks = Blocks::new(self.at);
        let mut next = 0;
        // From the last group on, since each names the next one.
        for ((bus, _), group) in self.groups.iter().rev() {
            next = group.describe(&mut blocks, self.channels.name(*bus), next);
        }
        self.out.write_all(&blocks.bytes)?;
        self.out.seek(SeekFrom::Start(IDENTIFICATION as u64))?;
        self.out.write_all(&header(next, self.start.nanos().unwrap_or(0)))?;
        self.out.seek(SeekFrom::End(0))?;
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

impl<W: Write> Mf4<W> {
    fn can(&mut self, bus: u16, time: Timestamp, can: &CanFrame) -> io::Result<()> {
        // Readers keep the start to the microsecond; a whole millisecond keeps sums exact.
        self.start.begin(time.nanos());
        let since = self.start.since(time, &mut self.unkept);
        let kind = Kind::of(can);
        if kind == Kind::Error && can.flags.has(CanFlags::FD) {
            self.unkept.add("that an error was on FD");
        }
        let channel = self.channels.number(bus).unwrap_or(0);
        let channel = u8::try_from(channel).unwrap_or(u8::MAX);
        let group = self.groups.entry((bus, kind)).or_insert_with(|| Group::new(kind));
        group.add(since, channel, can);
        self.waiting += kind.size();
        if group.is_full() {
            self.waiting -= group.waiting();
            self.at += group.write_block(&mut self.out, self.at)?;
        } else if self.waiting > WAITING {
            for group in self.groups.values_mut() {
                self.at += group.write_block(&mut self.out, self.at)?;
            }
            self.waiting = 0;
        }
        Ok(())
    }
}

fn identification() -> Vec<u8> {
    let mut bytes = b"MDF     4.11    bustape ".to_vec();
    bytes.resize(28, 0);
    bytes.extend(VERSION.to_le_bytes());
    bytes.resize(IDENTIFICATION, 0);
    bytes
}

/// The header (HD): first data group, history, start in nanoseconds since 1970 (UTC).
fn header(first_group: u64, start: u64) -> Vec<u8> {
    let mut data = start.to_le_bytes().to_vec();
    // Offsets of the time zone: 0 and 0 minutes, and valid (bit 1 of the next byte).
    data.extend([0, 0, 0, 0, 2, 0, 0, 0]);
    data.extend([0; 16]);
    let history = IDENTIFICATION as u64 + 104;
    block(b"##HD", &[first_group, history, 0, 0, 0, 0], &data)
}

/// The history (FH) with its comment, at this address: which program made the file. Without a time,
/// so that the same frames make the same file.
fn history(address: u64) -> Vec<u8> {
    let comment = text(
        b"##MD",
        concat!(
            "<FHcomment xmlns=\"http://www.asam.net/mdf/v4\"><TX>export</TX>",
            "<tool_id>bustape</tool_id><tool_vendor>bustape</tool_vendor><tool_version>",
            env!("CARGO_PKG_VERSION"),
            "</tool_version></FHcomment>"
        ),
    );
    let mut data = [0; 16];
    data[12] = 2;
    [block(b"##FH", &[0, address + 56], &data), comment].concat()
}
