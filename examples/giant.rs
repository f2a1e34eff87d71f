//! Writes a recording as large as asked for, to see how large ones are read: a CAN frame every
//! millisecond, and with each a piece of serial bytes that no compression makes smaller.
//!
//!     giant GIB FILE

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use bustape::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes, Stamped, Timestamp};
use bustape::record::{Segments, Split, Target};
use bustape::recording::definition::Facts;
use bustape::recording::disk::RealDisk;
use bustape::recording::writer::{Head, WriterOptions};

/// 2023-11-14T22:13:20Z.
const START: u64 = 1_700_000_000_000_000_000;
/// What one read of a busy port returns.
const PIECE: u64 = 4096;
const MILLISECOND: u64 = 1_000_000;

fn main() -> Result<()> {
    const USAGE: &str = "usage: giant GIB FILE";
    let mut args = std::env::args_os().skip(1);
    let gib = args.next().and_then(|gib| gib.to_str()?.parse::<u64>().ok()).context(USAGE)?;
    let target = Target::File(PathBuf::from(args.next().context(USAGE)?));
    let options = WriterOptions::default();
    let mut segments =
        Segments::new(std::sync::Arc::new(RealDisk), target, Split::default(), options)?;
    let head = Head {
        buses: [("can0", "16"), ("line", "0")]
            .map(|(name, mtu)| (name.to_owned(), Facts::from([("mtu".to_owned(), mtu.to_owned())])))
            .to_vec(),
        time: Timestamp(START),
        ..Head::default()
    };
    let mut segment = segments.open(Timestamp(START), &head, "")?;
    let mut random = 1;
    for number in 0..(gib << 30) / PIECE {
        let time = Timestamp(START + number * MILLISECOND);
        let can = CanFrame::new(0x123, CanFlags::default(), &number.to_le_bytes());
        segment.writer.add(0, &Stamped { time, value: Frame::Can(can) })?;
        let data = noise(&mut random);
        let bytes = SerialBytes { direction: Direction::Rx, data, errors: Vec::new() };
        segment.writer.add(1, &Stamped { time, value: Frame::Serial(bytes) })?;
        if segment.writer.is_full() {
            segment.writer.cut()?;
        }
    }
    segments.finish(segment, Facts::new())?;
    Ok(())
}

/// Bytes of the xorshift generator, whose state is `random`.
fn noise(random: &mut u64) -> Vec<u8> {
    let words = std::iter::repeat_with(|| {
        *random ^= *random << 13;
        *random ^= *random >> 7;
        *random ^= *random << 17;
        random.to_le_bytes()
    });
    words.take(512).flatten().collect()
}
