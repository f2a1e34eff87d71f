//! Files of our own, and what becomes of damage to them.

use std::io::Cursor;

use proptest::prelude::*;

use super::*;
use crate::export::{BusHead, FrameWriter};
use crate::frame::{CanFlags, CanFrame};

const START: u64 = 1_795_317_300_250_000_000;

fn log(count: u64) -> Vec<LogFrame> {
    let frame = |n: u64| {
        let data = (n * 0x0101_0307).to_le_bytes();
        #[allow(clippy::cast_possible_truncation, reason = "small")]
        let id = (n % 0x700) as u32;
        let can = match n % 9 {
            0 => CanFrame::new(id, CanFlags::REMOTE, &[]).with_dlc(3),
            1 => CanFrame::new(0x88, CanFlags::ERROR, &data),
            2 => CanFrame::new(id, CanFlags::FD | CanFlags::BRS, &data.repeat(4)),
            3 => CanFrame::new(id, CanFlags::FD | CanFlags::ESI | CanFlags::TX, &data),
            4 => CanFrame::new(id + 0x1000, CanFlags::EXTENDED, &data).with_dlc(12),
            _ => CanFrame::new(id, CanFlags::TX, &data[..5]),
        };
        let time = Timestamp(START + 77 + n * 130_001);
        LogFrame { bus: 0, frame: Stamped { time, value: Frame::Can(can) } }
    };
    (0..count).map(frame).collect()
}

fn written(frames: &[LogFrame]) -> Vec<u8> {
    let buses = [BusHead { name: "7".into(), bitrate: None }];
    let mut bytes = Cursor::new(Vec::new());
    let mut file = crate::export::frames::mf4::create(&mut bytes, &buses).unwrap();
    for LogFrame { bus, frame } in frames {
        file.write(*bus, frame).unwrap();
    }
    file.finish().unwrap();
    assert!(file.unkept().is_empty());
    drop(file);
    bytes.into_inner()
}

fn read(bytes: &[u8]) -> Result<(Vec<LogFrame>, u64), ImportError> {
    let mut file = open(Cursor::new(bytes))?;
    let mut frames = Vec::new();
    while file.read(&mut frames)? {}
    Ok((frames, file.skipped().count))
}

#[test]
fn what_is_written_is_read_again() {
    let frames = log(50_000);
    assert_eq!(read(&written(&frames)).unwrap(), (frames, 0));
    assert_eq!(read(&written(&[])).unwrap(), (Vec::new(), 0));
}

#[test]
fn a_file_of_another_version_or_cut_in_its_head_is_refused() {
    let bytes = written(&log(10));
    for end in 0..168 {
        assert!(read(&bytes[..end]).is_err(), "cut at {end}");
    }
    let mut old = bytes;
    old[28..30].copy_from_slice(&330_u16.to_le_bytes());
    let error = read(&old).unwrap_err().to_string();
    assert!(error.contains("version 3.30"), "{error}");
}

#[test]
fn every_truncation_is_counted() {
    let bytes = written(&log(300));
    for end in (168..bytes.len() - 8).step_by(5) {
        let (frames, skipped) = read(&bytes[..end]).unwrap();
        assert!(frames.len() < 300 && skipped > 0, "cut at {end}: {} frames", frames.len());
    }
}

#[test]
fn a_damaged_block_costs_its_own_records_and_says_how_many() {
    let classic = |n: u64| LogFrame {
        bus: 0,
        frame: Stamped {
            time: Timestamp(START + n * 1000),
            value: Frame::Can(CanFrame::new(1, CanFlags::default(), &n.to_le_bytes())),
        },
    };
    let frames: Vec<LogFrame> = (0..50_000).map(classic).collect();
    let mut bytes = written(&frames);
    let second = bytes.windows(4).enumerate().filter(|(_, id)| id == b"##DZ").nth(1).unwrap().0;
    bytes[second + 5000] ^= 0xFF;
    let (intact, skipped) = read(&bytes).unwrap();
    assert_eq!(intact.len() as u64 + skipped, 50_000);
    assert!(intact.len() > 25_000);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_edit_makes_it_panic_or_run_away(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        near_the_end in any::<bool>(),
    ) {
        let mut bytes = written(&log(200));
        for (index, byte) in edits {
            // The description is at the end, where numbers do most harm.
            let from = if near_the_end { bytes.len() * 3 / 4 } else { 0 };
            let at = from + index.index(bytes.len() - from);
            bytes[at] = byte;
        }
        if let Ok((frames, _)) = read(&bytes) {
            prop_assert!(frames.len() < 100_000);
        }
    }
}
