//! Vector ASC; [`crate::import::asc`] says where its facts are from.
//!
//! Numbers are hexadecimal and times absolute: seconds with six decimals since the start, which is
//! whole milliseconds, in UTC, as the head has it.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::channels::Channels;
use super::fitting::in_one_line;
use super::kept::Unkept;
use super::lines::Lines;
use super::start::Start;
use super::text;
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp, fd_dlc};
use crate::text::asc_date;

const SECOND: u64 = 1_000_000_000;
/// Columns of an identifier.
const ID_WIDTH: usize = 15;
/// `CAN_ERR_BUSERROR`: what an error frame without details is read as again.
const BUS_ERROR: u32 = 0x80;

/// Starts a log.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    Asc {
        lines: Lines::new(out),
        channels: Channels::of(buses),
        start: Start::default(),
        unkept: Unkept::default(),
    }
}

struct Asc<W> {
    lines: Lines<W>,
    channels: Channels,
    start: Start,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Asc<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.channels.add(bus);
        if self.start.nanos().is_some() {
            put_name(self.lines.text(), self.channels.list().last());
        }
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let (Frame::Can(can), Some(channel)) = (&frame.value, self.channels.number(bus)) else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        self.begin(frame.time);
        let since = self.start.since(frame.time, &mut self.unkept);
        self.unkept.time(since, 1000);
        let out = self.lines.text();
        text::decimal(out, since / SECOND, 4, b' ');
        out.push(b'.');
        text::decimal(out, since % SECOND / 1000, 6, b'0');
        out.push(b' ');
        if can.flags.has(CanFlags::ERROR) {
            if can.id != BUS_ERROR || can.data().iter().any(|byte| *byte != 0) {
                self.unkept.add("details of errors");
            }
            text::decimal(out, channel.into(), 1, b' ');
            out.extend_from_slice(b"  ErrorFrame");
        } else if can.flags.has(CanFlags::FD) {
            flexible(out, channel, can);
        } else {
            classic(out, channel, can);
        }
        self.lines.end(b"\n")
    }

    fn finish(&mut self) -> io::Result<()> {
        self.begin(Timestamp(0));
        self.lines.text().extend_from_slice(b"End TriggerBlock\n");
        self.lines.finish()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

impl<W> Asc<W> {
    /// Writes the head, once.
    fn begin(&mut self, first: Timestamp) {
        if !self.start.begin(first.nanos()) {
            return;
        }
        let date = asc_date(Timestamp(self.start.nanos().unwrap_or_default()));
        let out = self.lines.text();
        let head = format!(
            "date {date}\nbase hex  timestamps absolute\ninternal events logged\n// version 9.0.0\n"
        );
        out.extend_from_slice(head.as_bytes());
        self.channels.list().iter().for_each(|bus| put_name(out, Some(bus)));
        let begin = format!("Begin Triggerblock {date}\n   0.000000 Start of measurement\n");
        out.extend_from_slice(begin.as_bytes());
    }
}

/// ASC knows channels by number only; readers pass over comments.
fn put_name(out: &mut Vec<u8>, bus: Option<&(u16, String)>) {
    if let Some((number, name)) = bus {
        let name = in_one_line(name);
        out.extend_from_slice(format!("// bus {number} = {name}\n").as_bytes());
    }
}

fn identifier(out: &mut Vec<u8>, frame: &CanFrame) {
    text::hex_number(out, frame.id);
    if frame.flags.has(CanFlags::EXTENDED) {
        out.push(b'x');
    }
}

/// `1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40`.
fn classic(out: &mut Vec<u8>, channel: u16, frame: &CanFrame) {
    let start = out.len();
    text::decimal(out, channel.into(), 1, b' ');
    text::pad(out, start, 2);
    out.push(b' ');
    let start = out.len();
    identifier(out, frame);
    text::pad(out, start, ID_WIDTH);
    out.extend_from_slice(if frame.flags.has(CanFlags::TX) { b" Tx   " } else { b" Rx   " });
    let remote = frame.flags.has(CanFlags::REMOTE);
    #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
    let dlc = if remote || frame.dlc > 8 { frame.dlc } else { frame.data().len() as u8 };
    out.extend_from_slice(if remote { b"r " } else { b"d " });
    text::hex_number(out, dlc.into());
    text::spaced(out, frame.data());
}

/// `CANFD   1 Rx   18EBFF00x  <no name> 1 0 9 12 01 ...` and the columns behind the data, of which
/// only the flags are known.
fn flexible(out: &mut Vec<u8>, channel: u16, frame: &CanFrame) {
    let has = |flag| frame.flags.has(flag);
    out.extend_from_slice(b"CANFD ");
    text::decimal(out, channel.into(), 3, b' ');
    out.extend_from_slice(if has(CanFlags::TX) { b" Tx   " } else { b" Rx   " });
    let start = out.len();
    identifier(out, frame);
    text::pad(out, start, ID_WIDTH);
    // The name of the message would stand here.
    out.resize(out.len() + 32, b' ');
    let (brs, esi) = (has(CanFlags::BRS), has(CanFlags::ESI));
    out.extend_from_slice(&[b' ', b'0' + u8::from(brs), b' ', b'0' + u8::from(esi), b' ']);
    text::hex_number(out, fd_dlc(frame.data().len()).into());
    out.push(b' ');
    text::decimal(out, frame.data().len() as u64, 2, b' ');
    text::spaced(out, frame.data());
    out.extend_from_slice(b"        0    0 ");
    let flags = 0x1000 | u32::from(brs) << 13 | u32::from(esi) << 14;
    let start = out.len();
    text::hex_number(out, flags);
    text::pad(out, start, 8);
    out.extend_from_slice(b" 0 0 0 0 0");
}
