use super::*;
use crate::frame::{CanFlags, CanFrame, Direction, LineError, LineErrorKind};

type Found = (Vec<(String, u64, Frame)>, Skipped, Vec<String>, bool);

/// Everything in a log.
fn read(text: &str) -> Found {
    let input = Box::new(std::io::Cursor::new(text.as_bytes().to_vec()));
    let mut reader = open(input, text.as_bytes(), &Settings::default());
    let mut frames = Vec::new();
    while reader.read(&mut frames).unwrap() {}
    let named = frames
        .into_iter()
        .map(|f| (reader.buses()[usize::from(f.bus)].clone(), f.frame.time.nanos(), f.frame.value));
    let named = named.collect();
    (named, reader.skipped.clone(), reader.notes.clone(), reader.relative)
}

fn can(id: u32, flags: CanFlags, data: &[u8]) -> Frame {
    Frame::Can(CanFrame::new(id, flags, data))
}

#[test]
fn every_form_of_a_frame_is_read() {
    let none = CanFlags::default();
    let error = can(0x4, CanFlags::ERROR, &[0, 8, 0, 0, 0, 0, 0x60, 0]);
    for (line, frame) in [
        ("(1.5) can0 123#DEAD", can(0x123, none, &[0xDE, 0xAD])),
        ("(1.5) can0 123#DE.AD", can(0x123, none, &[0xDE, 0xAD])),
        ("(1.5) can0 00000123#", can(0x123, CanFlags::EXTENDED, &[])),
        ("(1.5) can0 123#00 T", can(0x123, CanFlags::TX, &[0])),
        (
            "(1.5) can0 123##31122",
            can(0x123, CanFlags::FD | CanFlags::BRS | CanFlags::ESI, &[0x11, 0x22]),
        ),
        ("(1.5) can0 123#R4", Frame::Can(CanFrame::new(0x123, CanFlags::REMOTE, &[]).with_dlc(4))),
        (
            "(1.5) can0 123#1122334455667788_C",
            Frame::Can(
                CanFrame::new(0x123, none, &[0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88])
                    .with_dlc(12),
            ),
        ),
        ("(1.5) can0 20000004#0008000000006000", error.clone()),
        (" (1.5)  can0  123   [2]  DE AD", can(0x123, none, &[0xDE, 0xAD])),
        (
            " (1.5)  can0  123   [2]  DE AD                     '..'",
            can(0x123, none, &[0xDE, 0xAD]),
        ),
        (
            " (1.5)  can0  123   [2]  AD`DE                     `..`",
            can(0x123, none, &[0xDE, 0xAD]),
        ),
        (" (1.5)  can0  123   [2]  11011110 10101101", can(0x123, none, &[0xDE, 0xAD])),
        (" (1.5)  can0  TX - -  123   [2]  DE AD", can(0x123, CanFlags::TX, &[0xDE, 0xAD])),
        (
            " (1.5)  can0  RX B E  123  [02]  DE AD",
            can(0x123, CanFlags::FD | CanFlags::BRS | CanFlags::ESI, &[0xDE, 0xAD]),
        ),
        (
            " (1.5)  can0  123   {C}  01 02 03 04 05 06 07 08",
            Frame::Can(CanFrame::new(0x123, none, &[1, 2, 3, 4, 5, 6, 7, 8]).with_dlc(12)),
        ),
        (
            " (1.5)  can0  123   [3]  remote request",
            Frame::Can(CanFrame::new(0x123, CanFlags::REMOTE, &[]).with_dlc(3)),
        ),
        (" (1.5)  can0  20000004   [8]  00 08 00 00 00 00 60 00   ERRORFRAME", error),
        // Before 2010, identifiers were filled up with blanks.
        (" (1.5)  can0       123  [1] 07", can(0x123, CanFlags::EXTENDED, &[7])),
        (" (1.5)  can0    1  [1] 07", can(0x1, none, &[7])),
        ("\x1b[31m (1.5)  can0\x1b[0m  123   [1]  07\x1b[0m", can(0x123, none, &[7])),
    ] {
        let (frames, skipped, ..) = read(&format!("{line}\n"));
        assert_eq!(skipped, Skipped::default(), "{line}");
        assert_eq!(frames, [("can0".to_owned(), 1_500_000_000, frame)], "{line}");
    }
}

#[test]
fn times_are_understood_in_all_styles() {
    let times = |texts: &[&str]| {
        let lines: Vec<_> = texts.iter().map(|time| format!("{time} can0 001#00\n")).collect();
        let text = lines.concat();
        let (frames, skipped, _, relative) = read(&text);
        assert_eq!(skipped.count, 0, "{skipped:?}");
        (frames.iter().map(|f| f.1).collect::<Vec<_>>(), relative)
    };
    let second = 1_000_000_000;
    assert_eq!(
        times(&["(1700000000.000001)", "(1700000000.000002)"]),
        (vec![1_700_000_000 * second + 1000, 1_700_000_000 * second + 2000], false)
    );
    assert_eq!(times(&["(1700000000.000000001)"]), (vec![1_700_000_000 * second + 1], false));
    assert_eq!(
        times(&["(2023-11-14 22:13:20.5)"]),
        (vec![1_700_000_000 * second + second / 2], false)
    );
    assert_eq!(
        times(&["(000.000000)", "(000.500000)", "(001.500000)"]),
        (vec![0, second / 2, second * 3 / 2], true)
    );
    assert_eq!(
        times(&["(000.000000)", "(000.500000)", "(000.250000)", "(000.125000)"]),
        (vec![0, second / 2, second * 3 / 4, second * 7 / 8], true)
    );
    assert_eq!(times(&["", ""]), (vec![0, 0], true));
}

#[test]
fn what_is_no_frame_is_counted_and_what_was_dropped_is_a_gap() {
    let text = "(1.0) can0 001#00\nDROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n\
                (2.0) can0 001#00\n\ncontroller-problem\n\tlost-arbitration\n(3.0) can0 001#0\n\
                (3.0) can0 99#00\n(4.0) can1 001#00";
    let (frames, skipped, notes, _) = read(text);
    let (from, to) = (Timestamp(1_000_000_000), Timestamp(2_000_000_000));
    let gap = Gap { count: 3, unit: Unit::Frames, reason: GapReason::KernelQueue, from, to };
    assert_eq!(frames[1], ("can0".to_owned(), 2_000_000_000, Frame::Gap(gap)));
    assert_eq!(frames.len(), 4);
    assert_eq!(frames[3].0, "can1");
    let places: Vec<_> = skipped.first.iter().map(|(place, _)| place.as_str()).collect();
    assert_eq!((skipped.count, places), (3, vec!["line 5", "line 7", "line 8"]));
    assert!(notes[0].contains("no end"), "{notes:?}");
}

#[test]
fn what_cat_prints_can_be_read_again() {
    let text = "\
(1700000001.750007) rect rx  3A 3B 3C 3D 3E 3F 40 41 42 43 44 45 46 47 48 49  |:;<=>?@ABCDEFGHI|
                             4A 4B                                            |JK|
# rect: parity error at byte 1
# gap: rect lost 12 bytes (overrun) from 2023-11-14T22:13:20.000Z to 2023-11-14T22:13:21.000Z
";
    let (frames, skipped, ..) = read(text);
    assert_eq!(skipped.count, 0, "{skipped:?}");
    let Frame::Serial(bytes) = &frames[0].2 else { panic!("{frames:?}") };
    assert_eq!((bytes.direction, &bytes.data), (Direction::Rx, &(0x3A..0x4C).collect::<Vec<u8>>()));
    assert_eq!(bytes.errors, [LineError { offset: 1, kind: LineErrorKind::Parity }]);
    assert!(matches!(&frames[1].2, Frame::Gap(gap) if gap.count == 12 && gap.unit == Unit::Bytes));
}
