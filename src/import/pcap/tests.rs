use super::*;
use crate::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes};

fn read(bytes: &[u8]) -> (Vec<(String, u64, Frame)>, Skipped, Vec<String>) {
    assert!(recognises(bytes));
    let mut reader = open(Box::new(std::io::Cursor::new(bytes.to_vec()))).unwrap();
    let mut frames = Vec::new();
    while reader.read(&mut frames).unwrap() {}
    let named = frames
        .into_iter()
        .map(|f| (reader.buses()[usize::from(f.bus)].clone(), f.frame.time.nanos(), f.frame.value));
    (named.collect(), reader.skipped.clone(), reader.notes.clone())
}

/// Numbers in one byte order.
#[derive(Clone, Copy)]
struct Order(bool);

impl Order {
    fn u32(self, value: u32) -> [u8; 4] {
        if self.0 { value.to_be_bytes() } else { value.to_le_bytes() }
    }

    fn pcap(self, magic: u32, link: u32, packets: &[(u32, u32, &[u8])]) -> Vec<u8> {
        let words = [magic, if self.0 { 0x0002_0004 } else { 0x0004_0002 }, 0, 0, 65535, link];
        let mut out = words.map(|word| self.u32(word)).concat();
        for (seconds, fraction, data) in packets {
            let length = data.len() as u32;
            out.extend([*seconds, *fraction, length, length].map(|word| self.u32(word)).concat());
            out.extend_from_slice(data);
        }
        out
    }

    fn block(self, kind: u32, body: &[u8]) -> Vec<u8> {
        let length = self.u32(12 + body.len().next_multiple_of(4) as u32);
        let mut out = [self.u32(kind), length].concat();
        out.extend_from_slice(body);
        out.resize(8 + body.len().next_multiple_of(4), 0);
        out.extend_from_slice(&length);
        out
    }
}

const DATA: &[u8] = &[0x98, 0xEF, 0xC0, 0x34, 2, 0, 0, 0, 7, 8, 0, 0, 0, 0, 0, 0];
const FD: &[u8] = &[0, 0, 1, 0x23, 3, 1 | 4, 0, 0, 1, 2, 3];
const REMOTE: &[u8] = &[0x40, 0, 1, 0x23, 4, 0, 0, 0];
const RAW: &[u8] = &[0, 0, 1, 0x23, 8, 0, 0, 12, 1, 2, 3, 4, 5, 6, 7, 8];

fn expected() -> [Frame; 4] {
    let none = CanFlags::default();
    [
        CanFrame::new(0x18EF_C034, CanFlags::EXTENDED, &[7, 8]),
        CanFrame::new(0x123, CanFlags::FD | CanFlags::BRS, &[1, 2, 3]),
        CanFrame::new(0x123, CanFlags::REMOTE, &[]).with_dlc(4),
        CanFrame::new(0x123, none, &[1, 2, 3, 4, 5, 6, 7, 8]).with_dlc(12),
    ]
    .map(Frame::Can)
}

#[test]
fn pcap_is_read_in_both_byte_orders_and_resolutions() {
    for big in [false, true] {
        for (magic, nanos) in [(0xA1B2_C3D4, 5000), (0xA1B2_3C4D, 5)] {
            let packets = [DATA, FD, REMOTE, RAW].map(|data| (1, 5, data));
            let file = Order(big).pcap(magic, 227, &packets);
            let (frames, skipped, _) = read(&file);
            assert_eq!(skipped.count, 0, "{skipped:?}");
            let frame = |frame| ("can0".to_owned(), 1_000_000_000 + nanos, frame);
            assert_eq!(frames, expected().map(frame));
            // Every cut gives what is whole.
            for end in 24..file.len() {
                let (part, skipped, _) = read(&file[..end]);
                assert_eq!(part, frames[..part.len()], "{end}");
                let whole = [24, 56, 83, 107].contains(&end);
                assert_eq!(skipped.count, u64::from(!whole), "{end}");
            }
        }
    }
}

#[test]
fn captures_of_all_interfaces_are_read() {
    let order = Order(false);
    let mut id = DATA.to_vec();
    id[..4].reverse();
    let sll = [&[0, 4, 1, 24, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 12][..], &id].concat();
    let ethernet = [&[0, 0, 0, 1, 0, 6, 0, 0, 0, 0, 0, 0, 0, 0, 8, 0][..], &id].concat();
    let file = order.pcap(0xA1B2_C3D4, 113, &[(1, 0, &sll), (1, 0, &ethernet)]);
    let (frames, skipped, notes) = read(&file);
    let sent = CanFrame::new(0x18EF_C034, CanFlags::EXTENDED | CanFlags::TX, &[7, 8]);
    assert_eq!(frames, [("can0".to_owned(), 1_000_000_000, Frame::Can(sent))]);
    assert_eq!((skipped.count, notes.len()), (0, 1));
    let sll2 = [&[0, 12, 0, 0, 0, 0, 0, 3, 1, 24, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..], &id].concat();
    assert_eq!(read(&order.pcap(0xA1B2_C3D4, 276, &[(1, 0, &sll2)])).0[0].0, "if3");
    // The kind of hardware is not told, the protocol (ETH_P_CANFD) is.
    let fd = [&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 13][..], &id].concat();
    let received = CanFrame::new(0x18EF_C034, CanFlags::EXTENDED | CanFlags::FD, &[7, 8]);
    let (frames, ..) = read(&order.pcap(0xA1B2_C3D4, 113, &[(1, 0, &fd)]));
    assert_eq!(frames, [("can0".to_owned(), 1_000_000_000, Frame::Can(received))]);
}

#[test]
fn pcapng_is_read_with_names_resolutions_and_directions() {
    for big in [false, true] {
        let order = Order(big);
        let half = |value: u16| if big { value.to_be_bytes() } else { value.to_le_bytes() };
        let option = |code: u16, value: &[u8]| {
            let mut out = [half(code), half(value.len() as u16)].concat();
            out.extend_from_slice(value);
            out.resize(4 + value.len().next_multiple_of(4), 0);
            out
        };
        let interface = |link: u16, options: Vec<u8>| {
            order.block(1, &[half(link).to_vec(), vec![0; 6], options, vec![0; 4]].concat())
        };
        let packet = |number: u32, units: u64, data: &[u8], options: Vec<u8>| {
            let length = data.len() as u32;
            let words = [number, (units >> 32) as u32, units as u32, length, length];
            let mut body = words.map(|word| order.u32(word)).concat();
            body.extend_from_slice(data);
            body.resize(body.len().next_multiple_of(4), 0);
            body.extend(options);
            order.block(6, &body)
        };
        let section = order.block(
            0x0A0D_0D0A,
            &[order.u32(0x1A2B_3C4D).to_vec(), vec![1, 0, 0, 0], vec![0xFF; 8]].concat(),
        );
        let serial = [&[0; 8][..], &[1, 0, 0, 0], b"\x7e\x00"].concat();
        let file = [
            section,
            interface(227, [option(2, b"vcan7"), option(9, &[9])].concat()),
            interface(227, Vec::new()),
            interface(227, option(9, &[0x8A])),
            interface(250, option(2, b"rect")),
            order.block(0x0BAD, b"unknown"),
            packet(0, 1_700_000_000_123_456_789, DATA, option(2, &order.u32(2))),
            packet(1, 5_000_007, FD, Vec::new()),
            packet(2, 1024 + 512, REMOTE, Vec::new()),
            packet(3, 7, &serial, Vec::new()),
            packet(9, 7, DATA, Vec::new()),
        ]
        .concat();
        let (frames, skipped, _) = read(&file);
        let [_, fd, remote, _] = expected();
        let sent = CanFrame::new(0x18EF_C034, CanFlags::EXTENDED | CanFlags::TX, &[7, 8]);
        let bytes = SerialBytes {
            direction: Direction::Tx,
            data: b"\x7e\x00".to_vec(),
            errors: Vec::new(),
        };
        assert_eq!(
            frames,
            [
                ("vcan7".to_owned(), 1_700_000_000_123_456_789, Frame::Can(sent)),
                ("can1".to_owned(), 5_000_007_000, fd),
                ("can2".to_owned(), 1_500_000_000, remote),
                ("rect".to_owned(), 7000, Frame::Serial(bytes)),
            ]
        );
        assert_eq!(skipped.count, 1);
        for end in 4..file.len() {
            let (part, ..) = read(&file[..end]);
            assert_eq!(part, frames[..part.len()], "{end}");
        }
    }
}
