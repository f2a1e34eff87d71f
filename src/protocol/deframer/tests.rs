//! Every kind of framing: what it finds, and that cutting the input changes nothing.

use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::protocol::{Protocol, Settings};

const FLAG: &str = r#"
name = "flag"
framing = { kind = "start_flag", start = [0x7E], length = { field = "n", add = 4 }, escape = { byte = 0x7D, xor = 0x20, follows = [[0x20, 0x3F], [0x5D, 0x5E]] } }
crc = { name = "CRC_16_XMODEM" }
header = [{ name = "n", type = "u8" }]
"#;
const TWO_FLAGS: &str = r#"
name = "two-flags"
framing = { kind = "start_flag", start = [0xAA, 0xAA, 0x55], length = { field = "n" }, max = 20 }
crc = { name = "SUM_8" }
header = [{ name = "n", type = "u16", byte_order = "little" }]
"#;
const FIXED: &str = r#"
name = "fixed"
framing = { kind = "fixed", start = [0x02], size = 4 }
crc = { name = "XOR_8", from = 1 }
"#;
const LINE: &str = r#"
name = "line"
framing = { kind = "delimiter", start = [0x24], end = [13, 10], max = 8 }
"#;
const HDLC: &str = r#"
name = "hdlc"
framing = { kind = "delimiter", end = [0x7E], escape = { byte = 0x7D, xor = 0x20 }, max = 64 }
crc = { name = "CRC_16_IBM_SDLC", byte_order = "little" }
"#;
const SLIP: &str = "name = \"slip\"\nframing = { kind = \"slip\", max = 8 }";
const COBS: &str = "name = \"cobs\"\nframing = { kind = \"cobs\", max = 600 }";
const QUIET: &str = r#"
name = "quiet"
framing = { kind = "silence", gap_us = 2, max = 16 }
crc = { name = "CRC_16_MODBUS", byte_order = "little" }
"#;

fn deframer(definition: &str) -> Deframer {
    Deframer::new(Protocol::parse("test", definition, Settings::default()).unwrap().framing)
}

/// What is found in pieces that come 1 us after each other, with the times in us.
fn cuts(definition: &str, pieces: &[&[u8]]) -> Vec<(u64, Cut)> {
    let (mut deframer, mut found) = (deframer(definition), Vec::new());
    let mut take = |time: Timestamp, cut| found.push((time.0 / 1000, cut));
    for (number, piece) in pieces.iter().enumerate() {
        deframer.feed(Timestamp(number as u64 * 1000), piece, &mut take);
    }
    deframer.finish(&mut take);
    found
}

fn found(definition: &str, bytes: &[u8]) -> Vec<Cut> {
    cuts(definition, &[bytes]).into_iter().map(|(_, cut)| cut).collect()
}

fn garbage(bytes: u64) -> Cut {
    Cut::Garbage { bytes }
}

fn frame(bytes: &[u8]) -> Cut {
    Cut::Frame(bytes.to_vec())
}

#[test]
fn a_start_flag_opens_a_frame_wherever_it_stands() {
    let sum = Arc::new(crate::protocol::crc::Checksum::by_name("CRC_16_XMODEM").unwrap());
    let crc = sum.of(&[0x7E, 0]).to_be_bytes();
    let empty: Vec<u8> = [&[0x7E, 0][..], &crc[6..]].concat();
    let with = |before: &[u8]| found(FLAG, &[before, &empty].concat());
    assert_eq!(with(b"abc"), [garbage(3), frame(&empty)]);
    assert_eq!(with(&[0x7E, 0x7E]), [frame(&empty)], "flags in a row are fill");
    assert_eq!(with(&[0x7E, 0x05]), [Cut::Truncated, frame(&empty)]);
    assert_eq!(with(&[0x7E, 0x7D]), [Cut::Truncated, frame(&empty)], "the escape byte followed");
    let bad = Cut::BadEscape { byte: 0x40 };
    assert_eq!(with(&[0x7E, 0x7D, 0x40, 1, 2]), [bad, garbage(2), frame(&empty)]);
    let wrong = Cut::CrcError { received: 0x0102, computed: sum.of(&[0x7E, 0]), width: 16 };
    assert_eq!(with(&[0x7E, 0, 1, 2, 9]), [wrong, garbage(1), frame(&empty)]);
    assert_eq!(found(FLAG, &[0x7E]), [Cut::Incomplete]);
    assert_eq!(found(FLAG, &[1, 0x7E, 0x7D]), [garbage(1), Cut::Incomplete]);
}

#[test]
fn a_start_flag_of_several_bytes_may_begin_inside_itself() {
    let good = [0xAA, 0xAA, 0x55, 7, 0, 9, 0xB9];
    assert_eq!(
        found(TWO_FLAGS, &[&[0xAA, 1, 0xAA][..], &good].concat()),
        [garbage(3), frame(&good)]
    );
    let impossible = [0xAA, 0xAA, 0x55, 0xFF, 0xFF, 1];
    assert_eq!(found(TWO_FLAGS, &impossible), [Cut::BadLength { bytes: 5 }, garbage(1)]);
    assert_eq!(found(TWO_FLAGS, &[0xAA, 0xAA]), [garbage(2)], "no frame had begun");
}

#[test]
fn fixed_frames_carry_their_start_byte_as_data_too() {
    assert_eq!(found(FIXED, &[9, 2, 2, 2, 0]), [garbage(1), frame(&[2, 2, 2, 0])]);
}

#[test]
fn lines_end_with_their_delimiter_and_too_long_ones_are_counted() {
    assert_eq!(found(LINE, b"x$ab\r\r\n"), [garbage(1), frame(b"$ab\r")]);
    assert_eq!(found(LINE, b"$0123456789\r\n$a\r\n"), [Cut::TooLong { bytes: 11 }, frame(b"$a")]);
    assert_eq!(found(LINE, b"$ab"), [Cut::Incomplete]);
}

#[test]
fn hdlc_slip_and_cobs_come_out_as_their_standards_say() {
    // The check value of the catalogue, with the flag inside the data escaped.
    let sent = b"\x7E123456789\x6E\x90\x7E\x7E1\x7D\x5E\x7E";
    let good = frame(b"123456789\x6E\x90");
    let short = Cut::CrcError { received: 0x7E31, computed: 0x0, width: 16 };
    assert_eq!(found(HDLC, sent), [good, short]);
    let bad = Cut::BadEscape { byte: 1 };
    assert_eq!(
        found(SLIP, &[1, 0xDB, 0xDC, 0xDB, 0xDD, 0xC0, 0xC0, 5, 0xDB, 1, 7, 8, 0xC0, 6, 0xC0]),
        [frame(&[1, 0xC0, 0xDB]), bad, garbage(2), frame(&[6])]
    );
    // RFC 1055 and the COBS paper: a block of 254 bytes has no zero behind it.
    let long: Vec<u8> = (1..=254).collect();
    let sent = [&[3, 0x11, 0x22, 2, 0x33, 0][..], &[0xFF], &long, &[2, 9, 0], &[5, 1, 0]].concat();
    let bad = Cut::BadEncoding { bytes: 2 };
    let long = [&long[..], &[9]].concat();
    assert_eq!(found(COBS, &sent), [frame(&[0x11, 0x22, 0, 0x33]), frame(&long), bad]);
}

#[test]
fn silence_ends_a_frame() {
    let modbus: &[u8] = &[0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A];
    let (head, tail) = modbus.split_at(3);
    let (mut deframer, mut found) = (deframer(QUIET), Vec::new());
    let mut take = |time: Timestamp, cut| found.push((time.0, cut));
    for (time, piece) in [(10_000, head), (11_000, tail), (13_000, modbus), (14_000, &[0; 20])] {
        deframer.feed(Timestamp(time), piece, &mut take);
    }
    deframer.finish(&mut take);
    assert_eq!(found, [(10_000, frame(modbus)), (13_000, Cut::TooLong { bytes: 28 })]);
}

#[test]
fn a_frame_has_the_time_of_its_first_byte() {
    let found = cuts(FIXED, &[b"ab", b"c\x02\x02", b"\x02", b"\x00", b"ab", b"\x02"]);
    let good = frame(&[2, 2, 2, 0]);
    let expected = [(0, garbage(3)), (1, good), (4, garbage(2)), (5, Cut::Incomplete)];
    assert_eq!(found, expected);
}

#[test]
fn a_flood_without_a_frame_is_counted_and_not_kept() {
    let flood = vec![b'A'; 1 << 20];
    for definition in [FLAG, TWO_FLAGS, FIXED, LINE, HDLC, SLIP, COBS, QUIET] {
        let (mut deframer, mut counted) = (deframer(definition), 0);
        let mut take = |_, cut| match cut {
            Cut::Garbage { bytes } | Cut::TooLong { bytes } => counted += bytes,
            Cut::Incomplete => counted += 16 << 20,
            other => panic!("{other:?}"),
        };
        for _ in 0..16 {
            deframer.feed(Timestamp(0), &flood, &mut take);
        }
        let held = match &deframer.state {
            State::Delimited(state) => state.held(),
            State::Counted(_) | State::Silence(_) => 0,
        };
        assert!(held <= 2048, "{definition} holds {held} bytes");
        deframer.finish(&mut take);
        assert_eq!(counted, 16 << 20, "{definition}");
    }
}

proptest! {
    #[test]
    fn cutting_does_not_depend_on_the_reads(
        bytes in prop::collection::vec(
            prop::sample::select(vec![0_u8, 1, 2, 3, 5, 10, 13, 0x20, 0x24, 0x55, 0x5E, 0x7D, 0x7E, 0xAA, 0xC0, 0xDB, 0xDC, 0xFF]),
            0..200,
        ),
        at in prop::collection::vec(0_usize..200, 0..6),
    ) {
        let mut at: Vec<usize> = at.into_iter().map(|at| at.min(bytes.len())).collect();
        at.extend([0, bytes.len()]);
        at.sort_unstable();
        let pieces: Vec<&[u8]> = at.windows(2).map(|ends| &bytes[ends[0]..ends[1]]).collect();
        for definition in [FLAG, TWO_FLAGS, FIXED, LINE, HDLC, SLIP, COBS] {
            let cut: Vec<Cut> = cuts(definition, &pieces).into_iter().map(|(_, cut)| cut).collect();
            prop_assert_eq!(cut, found(definition, &bytes), "{}", definition);
        }
    }
}
