//! Files made by hand: what other recorders write, and what becomes of damage.

use std::io::Cursor;

use flate2::write::ZlibEncoder;
use proptest::prelude::*;

use super::*;
use crate::export::{BusHead, FrameWriter};
use crate::frame::{CanFlags, CanFrame};

/// 2026-11-22T03:15:00.250Z.
const START: [u16; 8] = [2026, 11, 0, 22, 3, 15, 0, 250];
const START_NS: u64 = 1_795_317_300_250_000_000;

fn head(start: [u16; 8]) -> Vec<u8> {
    let mut bytes = b"LOGG\x90\0\0\0".to_vec();
    bytes.resize(40, 0);
    bytes.extend(start.into_iter().flat_map(u16::to_le_bytes));
    bytes.resize(144, 0);
    bytes
}

fn object(kind: u32, version: u16, flags: u32, time: u64, body: &[u8]) -> Vec<u8> {
    let header: u16 = if version == 2 { 40 } else { 32 };
    let mut bytes = b"LOBJ".to_vec();
    bytes.extend(header.to_le_bytes());
    bytes.extend(version.to_le_bytes());
    bytes.extend((u32::from(header) + body.len() as u32).to_le_bytes());
    bytes.extend(kind.to_le_bytes());
    bytes.extend(flags.to_le_bytes());
    bytes.extend([0; 4]);
    bytes.extend(time.to_le_bytes());
    bytes.resize(header.into(), 0);
    bytes.extend(body);
    bytes
}

/// CAN_MESSAGE with the number as identifier and in its data.
fn message(number: u16) -> Vec<u8> {
    let mut body = vec![1, 0, 0, 8];
    body.extend(u32::from(number % 0x800).to_le_bytes());
    body.extend(u64::from(number).to_le_bytes());
    object(1, 1, 2, u64::from(number) * 1000, &body)
}

fn container(contents: &[u8], compressed: bool) -> Vec<u8> {
    let data = if compressed {
        let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut encoder, contents).unwrap();
        encoder.finish().unwrap()
    } else {
        contents.to_vec()
    };
    let mut bytes = b"LOBJ\x10\0\x01\0".to_vec();
    bytes.extend((32 + data.len() as u32).to_le_bytes());
    bytes.extend(10_u32.to_le_bytes());
    bytes.extend([if compressed { 2 } else { 0 }, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend((contents.len() as u32).to_le_bytes());
    bytes.extend([0; 4]);
    bytes.extend(&data);
    bytes.resize(bytes.len() + bytes.len() % 4, 0);
    bytes
}

fn file(parts: &[Vec<u8>]) -> Vec<u8> {
    [head(START)].iter().chain(parts).flatten().copied().collect()
}

struct Read {
    frames: Vec<LogFrame>,
    skipped: Skipped,
    notes: Vec<String>,
    buses: Vec<String>,
}

impl Read {
    fn can(&self, index: usize) -> &CanFrame {
        let Frame::Can(frame) = &self.frames[index].frame.value else { panic!("no CAN frame") };
        frame
    }

    /// The numbers of frames made by [`message`].
    fn numbers(&self) -> Vec<u16> {
        let number =
            |index: usize| u16::from_le_bytes(self.can(index).data()[..2].try_into().unwrap());
        (0..self.frames.len()).map(number).collect()
    }
}

fn read(bytes: &[u8]) -> Read {
    let mut log = open(Cursor::new(bytes)).unwrap();
    let mut frames = Vec::new();
    while log.read(&mut frames).unwrap() {}
    assert!(!log.read(&mut frames).unwrap(), "the end stays the end");
    Read {
        frames,
        skipped: log.skipped().clone(),
        notes: log.notes().to_vec(),
        buses: log.buses().to_vec(),
    }
}

fn messages(range: std::ops::Range<u16>) -> Vec<u8> {
    range.flat_map(message).collect()
}

#[test]
fn objects_go_on_from_one_container_to_the_next() {
    let all = messages(0..100);
    for cut in [1, 15, 16, 40, 48, 1000, 4799] {
        let (first, second) = all.split_at(cut);
        for compressed in [true, false] {
            let bytes = file(&[container(first, compressed), container(second, compressed)]);
            let log = read(&bytes);
            assert_eq!(log.numbers(), (0..100).collect::<Vec<_>>());
            assert_eq!(log.skipped, Skipped::default());
            assert_eq!(log.frames[2].frame.time, Timestamp(START_NS + 2000));
        }
    }
}

#[test]
fn an_object_that_claims_a_part_of_the_next_one_does_not_swallow_it() {
    let mut bytes = messages(0..10);
    // 48 are right; 89 end so short before the third that it looks like rounding up.
    bytes[48 + 8] = 89;
    let log = read(&file(&[container(&bytes, false)]));
    assert_eq!(log.numbers(), (0..10).collect::<Vec<_>>());
    assert_eq!(log.skipped.count, 1);
}

#[test]
fn frames_outside_of_containers_are_taken_too() {
    let log = read(&file(&[message(1), message(2), container(&message(3), true), message(4)]));
    assert_eq!(log.numbers(), [1, 2, 3, 4]);
    assert_eq!(log.skipped.count, 0);
}

#[test]
fn each_kind_of_object_is_a_frame_with_all_its_properties() {
    let extended = 0x9234_5678_u32.to_le_bytes();
    let classic = |flags: u8, dlc: u8| {
        [&[2, 0, flags, dlc], &extended[..], &[1, 2, 3, 4, 5, 6, 7, 8]].concat()
    };
    let fd =
        [&[1, 0, 1, 9], &[0x23, 1, 0, 0][..], &[0, 0, 0, 0, 0, 7, 12, 0, 0, 0, 0, 0], &[9; 64]]
            .concat();
    let mut fd_64 = vec![3, 13, 32, 0];
    fd_64.extend(0x7FF_u32.to_le_bytes());
    fd_64.extend([0; 4]);
    fd_64.extend(0x3000_u32.to_le_bytes());
    fd_64.extend([0; 18]);
    // Sent; more data begin 30 bytes behind the frame's, of which 2 are missing.
    fd_64.extend([1, 32 + 40 + 30, 0, 0, 0, 0]);
    fd_64.extend([7; 30]);
    fd_64.extend([0xEE; 8]);
    let objects = [
        object(1, 1, 1, 7, &classic(0x80, 5)),
        object(86, 2, 2, 7, &[&classic(1, 12)[..], &[0; 8]].concat()),
        object(100, 1, 2, 8, &fd),
        object(101, 3, 2, 9, &fd_64),
    ];
    let log = read(&file(&[container(&objects.concat(), true)]));
    assert_eq!(log.skipped, Skipped::default());
    assert_eq!(log.buses, ["2", "1", "3"]);
    let flags = CanFlags::EXTENDED;
    let remote = CanFrame::new(0x1234_5678, flags | CanFlags::REMOTE, &[]).with_dlc(5);
    assert_eq!(*log.can(0), remote);
    assert_eq!(log.frames[0].frame.time, Timestamp(START_NS + 70_000), "steps of 10 us");
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let sent = CanFrame::new(0x1234_5678, flags | CanFlags::TX, &data).with_dlc(12);
    assert_eq!(*log.can(1), sent);
    let flags = CanFlags::FD | CanFlags::BRS;
    assert_eq!(*log.can(2), CanFrame::new(0x123, flags | CanFlags::ESI | CanFlags::TX, &[9; 12]));
    let padded = [&[7; 30][..], &[0, 0]].concat();
    assert_eq!(*log.can(3), CanFrame::new(0x7FF, flags | CanFlags::TX, &padded));
}

#[test]
fn frames_with_an_impossible_dlc_are_taken_with_the_bytes_they_have_and_it_is_said() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let classic = [&[1, 0, 0, 0x33], &[0x23, 1, 0, 0][..], &data].concat();
    let fd = [&[1, 0, 0, 0x33], &[0x23, 1, 0, 0][..], &[0, 0, 0, 0, 0, 1, 64, 0, 0, 0, 0, 0]];
    let objects = [
        object(1, 1, 1, 7, &classic),
        object(100, 1, 2, 8, &[&fd.concat()[..], &[9; 64]].concat()),
    ];
    let log = read(&file(&[container(&objects.concat(), true)]));
    assert_eq!(log.skipped, Skipped::default());
    assert_eq!(*log.can(0), CanFrame::new(0x123, CanFlags::default(), &data));
    assert_eq!(*log.can(1), CanFrame::new(0x123, CanFlags::FD, &[9; 64]));
    assert!(log.notes[0].starts_with("2 frame(s) have a DLC above 15"), "{:?}", log.notes);
}

#[test]
fn errors_say_what_the_controller_said() {
    // Flags: the code is an SJA1000's; stuff error while receiving, at the start of the data.
    let mut ext = vec![1, 0, 0, 0, 1, 0, 0, 0, 0xAA, 0, 4, 0, 0, 0, 0, 0];
    ext.extend(0x1234_u32.to_le_bytes());
    ext.extend([0; 12]);
    // As programs on SocketCAN write it: class and details.
    let mut linux = vec![1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 8, 0, 0, 0, 0, 0];
    linux.extend(0x24_u32.to_le_bytes());
    linux.extend([0, 0, 0, 0, 0, 8, 0, 0, 0, 0, 96, 0]);
    let objects = [
        object(2, 1, 2, 1, &[1, 0, 6, 0]),
        object(73, 1, 2, 2, &ext),
        object(73, 1, 2, 3, &linux),
        object(91, 1, 2, 4, &[1, 0, 0, 0, 1, 0, 0, 0]),
    ];
    let log = read(&file(&[container(&objects.concat(), false)]));
    assert_eq!(log.skipped, Skipped::default());
    assert_eq!(*log.can(0), CanFrame::new(0x80, CanFlags::ERROR, &[0; 8]));
    let details = [0, 0, 4, 0x0A, 0, 0, 0, 0];
    assert_eq!(*log.can(1), CanFrame::new(0x88, CanFlags::ERROR, &details));
    assert_eq!(*log.can(2), CanFrame::new(0x24, CanFlags::ERROR, &[0, 8, 0, 0, 0, 0, 96, 0]));
    let Frame::Gap(gap) = &log.frames[3].frame.value else { panic!("no gap") };
    assert_eq!((gap.count, gap.reason), (0, GapReason::Adapter));
}

#[test]
fn objects_without_a_frame_are_named_and_counted_but_not_missed() {
    let text = object(65, 1, 2, 0, &[0; 33]);
    let odd = object(9999, 7, 2, 0, &[0; 5]);
    let contents = [text.clone(), message(1), odd, vec![0; 1], text, vec![0; 3], message(2)];
    let log = read(&file(&[container(&contents.concat(), true)]));
    assert_eq!(log.numbers(), [1, 2]);
    assert_eq!(log.skipped.count, 0);
    assert_eq!(log.notes, ["objects without a CAN frame: 2 APP_TEXT, 1 of kind 9999"]);
}

#[test]
fn a_cut_container_gives_what_is_there() {
    let whole = file(&[container(&messages(0..50), true), container(&messages(50..100), false)]);
    let cut = read(&whole[..whole.len() - 100]);
    assert_eq!(cut.numbers(), (0..97).collect::<Vec<_>>());
    assert!(cut.skipped.count > 0);
    assert!(cut.skipped.first[0].1.contains("the file ends inside"), "{:?}", cut.skipped);
    // A compressed one gives what its bytes say up to there.
    let noise: Vec<u8> = (0..1000).flat_map(|n| message(n * 31)).collect();
    let whole = file(&[container(&noise, true)]);
    let cut = read(&whole[..144 + (whole.len() - 144) / 2]);
    let expected: Vec<u16> = (0..1000).map(|n| n * 31).collect();
    assert!(cut.frames.len() > 300, "{}", cut.frames.len());
    assert_eq!(cut.numbers(), expected[..cut.frames.len()]);
    assert!(cut.skipped.count > 0);
}

#[test]
fn a_damaged_container_is_counted_and_gives_no_frame_that_may_be_wrong() {
    let parts = [0..100, 100..200, 200..300].map(|range| container(&messages(range), true));
    let mut bytes = file(&parts);
    let middle = 144 + parts[0].len() + parts[1].len() / 2;
    bytes[middle] ^= 0x10;
    let log = read(&bytes);
    assert_eq!(log.numbers(), (0..100).chain(200..300).collect::<Vec<_>>());
    assert_eq!(log.skipped.count, 1);
    assert_eq!(log.skipped.first[0].0, format!("byte {}", 144 + parts[0].len()));
}

#[test]
fn wrong_sizes_of_containers_lose_nothing_else() {
    let parts = [0..100, 100..200, 200..300].map(|range| container(&messages(range), true));
    for size in [20_u32, 100, 100_000, u32::MAX] {
        let mut bytes = file(&parts);
        let at = 144 + parts[0].len() + 8;
        bytes[at..at + 4].copy_from_slice(&size.to_le_bytes());
        let log = read(&bytes);
        let first_and_last = (0..100).chain(200..300).all(|n| log.numbers().contains(&n));
        assert!(first_and_last, "size {size}: {:?}", log.skipped);
        assert!(log.frames.len() == 300 || log.skipped.count > 0, "size {size}");
    }
}

#[test]
fn garbage_between_objects_is_counted_once_and_passed_over() {
    let garbage: Vec<u8> = (0..200_u8).map(|n| n.wrapping_mul(37)).collect();
    let contents = [message(1), garbage.clone(), message(2), message(3)].concat();
    let bytes =
        file(&[garbage.clone(), container(&contents, true), garbage, container(&message(4), true)]);
    let log = read(&bytes);
    assert_eq!(log.numbers(), [1, 2, 3, 4]);
    assert_eq!(log.skipped.count, 3, "{:?}", log.skipped);
}

#[test]
fn an_object_with_a_wrong_size_is_counted_and_hides_no_other() {
    for size in [16_u32, 40, 100_000, 1 << 23, u32::MAX] {
        for kind in [1_u32, 65] {
            let mut odd = object(kind, 1, 2, 0, &[1; 16]);
            odd[8..12].copy_from_slice(&size.to_le_bytes());
            let contents = [message(1), odd, message(2), message(3)].concat();
            let log = read(&file(&[container(&contents, true), container(&message(4), true)]));
            assert_eq!(log.numbers(), [1, 2, 3, 4], "size {size} of kind {kind}");
            assert!(log.skipped.count > 0 || (kind, size) == (65, 40), "size {size}, kind {kind}");
        }
    }
}

#[test]
fn containers_that_expand_without_end_are_bounded() {
    // A quarter of a gigabyte of zeros in 256 KiB, and no object in it.
    let bytes = file(&[container(&vec![0; 64 << 20], true), container(&message(1), true)]);
    let mut log = open(Cursor::new(&bytes)).unwrap();
    let mut frames = Vec::new();
    while log.read(&mut frames).unwrap() {}
    assert_eq!(frames.len(), 1);
    assert!(log.skipped().count > 0);
}

#[test]
fn statistics_that_promise_more_than_there_is_are_believed_only_for_a_short_file() {
    let mut bytes = file(&[container(&message(1), true)]);
    bytes[32..36].copy_from_slice(&77_u32.to_le_bytes());
    assert_eq!(read(&bytes).skipped.count, 0, "only the count is odd");
    bytes[16..24].copy_from_slice(&100_000_u64.to_le_bytes());
    let skipped = read(&bytes).skipped;
    assert!(skipped.first[0].1.contains("76 objects more"), "{skipped:?}");
}

#[test]
fn a_start_that_is_not_set_makes_times_relative() {
    let bytes = [head([0; 8]), container(&message(3), true)].concat();
    let mut log = open(Cursor::new(&bytes)).unwrap();
    let mut frames = Vec::new();
    while log.read(&mut frames).unwrap() {}
    assert!(log.times_are_relative());
    assert_eq!(frames[0].frame.time, Timestamp(3000));
}

/// What a person would call any frame.
fn any_frame() -> impl Strategy<Value = CanFrame> {
    let data = prop::collection::vec(any::<u8>(), 0..=8);
    let fd_length = prop::sample::select(vec![0_usize, 1, 8, 12, 16, 20, 24, 32, 48, 64]);
    let classic = (0_u32..0x2000_0000, any::<bool>(), any::<bool>(), data.clone(), 9_u8..=15)
        .prop_map(|(id, extended, sent, data, dlc)| {
            let frame = CanFrame::new(id, flags(extended, sent), &data);
            let full = frame.data().len() == 8 && dlc > 12;
            if full { frame.with_dlc(dlc) } else { frame }
        });
    let remote = (0_u32..0x800, 0_u8..=8)
        .prop_map(|(id, dlc)| CanFrame::new(id, CanFlags::REMOTE, &[]).with_dlc(dlc));
    let error = (0_u32..0x400, Just([0, 4, 0, 0, 0, 0, 96, 1]))
        .prop_map(|(id, data)| CanFrame::new(id, CanFlags::ERROR, &data));
    let fd =
        (0_u32..0x800, fd_length, any::<u8>(), any::<bool>()).prop_map(|(id, n, byte, brs)| {
            let flags = if brs { CanFlags::BRS | CanFlags::FD } else { CanFlags::FD };
            CanFrame::new(id, flags, &vec![byte; n])
        });
    prop_oneof![classic, remote, error, fd]
}

fn flags(extended: bool, sent: bool) -> CanFlags {
    let mut flags = CanFlags::default();
    if extended {
        flags |= CanFlags::EXTENDED;
    }
    if sent {
        flags |= CanFlags::TX;
    }
    flags
}

fn written(frames: &[LogFrame]) -> Vec<u8> {
    let buses = ["1", "2"].map(|name| BusHead { name: name.into(), bitrate: None });
    let mut bytes = Cursor::new(Vec::new());
    let mut log = crate::export::frames::blf::create(&mut bytes, &buses).unwrap();
    for LogFrame { bus, frame } in frames {
        log.write(*bus, frame).unwrap();
    }
    log.finish().unwrap();
    assert_eq!(log.unkept().len(), 0);
    drop(log);
    bytes.into_inner()
}

fn log_of(frames: Vec<CanFrame>) -> Vec<LogFrame> {
    let stamped = |(index, mut frame): (usize, CanFrame)| {
        if frame.id > 0x7FF && !frame.flags.has(CanFlags::ERROR) {
            frame.flags |= CanFlags::EXTENDED;
        }
        let time = Timestamp(START_NS + 123 + 1_000_003 * index as u64);
        LogFrame { bus: 0, frame: Stamped { time, value: Frame::Can(frame) } }
    };
    frames.into_iter().enumerate().map(stamped).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_written_is_read_again(frames in prop::collection::vec(any_frame(), 0..200)) {
        let log = log_of(frames);
        let bytes = written(&log);
        let again = read(&bytes);
        prop_assert_eq!(again.skipped, Skipped::default());
        prop_assert_eq!(again.frames, log);
    }

    #[test]
    fn no_edit_makes_it_panic_or_lose_silently(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        compressed in any::<bool>(),
    ) {
        let parts = [0..200, 200..400].map(|range| container(&messages(range), compressed));
        let mut bytes = file(&parts);
        for (index, byte) in edits {
            // The head decides only about the start.
            let at = 144 + index.index(bytes.len() - 144);
            bytes[at] = byte;
        }
        let log = read(&bytes);
        let others = !log.notes.is_empty();
        prop_assert!(log.frames.len() == 400 || log.skipped.count > 0 || others);
    }
}

#[test]
fn every_truncation_gives_a_beginning_and_a_count() {
    let all = messages(0..300);
    for compressed in [true, false] {
        let parts = [&all[..5000], &all[5000..]].map(|part| container(part, compressed));
        let bytes = file(&parts);
        for end in (0..bytes.len()).step_by(7) {
            if end < 56 {
                assert!(open(Cursor::new(&bytes[..end])).is_err());
                continue;
            }
            let log = read(&bytes[..end]);
            let numbers = log.numbers();
            assert!(numbers.iter().copied().eq(0..numbers.len() as u16));
            let edge = end <= 144 || end == 144 + parts[0].len();
            let padding = bytes.len() - end < 4;
            assert!(log.skipped.count > 0 || edge || padding, "cut at {end} of {}", bytes.len());
        }
    }
}
