//! BLF, the binary log of Vector's tools; [`crate::import::blf`] says where its facts are from.
//!
//! CAN_MESSAGE for classic frames, CAN_FD_MESSAGE for FD, CAN_ERROR_EXT for errors (the class of
//! `linux/can/error.h` as identifier and the details as data, as python-can does), OVERRUN_ERROR
//! where something was lost. Times are nanoseconds after the start, which is whole milliseconds.

use std::collections::BTreeMap;
use std::io::{self, Seek, SeekFrom, Write};

use flate2::{Compress, Compression, FlushCompress, Status};
use jiff::tz::TimeZone;

use super::super::{BusHead, FrameWriter};
use super::channels::Channels;
use super::kept::Unkept;
use super::start::Start;
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp, Unit, fd_dlc};

/// Contents of a container: what Vector's tools write.
const CONTAINER: usize = 128 << 10;
/// Head with statistics.
const HEAD: usize = 144;
/// Signature, sizes, kind, flags, version, time.
const OBJECT_HEAD: usize = 32;
/// The interface that the file is written for: version 4.7.1 of Vector's library.
const API: u32 = 4_070_100;
/// 1990-01-01: dates before it are those of a clock that was never set, and are not written.
const NO_DATE: u64 = 631_152_000_000_000_000;
const MILLISECOND: u64 = 1_000_000;

/// Starts a log. `out` is at its beginning, which [`FrameWriter::finish`] writes again.
pub fn create<W: Write + Seek>(
    mut out: W,
    buses: &[BusHead],
) -> io::Result<impl FrameWriter + use<W>> {
    out.write_all(&[0; HEAD])?;
    Ok(Blf {
        out,
        channels: Channels::of(buses),
        start: Start::default(),
        last: Timestamp(0),
        objects: Vec::with_capacity(CONTAINER),
        packed: Vec::with_capacity(CONTAINER),
        compress: Compress::new(Compression::default(), true),
        size: HEAD as u64,
        unpacked: HEAD as u64,
        count: 0,
        unkept: Unkept::default(),
    })
}

struct Blf<W> {
    out: W,
    channels: Channels,
    /// Zero of the objects' times.
    start: Start,
    last: Timestamp,
    /// Objects that wait to be compressed.
    objects: Vec<u8>,
    packed: Vec<u8>,
    compress: Compress,
    /// Bytes of the file so far, and what they would be without compression.
    size: u64,
    unpacked: u64,
    count: u32,
    unkept: Unkept,
}

impl<W: Write + Seek> FrameWriter for Blf<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.channels.add(bus);
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let channel = self.channels.number(bus).unwrap_or(u16::MAX);
        match &frame.value {
            Frame::Can(can) => self.can(channel, frame.time, can),
            Frame::Gap(gap) if gap.unit == Unit::Frames => {
                if gap.count > 0 {
                    self.unkept.add("how many were lost in a gap");
                }
                self.object(91, frame.time, 8, |body| {
                    body.extend(1_u32.to_le_bytes());
                    body.extend(channel.to_le_bytes());
                });
            }
            Frame::Gap(_) => self.unkept.add("gaps of serial lines"),
            other => self.unkept.frame(other),
        }
        if self.objects.len() + OBJECT_HEAD + 128 > CONTAINER { self.flush() } else { Ok(()) }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        self.out.seek(SeekFrom::Start(0))?;
        self.out.write_all(&self.head())?;
        self.out.seek(SeekFrom::End(0))?;
        self.out.flush()
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}

impl<W: Write> Blf<W> {
    fn can(&mut self, channel: u16, time: Timestamp, can: &CanFrame) {
        let id = can.id | if can.flags.has(CanFlags::EXTENDED) { 1 << 31 } else { 0 };
        let sent = u8::from(can.flags.has(CanFlags::TX));
        let (data, length) = (can.data(), can.data().len());
        #[allow(clippy::cast_possible_truncation, reason = "a frame has at most 64 bytes")]
        let short = length as u8;
        if can.flags.has(CanFlags::ERROR) {
            if sent != 0 {
                self.unkept.add("the direction of an error");
            }
            self.object(73, time, 32, |body| {
                body.extend(channel.to_le_bytes());
                body.extend([0; 8]);
                body.extend([short.min(8), 0, 0, 0, 0, 0]);
                body.extend(id.to_le_bytes());
                body.extend([0; 4]);
                body.extend(&data[..length.min(8)]);
            });
        } else if can.flags.has(CanFlags::FD) {
            let bits = [(CanFlags::FD, 1), (CanFlags::BRS, 2), (CanFlags::ESI, 4)];
            let fd_flags = bits.iter().filter(|(flag, _)| can.flags.has(*flag)).map(|(_, bit)| bit);
            let fd_flags: u8 = fd_flags.sum();
            self.object(100, time, 84, |body| {
                body.extend(channel.to_le_bytes());
                body.extend([sent, fd_dlc(length)]);
                body.extend(id.to_le_bytes());
                body.extend([0, 0, 0, 0, 0, fd_flags, short, 0, 0, 0, 0, 0]);
                body.extend(data);
            });
        } else {
            let remote = if can.flags.has(CanFlags::REMOTE) { 0x80 } else { 0 };
            self.object(1, time, 16, |body| {
                body.extend(channel.to_le_bytes());
                body.extend([sent | remote, can.dlc.max(short)]);
                body.extend(id.to_le_bytes());
                body.extend(&data[..length.min(8)]);
            });
        }
    }

    /// Adds an object whose body is `length` bytes long, zero behind what `fill` adds.
    fn object(
        &mut self,
        kind: u32,
        time: Timestamp,
        length: usize,
        fill: impl FnOnce(&mut Vec<u8>),
    ) {
        self.start.begin(if time.nanos() < NO_DATE { 0 } else { time.nanos() });
        let since = self.start.since(time, &mut self.unkept);
        self.last = self.last.max(time);
        self.count = self.count.saturating_add(1);
        let objects = &mut self.objects;
        let end = objects.len() + OBJECT_HEAD + length;
        let mut head = [0; OBJECT_HEAD];
        head[..4].copy_from_slice(b"LOBJ");
        head[4..8].copy_from_slice(&[32, 0, 1, 0]);
        #[allow(clippy::cast_possible_truncation, reason = "an object has at most 116 bytes")]
        head[8..12].copy_from_slice(&((OBJECT_HEAD + length) as u32).to_le_bytes());
        head[12..16].copy_from_slice(&kind.to_le_bytes());
        // The time is in nanoseconds.
        head[16] = 2;
        head[24..].copy_from_slice(&since.to_le_bytes());
        objects.extend(head);
        fill(objects);
        objects.resize(end, 0);
    }

    /// Writes the objects that wait as one container.
    fn flush(&mut self) -> io::Result<()> {
        if self.objects.is_empty() {
            return Ok(());
        }
        self.packed.clear();
        self.packed.extend([0; 32]);
        // zlib adds a few bytes to what does not shrink.
        self.packed.reserve(self.objects.len() + self.objects.len() / 1000 + 64);
        self.compress.reset();
        let status =
            self.compress.compress_vec(&self.objects, &mut self.packed, FlushCompress::Finish)?;
        if status != Status::StreamEnd {
            return Err(io::Error::other("a container could not be compressed in one go"));
        }
        let size = u32::try_from(self.packed.len()).unwrap_or(u32::MAX);
        let contents = u32::try_from(self.objects.len()).unwrap_or(u32::MAX);
        self.packed[..4].copy_from_slice(b"LOBJ");
        self.packed[4..8].copy_from_slice(&[16, 0, 1, 0]);
        self.packed[8..12].copy_from_slice(&size.to_le_bytes());
        self.packed[12..16].copy_from_slice(&10_u32.to_le_bytes());
        self.packed[16..18].copy_from_slice(&2_u16.to_le_bytes());
        self.packed[24..28].copy_from_slice(&contents.to_le_bytes());
        // As many bytes as readers expect: the rest of the division, though it rounds nothing up.
        self.packed.resize(self.packed.len() + self.packed.len() % 4, 0);
        self.out.write_all(&self.packed)?;
        self.size += self.packed.len() as u64;
        self.unpacked += 32 + u64::from(contents);
        self.objects.clear();
        Ok(())
    }

    fn head(&self) -> [u8; HEAD] {
        let mut head = [0; HEAD];
        head[..4].copy_from_slice(b"LOGG");
        head[4] = 144;
        head[8..12].copy_from_slice(&API.to_le_bytes());
        // Written by an unknown program (0), at zlib's level 6.
        head[13] = 6;
        head[16..24].copy_from_slice(&self.size.to_le_bytes());
        head[24..32].copy_from_slice(&self.unpacked.to_le_bytes());
        head[32..36].copy_from_slice(&self.count.to_le_bytes());
        if let Some(start) = self.start.nanos().filter(|start| *start >= NO_DATE) {
            head[40..56].copy_from_slice(&system_time(start));
            head[56..72].copy_from_slice(&system_time(self.last.nanos()));
        }
        head
    }
}

/// A SYSTEMTIME: year, month, day of the week from Sunday = 0, day, hour, minute, second,
/// millisecond, in UTC.
fn system_time(nanos: u64) -> [u8; 16] {
    let seconds = i64::try_from(nanos / 1_000_000_000).unwrap_or(0);
    let time = jiff::Timestamp::from_second(seconds).unwrap_or_default();
    let date = time.to_zoned(TimeZone::UTC).datetime();
    let milliseconds = i16::try_from(nanos / MILLISECOND % 1000).unwrap_or(0);
    let fields: [i16; 8] = [
        date.year(),
        date.month().into(),
        date.weekday().to_sunday_zero_offset().into(),
        date.day().into(),
        date.hour().into(),
        date.minute().into(),
        date.second().into(),
        milliseconds,
    ];
    let mut bytes = [0; 16];
    for (bytes, field) in bytes.chunks_exact_mut(2).zip(fields) {
        bytes.copy_from_slice(&field.to_le_bytes());
    }
    bytes
}
