//! CSV of frames: every property in a column of its own, or the seven columns of python-can.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::fitting::Fitting;
use super::kept::Unkept;
use super::lines::Lines;
use super::text;
use crate::export::text::put_base64;
use crate::frame::{CanFlags, CanFrame, Frame, Stamped};

const SECOND: u64 = 1_000_000_000;
const HEAD: &[u8] = b"time,bus,id,ext,rtr,error,fd,brs,esi,dir,dlc,data\n";
const PYTHON_CAN_HEAD: &[u8] = b"timestamp,arbitration_id,extended,remote,error,dlc,data\n";

/// Which columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Columns {
    /// Everything, data in hexadecimal.
    All,
    /// Those of `can.CSVWriter` (python-can 4): no bus, direction or CAN FD; data in base64.
    PythonCan,
}

/// Starts a table.
pub fn create<W: Write>(out: W, buses: &[BusHead], columns: Columns) -> impl FrameWriter + use<W> {
    let head = if columns == Columns::All { HEAD } else { PYTHON_CAN_HEAD };
    let names = Fitting::of(buses);
    let mut lines = Lines::new(out);
    lines.text().extend_from_slice(head);
    Csv { lines, names, columns, unkept: Unkept::default() }
}

struct Csv<W> {
    lines: Lines<W>,
    names: Fitting,
    columns: Columns,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Csv<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.add(bus);
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let Frame::Can(can) = &frame.value else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        let nanos = frame.time.nanos();
        let out = self.lines.text();
        text::decimal(out, nanos / SECOND, 1, b'0');
        out.push(b'.');
        text::decimal(out, nanos % SECOND, 9, b'0');
        match self.columns {
            Columns::All => {
                out.push(b',');
                let name = self.names.get(bus, &mut self.unkept).unwrap_or_default();
                out.extend_from_slice(name.as_bytes());
                all(out, can);
            }
            Columns::PythonCan => {
                if can.flags.has(CanFlags::FD) {
                    self.unkept.add("that frames are CAN FD");
                }
                if can.flags.has(CanFlags::TX) {
                    self.unkept.add("direction");
                }
                python_can(out, can);
            }
        }
        self.lines.end(b"\n")
    }

    fn finish(&mut self) -> io::Result<()> {
        self.lines.finish()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

fn all(out: &mut Vec<u8>, frame: &CanFrame) {
    out.push(b',');
    text::hex_number(out, frame.id);
    let flags = [
        CanFlags::EXTENDED,
        CanFlags::REMOTE,
        CanFlags::ERROR,
        CanFlags::FD,
        CanFlags::BRS,
        CanFlags::ESI,
    ];
    for flag in flags {
        out.extend_from_slice(&[b',', b'0' + u8::from(frame.flags.has(flag))]);
    }
    out.extend_from_slice(if frame.flags.has(CanFlags::TX) { b",tx," } else { b",rx," });
    text::decimal(out, dlc(frame), 1, b'0');
    out.push(b',');
    frame.data().iter().for_each(|byte| text::hex(out, *byte));
}

fn python_can(out: &mut Vec<u8>, frame: &CanFrame) {
    out.extend_from_slice(b",0x");
    text::hex_number(out, frame.id);
    // python-can calls error frames extended unless told otherwise.
    for flag in [CanFlags::EXTENDED, CanFlags::REMOTE, CanFlags::ERROR] {
        out.extend_from_slice(&[b',', b'0' + u8::from(frame.flags.has(flag))]);
    }
    out.push(b',');
    let length =
        if frame.flags.has(CanFlags::REMOTE) { dlc(frame) } else { frame.data().len() as u64 };
    text::decimal(out, length, 1, b'0');
    out.push(b',');
    put_base64(out, frame.data());
}

/// The length of the data, or what the frame says besides.
fn dlc(frame: &CanFrame) -> u64 {
    let said = frame.flags.has(CanFlags::REMOTE) || frame.dlc > 0;
    if said { frame.dlc.into() } else { frame.data().len() as u64 }
}
