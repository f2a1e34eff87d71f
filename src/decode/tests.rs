//! Promises of decoding.

mod bus;
mod hmi_can;
mod hostile;
mod multiplexing;
mod odd_files;
mod random;

use super::can::{CanDecoder, Check, Value};
use super::dbc::{self, Parsed};
use crate::frame::{CanFlags, CanFrame};

fn parse(text: &str) -> Parsed {
    dbc::parse(text.as_bytes()).unwrap()
}

fn decoder(text: &str) -> CanDecoder {
    CanDecoder::new(parse(text).database, false)
}

fn frame(id: u32, data: &[u8]) -> CanFrame {
    let flags = if id > 0x7FF { CanFlags::EXTENDED } else { CanFlags::default() };
    CanFrame::new(id, flags, data)
}

/// Names and values, in the order of decoding.
fn values(decoder: &CanDecoder, frame: &CanFrame) -> Vec<(String, Value)> {
    let found = decoder.find(frame).unwrap();
    let mut values = Vec::new();
    found.decode(frame, |reading| {
        values.push((found.message.signals[reading.signal].name.clone(), reading.value));
    });
    values
}

fn names(decoder: &CanDecoder, frame: &CanFrame) -> Vec<String> {
    values(decoder, frame).into_iter().map(|(name, _)| name).collect()
}

#[test]
fn remote_and_error_frames_never_decode_as_data() {
    let decoder = decoder("BO_ 16 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n");
    assert!(decoder.find(&frame(16, &[1; 8])).is_some());
    for flag in [CanFlags::REMOTE, CanFlags::ERROR, CanFlags::EXTENDED] {
        assert!(decoder.find(&CanFrame::new(16, flag, &[1; 8])).is_none(), "{flag:?}");
    }
}

#[test]
fn a_short_frame_gives_what_lies_inside_and_a_long_one_its_extra_bytes() {
    let decoder = decoder(
        "BO_ 16 A: 4 X\n SG_ a : 0|16@1+ (1,0) [0|0] \"\" Y\n SG_ b : 16|16@1+ (1,0) [0|0] \"\" Y\n",
    );
    let of = |data: &[u8]| {
        let frame = frame(16, data);
        let found = decoder.find(&frame).unwrap();
        (names(&decoder, &frame), found.check, found.extra(&frame).to_vec())
    };
    assert_eq!(of(&[0; 4]), (vec!["a".into(), "b".into()], Check::Exact, vec![]));
    assert_eq!(of(&[0; 3]), (vec!["a".into()], Check::Short, vec![]));
    assert_eq!(of(&[]), (vec![], Check::Short, vec![]));
    assert_eq!(of(&[1, 2, 3, 4, 5]).1, Check::Long);
    assert_eq!(of(&[1, 2, 3, 4, 5]).2, [5]);
}

#[test]
fn the_padding_of_can_fd_is_not_extra() {
    let decoder = decoder("BO_ 16 A: 9 X\n SG_ a : 64|8@1+ (1,0) [0|0] \"\" Y\n");
    let fd = |len: usize| CanFrame::new(16, CanFlags::FD, &vec![7; len]);
    let check = |frame: &CanFrame| decoder.find(frame).unwrap().check;
    assert_eq!(check(&fd(12)), Check::Exact);
    assert_eq!(check(&fd(16)), Check::Long);
    assert_eq!(check(&fd(8)), Check::Short);
    assert_eq!(values(&decoder, &fd(12)), [("a".to_owned(), Value::Unsigned(7))]);
}

#[test]
fn j1939_messages_are_known_by_their_group_from_any_address() {
    let text = "BO_ 2364540158 EEC1: 8 X\n SG_ speed : 24|16@1+ (0.125,0) [0|0] \"rpm\" Y\n\
        BO_ 2566834688 TSC1: 8 X\n SG_ mode : 0|2@1+ (1,0) [0|0] \"\" Y\n\
        BA_DEF_ BO_ \"VFrameFormat\" ENUM \"StandardCAN\",\"ExtendedCAN\",\"reserved\",\"J1939PG\";\n";
    let plain = decoder(text);
    let said = decoder(&format!("{text}BA_DEF_DEF_ \"VFrameFormat\" \"J1939PG\";\n"));
    let bus = decoder(&format!(
        "{}BA_ \"ProtocolType\" \"J1939\";\n",
        &text[..text.find("BA_").unwrap()]
    ));
    let forced = CanDecoder::new(parse(text).database, true);
    let other_source = frame(0x0CF0_0417, &[0, 0, 0, 0x68, 0x13, 0, 0, 0]);
    assert!(plain.find(&other_source).is_none());
    for decoder in [&said, &bus, &forced] {
        let found = decoder.find(&other_source).unwrap();
        let id = found.j1939.unwrap();
        assert_eq!((found.message.name.as_str(), id.pgn), ("EEC1", 61444));
        assert_eq!((id.source, id.destination, id.priority), (0x17, None, 3));
        assert_eq!(values(decoder, &other_source)[0].1, Value::Float(621.0));
        // PDU1: the destination is not part of the number.
        let addressed = decoder.find(&frame(0x18FE_0017, &[0; 8])).is_some();
        assert!(!addressed);
        assert!(decoder.find(&frame(0x0CF1_0417, &[0; 8])).is_none());
    }
}
