//! Logs as `candump -l` writes them, with the direction behind each frame (can-utils, `lib.c`,
//! `candump.c`): what canplayer replays.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::fitting::Fitting;
use super::kept::Unkept;
use super::lines::Lines;
use super::text;
use crate::frame::{Frame, Stamped};

const SECOND: u64 = 1_000_000_000;

/// Starts a log.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    Candump { lines: Lines::new(out), names: Fitting::of(buses), unkept: Unkept::default() }
}

struct Candump<W> {
    lines: Lines<W>,
    names: Fitting,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Candump<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.add(bus);
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let Frame::Can(can) = &frame.value else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        let Some(name) = self.names.get(bus, &mut self.unkept) else { return Ok(()) };
        let nanos = frame.time.nanos();
        self.unkept.time(nanos, 1000);
        let out = self.lines.text();
        out.push(b'(');
        text::decimal(out, nanos / SECOND, 10, b'0');
        out.push(b'.');
        text::decimal(out, nanos % SECOND / 1000, 6, b'0');
        out.extend_from_slice(b") ");
        out.extend_from_slice(name.as_bytes());
        out.push(b' ');
        crate::text::candump::put(out, can);
        crate::text::candump::put_direction(out, can);
        self.lines.end(b"\n")
    }

    fn finish(&mut self) -> io::Result<()> {
        self.lines.finish()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}
