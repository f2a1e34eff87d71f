//! Out of a recording: tables of signals, and frames in the formats of other tools.

pub mod frames;
pub mod output;

use std::collections::BTreeMap;
use std::io;

use crate::frame::{Frame, Stamped};

/// A bus, as the head of a log has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BusHead {
    /// Its name.
    pub name: String,
    /// A serial line; else CAN.
    pub serial: bool,
    /// Bits per second, if known (CAN: of the arbitration phase).
    pub bitrate: Option<u32>,
}

/// Writes frames in one format, in the order given (time order over all buses).
pub trait FrameWriter {
    /// Writes a frame. `bus` is an index into the names given at creation.
    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()>;
    /// Completes the output. What the format could not keep is in [`FrameWriter::unkept`].
    fn finish(&mut self) -> io::Result<()>;
    /// What this format cannot keep and how often that happened: ("direction", 12),
    /// ("nanoseconds", 4000), ("error frames", 1). Names that end in "frames" count frames that are
    /// not in the output at all.
    fn unkept(&self) -> &BTreeMap<&'static str, u64>;
}
