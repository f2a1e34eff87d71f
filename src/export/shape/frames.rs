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
    /// Names of buses, as the writer knows them.
    buses: Vec<(String, u32)>,
    /// The words of flags: of CAN frames by their bits, then of received and of sent bytes.
    flags: Vec<u32>,
}

/// Combinations of the flags of CAN frames.
const COMBINATIONS: u8 = 128;

impl Frames {
    /// To `out`, which has the layout of [`layout`].
    pub fn new(mut out: Box<dyn FlatWriter>) -> Self {
        let words = |bits: u8| {
            let set = FLAGS.iter().filter(|(flag, _)| CanFlags(bits).has(*flag));
            set.map(|(_, name)| *name).collect::<Vec<_>>().join(" ")
        };
        let flags = (0..COMBINATIONS).map(words);
        let flags = flags.chain(["serial rx", "serial tx"].map(str::to_owned));
        let flags = flags.map(|words| out.know(&words)).collect();
        Self { out, row: Row::default(), buses: Vec::new(), flags }
    }

    /// Writes a frame, or the bytes of one read of a serial line; false for what is neither.
    pub fn write(&mut self, bus: &str, time: Timestamp, frame: &Frame) -> io::Result<bool> {
        let known = self.buses.iter().find(|(name, _)| name == bus).map(|(_, known)| *known);
        let known = known.unwrap_or_else(|| {
            let known = self.out.know(bus);
            self.buses.push((bus.to_owned(), known));
            known
        });
        let flags = |at: u8| self.flags.get(usize::from(at)).copied();
        let row = &mut self.row;
        row.clear(0);
        row.push_known(Some(known));
        match frame {
            Frame::Can(can) => {
                row.push(Value::Unsigned(can.id.into()));
                row.push_known(flags(can.flags.0 & (COMBINATIONS - 1)));
                let said = (can.dlc > 0).then_some(Value::Unsigned(can.dlc.into()));
                row.push(said.unwrap_or_default());
                row.push_bytes(can.data());
            }
            Frame::Serial(bytes) => {
                row.push(Value::Absent);
                let tx = bytes.direction == Direction::Tx;
                row.push_known(flags(COMBINATIONS + u8::from(tx)));
                row.push(Value::Absent);
                row.push_bytes(&bytes.data);
            }
            Frame::Gap(_) | Frame::Notice(_) => return Ok(false),
        }
        self.out.row(time, row)?;
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
