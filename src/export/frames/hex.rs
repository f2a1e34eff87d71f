//! Bytes of serial lines as hexadecimal text with times: what `bustape cat -N` prints.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::kept::Unkept;
use super::{hex_rows, text};
use crate::frame::{Frame, Stamped};

const SECOND: u64 = 1_000_000_000;

/// Starts a text.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    let names = buses.iter().map(|bus| bus.name.clone()).collect();
    Hex { out, names, line: Vec::new(), unkept: Unkept::default() }
}

struct Hex<W> {
    out: W,
    names: Vec<String>,
    line: Vec<u8>,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Hex<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.push(bus.name.clone());
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let (Frame::Serial(bytes), Some(name)) = (&frame.value, self.names.get(usize::from(bus)))
        else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        let (nanos, mut time) = (frame.time.nanos(), vec![b'(']);
        text::decimal(&mut time, nanos / SECOND, 10, b'0');
        time.push(b'.');
        text::decimal(&mut time, nanos % SECOND, 9, b'0');
        time.extend_from_slice(b") ");
        self.line.clear();
        hex_rows::put(&mut self.line, &time, name, bytes);
        self.out.write_all(&self.line)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}
