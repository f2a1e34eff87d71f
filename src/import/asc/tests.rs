use super::*;
use crate::frame::{CanFlags, CanFrame};

type Found = (Vec<(String, u64, CanFrame)>, Skipped, Vec<String>, bool);

/// Everything in a log: channel, time, frame.
fn read(text: &str) -> Found {
    assert!(recognises(text.as_bytes()), "{text}");
    let mut reader = open(Box::new(std::io::Cursor::new(text.to_owned())), &Settings::default());
    let mut frames = Vec::new();
    while reader.read(&mut frames).unwrap() {}
    let named = frames.into_iter().map(|f| match f.frame.value {
        Frame::Can(can) => (reader.buses()[usize::from(f.bus)].clone(), f.frame.time.nanos(), can),
        other => panic!("{other:?}"),
    });
    (named.collect(), reader.skipped.clone(), reader.notes.clone(), reader.times_are_relative())
}

const HEAD: &str = "date Sam Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\n\
                    internal events logged\n// version 9.0.0\n\
                    Begin Triggerblock Sam Sep 30 15:06:13.191 2017\n";
const START: u64 = 1_506_783_973_191_000_000;

#[test]
fn every_form_of_a_frame_is_read() {
    let none = CanFlags::default();
    let (ext, tx, fd) = (CanFlags::EXTENDED, CanFlags::TX, CanFlags::FD);
    let can = |id, flags, data: &[u8]| CanFrame::new(id, flags, data);
    let remote = |id, flags, dlc| can(id, flags | CanFlags::REMOTE, &[]).with_dlc(dlc);
    let error = can(0x80, CanFlags::ERROR, &[0; 8]);
    let (twelve, sixteen): ([u8; 12], [u8; 16]) =
        (std::array::from_fn(|n| n as u8), std::array::from_fn(|n| n as u8));
    for (line, frame) in [
        (
            "1  6F9             Rx   d 2 05 0C  Length = 240015 BitCount = 124 ID = 1785",
            can(0x6F9, none, &[5, 12]),
        ),
        ("1  18EBFF00x       Tx   d 0", can(0x18EB_FF00, ext | tx, &[])),
        (
            "1  123             Rx   d f 01 02 03 04 05 06 07 08",
            can(0x123, none, &[1, 2, 3, 4, 5, 6, 7, 8]).with_dlc(15),
        ),
        ("1  123             Rx   r", remote(0x123, none, 0)),
        ("1  1FFFFFFFx       Tx   r 4 Length = 1 BitCount = 2", remote(0x1FFF_FFFF, ext | tx, 4)),
        (
            "1  EngineData      Rx   d 1 07  Length = 1 BitCount = 5 ID = 418119424x",
            can(418_119_424, ext, &[7]),
        ),
        ("1  ErrorFrame", error),
        (
            "1  ErrorFrame Flags = 0xe CodeExt = 0x20a2 Code = 0x82 ID = 0 DLC = 0 Position = 5",
            error,
        ),
        (
            "CANFD   1 Tx ErrorFrame Not Acknowledge error, dominant error flag fffe c7 31ca Arb. 556",
            error,
        ),
        (
            "CANFD   1 Rx  7d  Brake_4  1 0 8  8 01 1b d6 d0 8a 1f d7 f6 104812 132 323000 a800f6c9 0 0 0 0",
            can(0x7D, fd | CanFlags::BRS, &[1, 0x1B, 0xD6, 0xD0, 0x8A, 0x1F, 0xD7, 0xF6]),
        ),
        (
            "CANFD   1 Rx  88x            0 1 9 12 0 1 2 3 4 5 6 7 8 9 a b 105812 137 5000 d001b0b3",
            can(0x88, ext | fd | CanFlags::ESI, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
        ),
        ("CANFD   1 Rx  7d   0 0 1 1 ff 1 2 1000 0", can(0x7D, fd, &[0xFF])),
        ("CANFD   1 Rx  7d   0 0 0 0", can(0x7D, fd, &[])),
        // CAN FD frames of tools that know no such events: DLC in decimal, in hexadecimal, length.
        ("1 123  Rx d 9 0 1 2 3 4 5 6 7 8 9 a b", can(0x123, fd, &twelve)),
        ("1 123x Rx d 10 0 1 2 3 4 5 6 7 8 9 a b c d e f", can(0x123, ext | fd, &sixteen)),
        ("1 123  Rx d a 0 1 2 3 4 5 6 7 8 9 a b c d e f", can(0x123, fd, &sixteen)),
        ("1 123  Rx d c 0 1 2 3 4 5 6 7 8 9 a b", can(0x123, fd, &twelve)),
        // A classic frame of a CAN FD channel.
        ("CANFD   1 Tx  7d   0 0 1 1 ff 1 2 200040 0", can(0x7D, tx, &[0xFF])),
        (
            "CANFD   1 Tx  50005x 0 1 5 0 140000 73 200050 7a60 46500250",
            remote(0x50005, ext | tx, 5),
        ),
    ] {
        let (frames, skipped, notes, relative) = read(&format!("{HEAD}   0.015991 {line}\n"));
        assert_eq!((skipped.count, notes.len(), relative), (0, 0, false), "{line}: {skipped:?}");
        assert_eq!(frames, [("1".to_owned(), START + 15_991_000, frame)], "{line}");
    }
}

#[test]
fn numbers_can_be_decimal_and_times_differences() {
    let text = "date Wed Apr 16 09:21:13.159 pm 2014\nbase dec timestamps relative\n\
                no internal events logged\n 0.5 1 100 Rx d 2 10 255\n 0.25 1 Statistic: D 1\n\
                 0.25 2 536870911x Rx d 1 7\n";
    let (frames, skipped, notes, _) = read(text);
    assert_eq!((skipped.count, notes.len()), (0, 1));
    let start = 1_397_683_273_159_000_000;
    assert_eq!(
        frames[0],
        ("1".to_owned(), start + 500_000_000, CanFrame::new(100, CanFlags::default(), &[10, 255]))
    );
    assert_eq!(
        frames[1],
        (
            "2".to_owned(),
            start + 1_000_000_000,
            CanFrame::new(0x1FFF_FFFF, CanFlags::EXTENDED, &[7])
        )
    );
}

#[test]
fn blocks_go_on_or_start_over() {
    let second = 1_000_000_000;
    let line = |time: &str| format!("{time} 1 1 Rx d 0\n");
    let again = "Begin Triggerblock Sam Sep 30 15:07:13.191 2017\n";
    let times =
        |text: String| read(&text).0.iter().map(|f| (f.1 - START) / second).collect::<Vec<_>>();
    assert_eq!(
        times(format!("{HEAD}{}End TriggerBlock\n{again}{}", line("5.0"), line("61.0"))),
        [5, 61]
    );
    assert_eq!(
        times(format!("{HEAD}{}End TriggerBlock\n{again}{}", line("5.0"), line("1.0"))),
        [5, 61]
    );
    // python-can writes the date of the file into the head, that of the log into the block.
    let later = HEAD.replacen("2017", "2023", 1);
    assert_eq!(times(format!("{later}{}", line("5.0"))), [5]);
    // Without any date, times are the log's own.
    assert!(read(&format!("base hex timestamps absolute\n{}", line("5.0"))).3);
    assert!(read(&line("5.0")).3);
}

#[test]
fn other_events_are_passed_over_and_broken_frames_are_counted() {
    let text = format!(
        "{HEAD}   0.000000 Start of measurement\n   0.015991 CAN 1 Status:chip status error active\n\
            1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n\
            3.297743 1  J1939TP FEE3p        6    0  0   -   Rx   d 23 A0 0F\n\
            3.3 Li 1 3c Rx 8 00\n   3.4 1 123 TxRq d 1 00\n   4.0 1 123 Rx d 2 00\n\
            4.1 1 800 Rx d 0\n   4.2 1 123 Rx d 2 00 100\n   4.3 CANFD 1 Rx 1 0 0 9 99\n   4.4 1 123"
    );
    let (frames, skipped, notes, _) = read(&text);
    assert_eq!(frames, []);
    assert_eq!(skipped.count, 5, "{skipped:?}");
    assert!(notes[0].starts_with("5 line(s)"), "{notes:?}");
}
