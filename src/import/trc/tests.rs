use super::*;
use crate::frame::{CanFlags, CanFrame};

type Found = (Vec<(String, u64, CanFrame)>, Skipped, Vec<String>, bool);

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

const V1_0: &str = "\
;##########################################################################
;   C:\\TraceFile.trc
;    CAN activities recorded by PCAN Explorer
;    Start time: 11.09.2002 16:00:20.682
;    PCAN-Net: PCI1
;----+-   ---+---  ----+---  +  -+ -- -- ...
     1)      1841      0001  8  00 00 00 00 00 00 00 00
     2)      1842      0008  4  ERROR 00 19 08 08
     3)      1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT
     4)      1844      0100  3  RTR
";

const V2_0: &str = "\
;$FILEVERSION=2.0
;$STARTTIME=42209.4075997106
;$COLUMNS=N,O,T,I,d,l,D
      1      1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00
      5      1334.416 FD     0500 Tx 12 01 02 03 04 05 06 07 08 09 0A 0B 0C
      6      1334.522 ER          Rx    04 00 02 00 00
      7      1334.531 ST          Rx    00 00 00 08
      8      1334.643 EC          Rx    02 02
      9      1335.156 DT 18EFC034 Tx 2  00 00
     10      1336.543 RR     0100 Rx 3
";

const V2_1: &str = "\
;$FILEVERSION=2.1
;$STARTTIME=41766.4648963872
;$COLUMNS=N,O,T,B,I,d,R,L,D
      1      1059.900 DT 2      0300 Rx -  7    00 00 00 00 04 00 00
      5      1334.416 FB 1      0500 Tx -  9    01 02 03 04 05 06 07 08 09 0A 0B 0C
      6      1334.222 ER 1         - Rx -  5    04 00 02 00 00
      7      1334.224 EV 1  User-defined event for bus 1
      8      1334.225 EV -  User-defined event for all busses
      9      1334.231 ST 1         - Rx -  4    00 00 00 08
     11      1334.643 EC 1         - Rx -  2    02 02
     12      1335.156 DT 1  18EFC034 Tx -  2    00 00
     13      1336.543 RR 1      0100 Rx -  3
";

/// The examples of the specification, in the five layouts it has had.
#[test]
fn all_versions_are_read() {
    let rows = |middle: [&str; 5]| middle.map(|row| format!("{row}\n")).concat();
    let v1_1 = format!(
        ";$FILEVERSION=1.1\n;$STARTTIME=37704.5364870833\n{}",
        rows([
            "     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00",
            "     3)      1298,9  Tx     18EFC034  2  00 00",
            "     5)      1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT",
            "     6)      1349.2  Error      0008  4  00 19 08 08",
            "     7)      1352.7  Rx         0100  3  RTR",
        ])
    );
    let v1_2 = format!(
        ";$FILEVERSION=1.2\n;$STARTTIME=39878.6772258947;\n{}",
        rows([
            "     1)      1059.900  2  Rx         0300  7  00 00 00 00 04 00 00",
            "     3)      1298.945  1  Tx     18EFC034  2  00 00",
            "     5)      1346.834  1  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT",
            "     6)      1349.222  1  Error      0008  4  00 19 08 08",
            "     7)      1352.743  1  Rx         0100  3  RTR",
        ])
    );
    let v1_3 = format!(
        ";$FILEVERSION=1.3\n;$STARTTIME=44548.6028595139\n{}",
        rows([
            "     1)      1059.900 2  Rx        0300 -  7    00 00 00 00 04 00 00",
            "     3)      1298.945 1  Tx    18EFC034 -  2    00 00",
            "     5)      1346.834 1  Warng FFFFFFFF -  4    00 00 00 04  BUSLIGHT",
            "     6)      1349.222 1  Error     0008 -  4    00 19 08 08",
            "     7)      1352.743 1  Rx        0100 -  3    RTR",
        ])
    );
    let data = CanFrame::new(0x300, CanFlags::default(), &[0, 0, 0, 0, 4, 0, 0]);
    let sent = CanFrame::new(0x18EF_C034, CanFlags::EXTENDED | CanFlags::TX, &[0, 0]);
    let remote = CanFrame::new(0x100, CanFlags::REMOTE, &[]).with_dlc(3);
    for (text, others, bus) in [
        (&v1_1, 1, "1"),
        (&v1_2, 1, "2"),
        (&v1_3, 1, "2"),
        (&V2_0.to_owned(), 2, "1"),
        (&V2_1.to_owned(), 4, "2"),
    ] {
        let (frames, skipped, notes, relative) = read(text);
        assert_eq!((skipped.count, relative), (0, false), "{text}{skipped:?}");
        assert!(notes[0].starts_with(&format!("{others} line(s)")), "{notes:?}");
        let kinds: Vec<_> = frames
            .iter()
            .map(|f| f.2)
            .filter(|f| !f.flags.has(CanFlags::ERROR) && !f.flags.has(CanFlags::FD))
            .collect();
        assert_eq!(kinds, [data, sent, remote], "{text}");
        assert_eq!(frames.iter().filter(|f| f.2.flags.has(CanFlags::ERROR)).count(), 1);
        assert_eq!(frames[0].0, bus);
        assert_eq!(frames[0].1 % 1000, read(text).0[0].1 % 1000);
    }
    let (frames, ..) = read(V2_1);
    let fd = CanFlags::FD | CanFlags::BRS | CanFlags::TX;
    assert_eq!(frames[1].2, CanFrame::new(0x500, fd, &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]));
    // 41766.4648963872 days and 1059.9 ms.
    assert_eq!(frames[0].1, 1_399_460_967_047_854_080 + 1_059_900_000);
    let (frames, skipped, _, relative) = read(V1_0);
    assert_eq!((frames.len(), skipped.count, relative), (3, 0, false));
    assert_eq!(frames[2].2, remote);
    assert_eq!(frames[0].1, 1_031_760_020_682_000_000 + 1_841_000_000);
    let error = CanFrame::new(0x88, CanFlags::ERROR, &[0, 0, 0x80, 0x19, 0, 0, 8, 8]);
    assert_eq!(frames[1].2, error);
}

#[test]
fn lines_that_cannot_be_taken_are_counted() {
    let text = ";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n\
        1 1.000 DT 1 0300 Rx - 2 00 11\n2 2.000 DT 1 0800 Rx - 0\n3 3.000 DT 1 0300 Rx - 3 00 11\n\
        4 x DT 1 0300 Rx - 0\n5 5.000 FD 1 0300 Rx - 16 00\n6 6.0";
    let (frames, skipped, notes, relative) = read(text);
    assert_eq!((frames.len(), skipped.count, relative), (1, 5, true));
    assert_eq!(skipped.first[1], ("line 5".to_owned(), "it has 2 of its 3 bytes".to_owned()));
    assert!(notes[0].contains("cut off"));
}
