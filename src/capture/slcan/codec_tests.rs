use super::*;
use proptest::prelude::*;

fn frame(line: &str) -> CanFrame {
    match decode(line.as_bytes()) {
        Line::Frame(frame, _) => frame,
        other => panic!("{line}: {other:?}"),
    }
}

#[test]
fn every_kind_of_line_is_read() {
    let classic = CanFlags::default();
    let extended = CanFlags::EXTENDED;
    assert_eq!(frame("t10021133"), CanFrame::new(0x100, classic, &[0x11, 0x33]));
    assert_eq!(frame("t7FF0"), CanFrame::new(0x7FF, classic, &[]));
    assert_eq!(frame("T1FFFFFFF1aB"), CanFrame::new(0x1FFF_FFFF, extended, &[0xAB]));
    assert_eq!(frame("r1004"), CanFrame::new(0x100, CanFlags::REMOTE, &[]).with_dlc(4));
    let remote = CanFrame::new(0x100, CanFlags::REMOTE | extended, &[]).with_dlc(8);
    assert_eq!(frame("R000001008"), remote);
    let long = format!("d1239{}", "5A".repeat(12));
    assert_eq!(frame(&long), CanFrame::new(0x123, CanFlags::FD, &[0x5A; 12]));
    let long = format!("B00000123F{}", "A5".repeat(64));
    let flags = CanFlags::FD | CanFlags::BRS | extended;
    assert_eq!(frame(&long), CanFrame::new(0x123, flags, &[0xA5; 64]));
    let raw_dlc = CanFrame::new(0x123, classic, &[1; 8]).with_dlc(0xF);
    assert_eq!(frame(&format!("t123F{}", "01".repeat(8))), raw_dlc);
}

#[test]
fn stamps_are_read_and_must_be_possible() {
    let stamp = |line: &[u8]| match decode(line) {
        Line::Frame(_, stamp) => Some(stamp),
        _ => None,
    };
    assert_eq!(stamp(b"t1001AAEA5F"), Some(Some(59_999)));
    assert_eq!(stamp(b"t1001AA0000"), Some(Some(0)));
    assert_eq!(stamp(b"t1001AA"), Some(None));
    assert_eq!(stamp(b"t1001AA0012D687"), Some(None));
    for wrong in [&b"t1001AAEA60"[..], b"t1001AA000", b"t1001AA00G0", b"t1001AA00000"] {
        assert_eq!(decode(wrong), Line::Garbage, "{wrong:?}");
    }
}

#[test]
fn answers_are_told_from_frames() {
    assert_eq!(decode(b""), Line::Acknowledged);
    assert_eq!(decode(b"z"), Line::Acknowledged);
    assert_eq!(decode(b"Z"), Line::Acknowledged);
    assert_eq!(decode(b"F09"), Line::Status(status::RX_FULL | status::OVERRUN));
    assert_eq!(decode(b"V1013"), Line::Information);
    assert_eq!(decode(b"NA123"), Line::Information);
}

#[test]
fn states_and_errors_become_the_error_frames_the_kernel_makes() {
    // CAN_ERR_CRTL | CAN_ERR_CNT, CAN_ERR_CRTL_RX_PASSIVE, counters in data[6] and data[7].
    assert_eq!(
        frame("sp130007"),
        CanFrame::new(0x204, CanFlags::ERROR, &[0, 0x10, 0, 0, 0, 0, 7, 130])
    );
    assert_eq!(frame("sb000255").id, 0x240);
    // CAN_ERR_PROT | CAN_ERR_BUSERROR and what the letters add.
    assert_eq!(frame("e1a"), CanFrame::new(0xA8, CanFlags::ERROR, &[0, 0, 0, 0x19, 0, 0, 0, 0]));
    let three = frame("e3bcO");
    assert_eq!(three, CanFrame::new(0x8C, CanFlags::ERROR, &[0, 2, 8, 8, 0, 0, 0, 0]));
    assert!(is_overflow(&frame("e1o")) && !is_overflow(&three));
    for wrong in ["e", "e0", "e2a", "e1q", "s", "sx000000", "sa00000", "sa0000000", "sa0x0000"] {
        assert_eq!(decode(wrong.as_bytes()), Line::Garbage, "{wrong}");
    }
}

#[test]
fn hostile_lines_are_garbage() {
    for line in [
        "t",
        "t1",
        "t10",
        "t100",
        "t8001AA",
        "t1001",
        "t1001A",
        "t1001AG",
        "tG001AA",
        "t-011AA",
        "T200000001AA",
        "T1234567",
        "d1239AA",
        "x",
        "\u{e9}",
        "r",
        "t100\u{e9}",
        "F",
        "F1",
        "F123",
        "FGG",
        "zz",
        "A",
        "+001",
        "t 101AA",
    ] {
        assert_eq!(decode(line.as_bytes()), Line::Garbage, "{line}");
    }
}

fn any_frame() -> impl Strategy<Value = CanFrame> {
    let data = prop::collection::vec(any::<u8>(), 64);
    (any::<bool>(), 0_u8..4, any::<u32>(), 0_u8..16, data).prop_map(
        |(extended, kind, id, dlc, data)| {
            let mut flags =
                [CanFlags::default(), CanFlags::REMOTE, CanFlags::FD, CanFlags::FD | CanFlags::BRS]
                    [usize::from(kind)];
            let id = if extended {
                flags |= CanFlags::EXTENDED;
                id & 0x1FFF_FFFF
            } else {
                id & 0x7FF
            };
            let length = usize::from(FD_LENGTHS[usize::from(dlc)]);
            match kind {
                0 => CanFrame::new(id, flags, &data[..length.min(8)]).with_dlc(if dlc > 8 {
                    dlc
                } else {
                    0
                }),
                1 => CanFrame::new(id, flags, &[]).with_dlc(dlc),
                _ => CanFrame::new(id, flags, &data[..length]),
            }
        },
    )
}

proptest! {
    #[test]
    fn every_frame_comes_back_from_its_line(frame in any_frame(), ms in 0_u16..60_000) {
        let line = encode(&frame).unwrap();
        let line = line.strip_suffix('\r').unwrap();
        prop_assert_eq!(decode(line.as_bytes()), Line::Frame(frame, None));
        let stamped = format!("{line}{ms:04X}");
        prop_assert_eq!(decode(stamped.as_bytes()), Line::Frame(frame, Some(ms)));
    }

    #[test]
    fn any_bytes_are_taken_without_harm(line in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = decode(&line);
    }

    #[test]
    fn near_misses_are_taken_without_harm(line in "[tTrRdDbBseFzZ][0-9A-Fa-fa-z\r]{0,150}") {
        let _ = decode(line.as_bytes());
    }
}
