//! Logs as `candump -l` writes them, with the direction behind each frame (can-utils, `lib.c`,
//! `candump.c`): what canplayer replays.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::kept::Unkept;
use super::{candump_line, text};
use crate::frame::{Frame, Stamped};

/// Written at once.
const BUFFER: usize = 64 << 10;
const SECOND: u64 = 1_000_000_000;

/// Starts a log.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    let names = buses.iter().map(name).collect();
    Candump { out, names, buffer: Vec::with_capacity(BUFFER + 512), unkept: Unkept::default() }
}

struct Candump<W> {
    out: W,
    names: Vec<Vec<u8>>,
    buffer: Vec<u8>,
    unkept: Unkept,
}

fn name(bus: &BusHead) -> Vec<u8> {
    bus.name.clone().into_bytes()
}

impl<W: Write> FrameWriter for Candump<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.push(name(bus));
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let (Frame::Can(can), Some(name)) = (&frame.value, self.names.get(usize::from(bus))) else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        let nanos = frame.time.nanos();
        self.unkept.time(nanos, 1000);
        let out = &mut self.buffer;
        out.push(b'(');
        text::decimal(out, nanos / SECOND, 10, b'0');
        out.push(b'.');
        text::decimal(out, nanos % SECOND / 1000, 6, b'0');
        out.extend_from_slice(b") ");
        out.extend_from_slice(name);
        out.push(b' ');
        candump_line::put(out, can);
        candump_line::put_direction(out, can);
        out.push(b'\n');
        if out.len() >= BUFFER {
            self.out.write_all(out)?;
            out.clear();
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.write_all(&self.buffer)?;
        self.buffer.clear();
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}
