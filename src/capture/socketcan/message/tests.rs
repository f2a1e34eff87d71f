use super::*;

fn classic_bytes(id: u32, length: u8, raw: u8, data: [u8; 8]) -> Vec<u8> {
    let mut bytes = id.to_ne_bytes().to_vec();
    bytes.extend([length, 0, 0, raw]);
    bytes.extend(data);
    bytes
}

fn fd_bytes(id: u32, length: u8, flags: u8, data: u8) -> Vec<u8> {
    let mut bytes = id.to_ne_bytes().to_vec();
    bytes.extend([length, flags, 0, 0]);
    bytes.extend([data; 64]);
    bytes
}

fn control(kind: i32, value: &[u8]) -> Vec<u8> {
    let mut bytes = (CONTROL_HEADER + value.len()).to_ne_bytes().to_vec();
    bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
    bytes.extend(kind.to_ne_bytes());
    bytes.extend(value);
    bytes.resize(bytes.len().next_multiple_of(WORD), 0);
    bytes
}

fn times(values: &[i64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_ne_bytes()).collect()
}

fn frame(payload: &[u8]) -> CanFrame {
    decode(RawMessage { payload, control: &[], flags: 0 }).unwrap().frame
}

const DATA: [u8; 8] = [1, 2, 3, 4, 5, 6, 7, 8];

#[test]
fn classic_frames() {
    assert_eq!(
        frame(&classic_bytes(0x123, 3, 0, DATA)),
        CanFrame::new(0x123, CanFlags::default(), &[1, 2, 3])
    );
    assert_eq!(
        frame(&classic_bytes(0x8000_0123, 8, 0, DATA)),
        CanFrame::new(0x123, CanFlags::EXTENDED, &DATA)
    );
    assert_eq!(
        frame(&classic_bytes(0x9FFF_FFFF, 0, 0, DATA)),
        CanFrame::new(0x1FFF_FFFF, CanFlags::EXTENDED, &[])
    );
}

#[test]
fn a_raw_dlc_counts_only_where_it_says_more_than_the_length() {
    for (length, raw, dlc) in [(8, 9, 9), (8, 15, 15), (8, 16, 0), (8, 8, 0), (7, 9, 0)] {
        assert_eq!(frame(&classic_bytes(1, length, raw, DATA)).dlc, dlc, "{length} {raw}");
    }
}

#[test]
fn remote_frames_have_a_length_but_no_data() {
    let remote = frame(&classic_bytes(0x4000_0123, 5, 0, DATA));
    assert_eq!(remote, CanFrame::new(0x123, CanFlags::REMOTE, &[]).with_dlc(5));
    assert_eq!(frame(&classic_bytes(0xC000_0123, 8, 13, DATA)).dlc, 13);
}

#[test]
fn error_frames_keep_class_bits_and_data() {
    let bytes = classic_bytes(0x2000_0004, 8, 0, [0, 0x20, 0, 0, 0, 0, 0, 0]);
    let expected = CanFrame::new(0x4, CanFlags::ERROR, &[0, 0x20, 0, 0, 0, 0, 0, 0]);
    assert_eq!(frame(&bytes), expected);
    assert_eq!(frame(&classic_bytes(0x3FFF_FFFF, 8, 0, DATA)).id, 0x1FFF_FFFF);
}

#[test]
fn the_size_makes_a_frame_fd_not_the_flag() {
    let fd = frame(&fd_bytes(0x8000_0123, 64, 0x01 | 0x02 | 0x04, 9));
    let flags = CanFlags::FD | CanFlags::EXTENDED | CanFlags::BRS | CanFlags::ESI;
    assert_eq!(fd, CanFrame::new(0x123, flags, &[9; 64]));
    assert_eq!(frame(&fd_bytes(0x7FF, 0, 0, 9)), CanFrame::new(0x7FF, CanFlags::FD, &[]));
}

#[test]
fn lengths_that_no_frame_has_are_cut() {
    assert_eq!(frame(&classic_bytes(1, 255, 255, DATA)).data(), DATA);
    assert_eq!(frame(&fd_bytes(1, 255, 0, 7)).data(), [7; 64]);
    for length in (0..200).filter(|n| ![CLASSIC, FD].contains(n)) {
        let payload = vec![0xFF; length];
        assert_eq!(decode(RawMessage { payload: &payload, control: &[], flags: 0 }), None);
    }
}

#[test]
fn frames_of_this_host_are_marked() {
    let payload = classic_bytes(1, 0, 0, DATA);
    let message = RawMessage { payload: &payload, control: &[], flags: libc::MSG_DONTROUTE };
    assert_eq!(decode(message).unwrap().frame.flags, CanFlags::TX);
}

#[test]
fn stamps_and_drops_come_in_any_order() {
    let kernel = control(libc::SO_TIMESTAMPNS, &times(&[1_700_000_000, 123_456_789]));
    let hardware = control(libc::SO_TIMESTAMPING, &times(&[0, 0, 0, 0, 12, 5]));
    let drops = control(libc::SO_RXQ_OVFL, &70_000u32.to_ne_bytes());
    let expected = Stamps {
        kernel: Some(1_700_000_000_123_456_789),
        hardware: Some(12_000_000_005),
        drops: Some(70_000),
    };
    assert_eq!(stamps(&[kernel.clone(), hardware.clone(), drops.clone()].concat()), expected);
    assert_eq!(stamps(&[drops, hardware, kernel].concat()), expected);
}

#[test]
fn newer_and_narrower_times_are_understood() {
    let newer = control(libc::SO_TIMESTAMPNS_NEW, &times(&[2, 1]));
    assert_eq!(stamps(&newer).kernel, Some(2_000_000_001));
    let narrow: Vec<u8> = [2i32, 1].iter().flat_map(|v| v.to_ne_bytes()).collect();
    assert_eq!(stamps(&control(libc::SO_TIMESTAMPNS, &narrow)).kernel, Some(2_000_000_001));
}

#[test]
fn no_hardware_time_is_none() {
    let none = control(libc::SO_TIMESTAMPING, &times(&[5, 5, 0, 0, 0, 0]));
    assert_eq!(stamps(&none).hardware, None);
}

#[test]
fn control_messages_cut_or_lying_about_their_length_do_no_harm() {
    let whole = [
        control(libc::SO_RXQ_OVFL, &7u32.to_ne_bytes()),
        control(libc::SO_TIMESTAMPNS, &times(&[2, 1])),
    ]
    .concat();
    for end in 0..whole.len() {
        let cut = stamps(&whole[..end]);
        assert!(cut.kernel.is_none() && (cut.drops.is_none() || end >= CONTROL_HEADER + 4));
    }
    for length in [0, 1, CONTROL_HEADER - 1, CONTROL_HEADER, usize::MAX, usize::MAX - 7, 1 << 40] {
        let mut wrong = whole.clone();
        wrong[..WORD].copy_from_slice(&length.to_ne_bytes());
        assert_eq!(stamps(&wrong).drops, None, "{length}");
    }
    for at in 0..whole.len() {
        for byte in [0, 1, 0x7F, 0x80, 0xFF] {
            let mut wrong = whole.clone();
            wrong[at] = byte;
            stamps(&wrong);
        }
    }
    assert_eq!(stamps(&control(libc::SO_TIMESTAMPNS, &times(&[-1, 5]))).kernel, None);
    assert_eq!(stamps(&control(libc::SO_TIMESTAMPNS, &times(&[i64::MAX, 5]))).kernel, None);
}
