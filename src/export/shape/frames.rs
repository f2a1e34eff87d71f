//! A row for each raw frame: time, bus, id, flags, dlc, data.

use std::io;

use super::{column, table, texts};
use crate::export::rows::FlatWriter;
use crate::export::table::{Kind, Row, Table, Value};
use crate::frame::{CanFlags, Direction, Frame, Timestamp};

/// What the table looks like.
pub fn layout() -> Table {
    table(vec![
        texts("bus"),
        column("id", Kind::Unsigned(32)),
        texts("flags"),
        column("dlc", Kind::Unsigned(8)),
        column("data", Kind::Bytes),
    ])
}

/// Names of the flags, in the order they are written.
const FLAGS: [(CanFlags, &str); 7] = [
    (CanFlags::EXTENDED, "ext"),
    (CanFlags::REMOTE, "remote"),
    (CanFlags::ERROR, "error"),
    (CanFlags::FD, "fd"),
    (CanFlags::BRS, "brs"),
    (CanFlags::ESI, "esi"),
    (CanFlags::TX, "tx"),
];

/// Writes frames.
pub struct Frames {
    out: Box<dyn FlatWriter>,
    row: Row,
    flags: String,
}

impl Frames {
    /// To `out`, which has the layout of [`layout`].
    pub fn new(out: Box<dyn FlatWriter>) -> Self {
        Self { out, row: Row::default(), flags: String::new() }
    }

    /// Writes a frame, or the bytes of one read of a serial line; false for what is neither.
    pub fn write(&mut self, bus: &str, time: Timestamp, frame: &Frame) -> io::Result<bool> {
        self.row.clear(0);
        self.row.push_text(Some(bus));
        match frame {
            Frame::Can(can) => {
                self.flags.clear();
                for (_, name) in FLAGS.iter().filter(|(flag, _)| can.flags.has(*flag)) {
                    if !self.flags.is_empty() {
                        self.flags.push(' ');
                    }
                    self.flags.push_str(name);
                }
                self.row.push(Value::Unsigned(can.id.into()));
                self.row.push_text(Some(&self.flags));
                let said = (can.dlc > 0).then_some(Value::Unsigned(can.dlc.into()));
                self.row.push(said.unwrap_or_default());
                self.row.push_bytes(can.data());
            }
            Frame::Serial(bytes) => {
                let rx = bytes.direction == Direction::Rx;
                self.row.push(Value::Absent);
                self.row.push_text(Some(if rx { "serial rx" } else { "serial tx" }));
                self.row.push(Value::Absent);
                self.row.push_bytes(&bytes.data);
            }
            Frame::Gap(_) | Frame::Notice(_) => return Ok(false),
        }
        self.out.row(time, &self.row)?;
        Ok(true)
    }

    /// Completes the output.
    pub fn finish(&mut self) -> io::Result<()> {
        self.out.finish()
    }

    /// Files written so far.
    pub fn files(&self) -> u64 {
        self.out.files()
    }
}
