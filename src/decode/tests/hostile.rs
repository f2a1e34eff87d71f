//! Files made to harm.

use std::fmt::Write as _;

use proptest::prelude::*;

use super::super::can::CanDecoder;
use super::super::dbc::{self, MAX_SIGNALS, MAX_SIGNALS_PER_MESSAGE};
use super::{frame, parse};

fn signals(text: &mut String, count: usize) {
    for index in 0..count {
        writeln!(text, " SG_ s{index} : 0|8@1+ (1,0) [0|0] \"\" Y").unwrap();
    }
}

#[test]
fn signals_beyond_the_limits_are_counted_not_loaded() {
    let mut text = "BO_ 16 A: 8 X\n".to_owned();
    signals(&mut text, MAX_SIGNALS_PER_MESSAGE + 1_000_000);
    let parsed = parse(&text);
    assert_eq!(parsed.database.messages[0].signals.len(), MAX_SIGNALS_PER_MESSAGE);
    assert_eq!(parsed.oddities.lost(), 1_000_000);
    assert_eq!(parsed.oddities.list().len(), 1000);

    let mut text = String::new();
    let messages = MAX_SIGNALS / 4096 + 1;
    for id in 0..messages {
        writeln!(text, "BO_ {id} M{id}: 8 X").unwrap();
        signals(&mut text, 4096);
    }
    let parsed = parse(&text);
    let loaded: usize = parsed.database.messages.iter().map(|m| m.signals.len()).sum();
    assert_eq!(loaded, MAX_SIGNALS);
    assert_eq!(parsed.oddities.lost(), 4096);
}

#[test]
fn one_endless_statement_is_cut_and_said() {
    let mut text = "BO_ 16 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\nVAL_ 16 s ".to_owned();
    for value in 0..1_000_000 {
        write!(text, "{value} \"x\" ").unwrap();
    }
    let parsed = parse(&text);
    assert!(parsed.oddities.lost() >= 1);
    assert!(parsed.database.messages[0].signals[0].labels.as_ref().unwrap().len() < 200_000);
}

#[test]
fn texts_that_never_end_take_linear_time() {
    let head = "BO_ 16 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n";
    for piece in ["\\\"", "CM_ \"\n", "\"\n", "BO_ 1 \"\n", "SG_ a : \"\n \n", "(((("] {
        let text = format!("{head}CM_ \"{}", piece.repeat(4_000_000 / piece.len()));
        assert_eq!(parse(&text).database.messages.len(), 1);
    }
}

#[test]
fn a_name_used_a_hundred_thousand_times_takes_linear_time() {
    let mut text = String::new();
    for id in 0..60_000 {
        writeln!(text, "BO_ {} SAME: 8 X", 0x8000_0000_u32 + id).unwrap();
    }
    assert_eq!(parse(&text).database.messages[59_999].name, "SAME_60000");
}

const SEED: &str = "VERSION \"\"\nBU_: X Y\nBO_ 16 A: 8 X\n SG_ page M : 0|8@1+ (1,0) [0|0] \"\" Y\n\
     \x20SG_ a m0M : 15|12@0- (0.5,-40) [0|0] \"V\" X,Y\n SG_ f m1 : 32|32@1- (1,0) [0|0] \"\" Y\n\
    CM_ SG_ 16 a \"text\";\nSG_MUL_VAL_ 16 f a 1-3, 7-7;\nVAL_ 16 a -1 \"x\" 2 \"y\" ;\n\
    SIG_VALTYPE_ 16 f : 1;\nBA_DEF_ BO_ \"VFrameFormat\" ENUM \"a\",\"J1939PG\";\n\
    BA_ \"VFrameFormat\" BO_ 16 1;\nBO_TX_BU_ 16 : X,Y;\n";

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn no_damage_to_a_file_makes_the_decoder_panic(
        damage in prop::collection::vec((0..SEED.len(), any::<u8>(), 0..4), 1..20),
        data in prop::collection::vec(any::<u8>(), 0..=64),
    ) {
        let mut bytes = SEED.as_bytes().to_vec();
        for (at, byte, kind) in damage {
            let at = at % bytes.len().max(1);
            match kind {
                0 if !bytes.is_empty() => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                2 if !bytes.is_empty() => { bytes.remove(at); }
                _ => bytes.insert(at, b"0123456789mM|@:;\"\n -+"[usize::from(byte) % 21]),
            }
        }
        if let Ok(parsed) = dbc::parse(&bytes) {
            let ids: Vec<u32> = parsed.database.messages.iter().map(|m| m.id).collect();
            let decoder = CanDecoder::new(parsed.database, true);
            for id in ids {
                let frame = frame(id, &data);
                if let Some(found) = decoder.find(&frame) {
                    found.decode(&frame, |reading| {
                        let _ = found.message.signals[reading.signal].label(reading.raw);
                    });
                }
            }
        }
    }
}
