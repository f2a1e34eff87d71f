//! Out of a recording: tables of signals, and frames in the formats of other tools.

pub mod can_table;
pub mod catalogue;
mod foreign;
pub mod frames;
pub mod message_table;
pub mod ordered;
pub mod output;
pub mod parquet;
pub mod period;
pub mod rows;
pub mod shape;
pub mod stream;
pub mod table;
pub mod text;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io;

use crate::frame::{Frame, Stamped, Timestamp};
use catalogue::Catalogue;

/// Writes rows of many tables in one format. Rows come in the order of the input.
pub trait TableWriter {
    /// Writes a row: `payload` is what the plan of the table decodes.
    fn write(
        &mut self,
        catalogue: &Catalogue,
        table: u32,
        time: Timestamp,
        payload: &[u8],
    ) -> io::Result<()>;
    /// Completes the output.
    fn finish(&mut self, catalogue: &Catalogue) -> io::Result<()>;
    /// Files written so far.
    fn files(&self) -> u64;
    /// Sentences about what was done differently from what one might expect.
    fn notes(&self) -> Vec<String> {
        Vec::new()
    }
}

impl<W: TableWriter + ?Sized> TableWriter for Box<W> {
    fn write(
        &mut self,
        catalogue: &Catalogue,
        table: u32,
        time: Timestamp,
        payload: &[u8],
    ) -> io::Result<()> {
        (**self).write(catalogue, table, time, payload)
    }

    fn finish(&mut self, catalogue: &Catalogue) -> io::Result<()> {
        (**self).finish(catalogue)
    }

    fn files(&self) -> u64 {
        (**self).files()
    }

    fn notes(&self) -> Vec<String> {
        (**self).notes()
    }
}

/// A name of a bus or message as part of a path: what is no letter, digit, `_`, `-` or `.` is
/// written as `%` and two hexadecimal digits, which readers of datasets undo.
pub fn path_name(name: &str) -> String {
    name.bytes().enumerate().fold(String::new(), |mut text, (at, byte)| {
        match byte {
            b'.' if at == 0 => text.push_str("%2E"),
            b'0'..=b'9' | b'A'..=b'Z' | b'a'..=b'z' | b'_' | b'-' | b'.' => {
                text.push(char::from(byte));
            }
            _ => {
                // Writing to a String cannot fail.
                let _ = write!(text, "%{byte:02X}");
            }
        }
        text
    })
}

/// A bus, as the head of a log has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusHead {
    /// Its name.
    pub name: String,
    /// Bits per second, if known (CAN: of the arbitration phase).
    pub bitrate: Option<u32>,
}

/// Writes frames in one format, in the order given (time order over all buses).
pub trait FrameWriter {
    /// Writes a frame. `bus` is an index into the names given at creation.
    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()>;
    /// Makes a bus known that was not at creation: its index is the next one.
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()>;
    /// Completes the output. What the format could not keep is in [`FrameWriter::unkept`].
    fn finish(&mut self) -> io::Result<()>;
    /// What this format cannot keep and how often that happened: ("direction", 12),
    /// ("nanoseconds", 4000), ("error frames", 1). Names that end in "frames" count frames that are
    /// not in the output at all.
    fn unkept(&self) -> &BTreeMap<&'static str, u64>;
}
