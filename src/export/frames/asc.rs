//! Vector ASC; [`crate::import::asc`] says where its facts are from.
//!
//! Numbers are hexadecimal and times absolute: seconds with six decimals since the start, which is
//! whole milliseconds, in UTC, as the head has it.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::kept::Unkept;
use super::{channels, fd_dlc, text};
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};
use crate::text::asc_date;

/// Written at once.
const BUFFER: usize = 64 << 10;
const SECOND: u64 = 1_000_000_000;
const MILLISECOND: u64 = 1_000_000;
/// Columns of an identifier.
const ID_WIDTH: usize = 15;
/// `CAN_ERR_BUSERROR`: what an error frame without details is read as again.
const BUS_ERROR: u32 = 0x80;

/// Starts a log.
pub fn create<W: Write>(out: W, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    Asc {
        out,
        channels: channels::numbers(buses),
        names: buses.iter().map(|bus| bus.name.clone()).collect(),
        start: None,
        buffer: Vec::with_capacity(BUFFER + 1024),
        unkept: Unkept::default(),
    }
}

struct Asc<W> {
    out: W,
    channels: Vec<u16>,
    names: Vec<String>,
    start: Option<u64>,
    buffer: Vec<u8>,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Asc<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        channels::add(&mut self.channels, bus);
        self.names.push(bus.name.clone());
        if self.start.is_some() {
            self.put_name(self.names.len() - 1);
        }
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let (Frame::Can(can), Some(&channel)) = (&frame.value, self.channels.get(usize::from(bus)))
        else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        let nanos = frame.time.nanos();
        let start = match self.start {
            Some(start) => start,
            None => self.begin(nanos),
        };
        if nanos < start {
            self.unkept.add("times before that of the first frame");
        }
        let since = nanos.saturating_sub(start);
        self.unkept.time(since, 1000);
        let out = &mut self.buffer;
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
        out.push(b'\n');
        if out.len() >= BUFFER {
            self.out.write_all(out)?;
            out.clear();
        }
        Ok(())
    }

    fn finish(&mut self) -> io::Result<()> {
        if self.start.is_none() {
            self.begin(0);
        }
        self.buffer.extend_from_slice(b"End TriggerBlock\n");
        self.out.write_all(&self.buffer)?;
        self.buffer.clear();
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

impl<W> Asc<W> {
    fn begin(&mut self, first: u64) -> u64 {
        let start = first / MILLISECOND * MILLISECOND;
        self.start = Some(start);
        let date = asc_date(Timestamp(start));
        let head = format!(
            "date {date}\nbase hex  timestamps absolute\ninternal events logged\n// version 9.0.0\n"
        );
        self.buffer.extend_from_slice(head.as_bytes());
        for number in 0..self.names.len() {
            self.put_name(number);
        }
        let begin = format!("Begin Triggerblock {date}\n   0.000000 Start of measurement\n");
        self.buffer.extend_from_slice(begin.as_bytes());
        start
    }

    /// ASC knows channels by number only; readers pass over comments.
    fn put_name(&mut self, index: usize) {
        let (number, name) = (self.channels[index], &self.names[index]);
        self.buffer.extend_from_slice(format!("// bus {number} = {name}\n").as_bytes());
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
