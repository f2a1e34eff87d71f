//! Against a decoder that takes bit by bit.

use proptest::prelude::*;

use super::super::can::{CanDecoder, Value};
use super::super::dbc::{ByteOrder, Database, Message, Number, Signal};
use crate::frame::CanFrame;

/// The bits one after the other, as the format document numbers them.
fn slow(signal: &Signal, data: &[u8]) -> Option<u64> {
    let mut raw = 0_u64;
    let mut at = usize::from(signal.start);
    for place in 0..signal.length {
        let bit = u64::from(*data.get(at / 8)? >> (at % 8) & 1);
        match signal.order {
            ByteOrder::Intel => {
                raw |= bit << place;
                at += 1;
            }
            ByteOrder::Motorola => {
                raw = raw << 1 | bit;
                at = if at.is_multiple_of(8) { at + 15 } else { at - 1 };
            }
        }
    }
    Some(raw)
}

fn slow_value(signal: &Signal, raw: u64) -> Value {
    let scaled = signal.factor != 1.0 || signal.offset != 0.0;
    let negative = signal.length > 0 && raw >> (signal.length - 1) & 1 == 1;
    let integer = match signal.number {
        Number::Signed if negative => i128::from(raw) - (1_i128 << signal.length),
        _ => i128::from(raw),
    };
    let float = match signal.number {
        Number::Float32 => f64::from(f32::from_bits(raw as u32)),
        Number::Float64 => f64::from_bits(raw),
        _ => integer as f64,
    };
    match signal.number {
        _ if scaled => Value::Float(float * signal.factor + signal.offset),
        Number::Unsigned => Value::Unsigned(raw),
        Number::Signed => Value::Signed(integer as i64),
        Number::Float32 | Number::Float64 => Value::Float(float),
    }
}

fn same(a: Value, b: Value) -> bool {
    match (a, b) {
        (Value::Float(a), Value::Float(b)) => {
            a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
        }
        _ => a == b,
    }
}

prop_compose! {
    fn signals()(
        start in 0_u16..512,
        length in 1_u16..=64,
        intel: bool,
        kind in 0..4_usize,
        scaled: bool,
        factor in -1e3..1e3_f64,
        offset in -1e6..1e6_f64,
    ) -> Signal {
        let number = [Number::Unsigned, Number::Signed, Number::Float32, Number::Float64][kind];
        let length = match number { Number::Float32 => 32, Number::Float64 => 64, _ => length };
        Signal {
            name: "s".into(), start, length, number,
            order: if intel { ByteOrder::Intel } else { ByteOrder::Motorola },
            factor: if scaled { factor } else { 1.0 },
            offset: if scaled { offset } else { 0.0 },
            min: 0.0, max: 0.0, unit: String::new(), switch: false, gate: None,
            labels: None, comment: String::new(), line: 1,
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn every_signal_decodes_as_bit_by_bit(
        all in prop::collection::vec(signals(), 1..12),
        data in prop::collection::vec(any::<u8>(), 0..=64),
    ) {
        let signals: Vec<Signal> = all.into_iter().filter(|signal| signal.bytes() <= 64).collect();
        let message = Message { id: 5, name: "m".into(), length: 8, signals, ..Message::default() };
        let database = Database { messages: vec![message], ..Database::default() };
        let decoder = CanDecoder::new(database, false);
        let frame = CanFrame::new(5, crate::frame::CanFlags::FD, &data);
        let found = decoder.find(&frame).unwrap();
        let mut readings = vec![None; found.message.signals.len()];
        found.decode(&frame, |reading| readings[reading.signal] = Some(reading));
        for (signal, reading) in found.message.signals.iter().zip(readings) {
            let raw = slow(signal, &data);
            prop_assert_eq!(reading.map(|reading| reading.raw), raw, "{:?}", signal);
            if let (Some(reading), Some(raw)) = (reading, raw) {
                let expected = slow_value(signal, raw);
                prop_assert!(same(reading.value, expected), "{:?} {:?}", reading, expected);
            }
        }
    }
}
