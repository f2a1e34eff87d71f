//! Bytes of serial lines as hexadecimal text with times: what `bustape cat -N` prints.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::fitting::Fitting;
use super::kept::Unkept;
use super::text;
use crate::frame::{Frame, Stamped};

const SECOND: u64 = 1_000_000_000;

/// Starts a text.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    Hex { out, names: Fitting::of(buses), line: Vec::new(), unkept: Unkept::default() }
}

struct Hex<W> {
    out: W,
    names: Fitting,
    line: Vec<u8>,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Hex<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.add(bus);
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let Frame::Serial(bytes) = &frame.value else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        if bytes.data.is_empty() {
            // Its errors would be comments, of which nobody knows the time.
            self.unkept.add("empty serial frames");
            return Ok(());
        }
        let Some(name) = self.names.get(bus, &mut self.unkept) else { return Ok(()) };
        let (nanos, mut time) = (frame.time.nanos(), vec![b'(']);
        text::decimal(&mut time, nanos / SECOND, 10, b'0');
        time.push(b'.');
        text::decimal(&mut time, nanos % SECOND, 9, b'0');
        time.extend_from_slice(b") ");
        self.line.clear();
        crate::text::hex::put(&mut self.line, &time, name, bytes);
        self.out.write_all(&self.line)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}
