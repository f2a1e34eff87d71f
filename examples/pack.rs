//! Packs a candump log into a recording: how to write recordings with the library.
//!
//!     pack FILE [--layout frame|batch] [--compression LEVEL] <LOG
//!
//! The log is what `candump -L` prints, or what `candump -l` writes.

use std::io::Read as _;
use std::path::PathBuf;

use anyhow::{Context as _, Result};
use bustape::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};
use bustape::record::{Segments, Split, Target};
use bustape::recording::definition::Facts;
use bustape::recording::disk::RealDisk;
use bustape::recording::writer::{Head, Layout, WriterOptions};
use clap::Parser as _;

#[derive(clap::Parser)]
struct Args {
    /// The recording; an existing file is never overwritten
    file: PathBuf,
    /// How CAN frames stand in the file
    #[arg(long, value_enum, default_value_t)]
    layout: Layout,
    /// zstd level, 1 to 19
    #[arg(long, default_value_t = WriterOptions::default().compression)]
    compression: i32,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let mut log = String::new();
    std::io::stdin().read_to_string(&mut log)?;
    // The head of a recording names its buses, so they must be known before the first frame.
    let mut buses: Vec<&str> = Vec::new();
    for line in log.lines() {
        let name = line.split(' ').nth(1).with_context(|| not_a_frame(line))?;
        if !buses.contains(&name) {
            buses.push(name);
        }
    }
    let (_, start) = parse(log.lines().next().context("the log is empty")?).context("no frame")?;

    let options = WriterOptions {
        layout: args.layout,
        compression: args.compression,
        ..WriterOptions::default()
    };
    let head = Head {
        buses: buses.iter().map(|name| ((*name).to_owned(), Facts::new())).collect(),
        time: start.time,
        ..Head::default()
    };
    let target = Target::File(args.file);
    let mut segments =
        Segments::new(std::sync::Arc::new(RealDisk), target, Split::default(), options)?;
    let mut segment = segments.open(start.time, &head, "")?;
    for line in log.lines() {
        let (name, frame) = parse(line).with_context(|| not_a_frame(line))?;
        let bus = buses.iter().position(|bus| *bus == name).context("a bus without a name")?;
        segment.writer.add(bus, &frame)?;
        if segment.writer.is_full() {
            segment.writer.cut()?;
        }
    }
    segments.finish(segment, Facts::new())?;
    Ok(())
}

fn not_a_frame(line: &str) -> String {
    format!("not a line of candump -L: {line}")
}

/// `(1700000000.123456) can0 123#DEADBEEF`: the bus and the frame.
fn parse(line: &str) -> Option<(&str, Stamped<Frame>)> {
    let mut words = line.split(' ');
    let time = words.next()?.strip_prefix('(')?.strip_suffix(')')?;
    let (seconds, micros) = time.split_once('.').filter(|(_, micros)| micros.len() == 6)?;
    let micros = seconds.parse::<u64>().ok()? * 1_000_000 + micros.parse::<u64>().ok()?;
    let (bus, (id, rest)) = (words.next()?, words.next()?.split_once('#')?);
    let mut flags = if id.len() > 3 { CanFlags::EXTENDED } else { CanFlags::default() };
    let mut id = u32::from_str_radix(id, 16).ok()?;
    if id & 0x2000_0000 != 0 {
        // CAN_ERR_FLAG of linux/can.h
        (id, flags) = (id & 0x1FFF_FFFF, CanFlags::ERROR);
    }
    if words.next() == Some("T") {
        flags |= CanFlags::TX;
    }
    let frame = match rest.as_bytes() {
        [b'R', length @ ..] => {
            let length = length.first().map_or(0, |&digit| nibble(digit).unwrap_or(0));
            CanFrame::new(id, flags | CanFlags::REMOTE, &[]).with_dlc(length)
        }
        [b'#', fd, data @ ..] => {
            let fd = nibble(*fd)?;
            let brs = if fd & 1 != 0 { CanFlags::BRS } else { CanFlags::default() };
            let esi = if fd & 2 != 0 { CanFlags::ESI } else { CanFlags::default() };
            can_frame(id, flags | CanFlags::FD | brs | esi, data)?
        }
        [data @ .., b'_', dlc] => can_frame(id, flags, data)?.with_dlc(nibble(*dlc)?),
        data => can_frame(id, flags, data)?,
    };
    Some((bus, Stamped { time: Timestamp(micros * 1_000), value: Frame::Can(frame) }))
}

fn can_frame(id: u32, flags: CanFlags, hex: &[u8]) -> Option<CanFrame> {
    let mut data = [0; 64];
    let (pairs, []) = hex.as_chunks::<2>() else { return None };
    for (byte, [high, low]) in data.get_mut(..pairs.len())?.iter_mut().zip(pairs) {
        *byte = nibble(*high)? << 4 | nibble(*low)?;
    }
    Some(CanFrame::new(id, flags, &data[..pairs.len()]))
}

fn nibble(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        _ => None,
    }
}
