//! Encodes the signals of a CAN message straight into the open chunk.

use super::labels::Known;
use super::shape::{Kind, numbers};
use crate::decode::can::{Match, Reading, Value};
use crate::decode::dbc::{Message, Number, Signal};
use crate::decode::j1939::Identifier;
use crate::frame::CanFrame;
use crate::recording::wire;

/// How one message is encoded.
#[derive(Debug)]
pub struct Encoder {
    /// By index of the signal.
    steps: Box<[Step]>,
    /// Source and destination address, for messages that are recognised as J1939.
    addresses: Option<[Tag; 2]>,
    /// Most bytes that a message can have, and some room.
    longest: usize,
}

#[derive(Debug)]
struct Step {
    tag: Tag,
    form: Form,
    label: Option<Box<Label>>,
}

/// How a value goes onto the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Varint,
    Zigzag,
    /// Raw × factor + offset in integers.
    Whole {
        factor: i64,
        offset: i64,
        /// Bits above the sign; `None` for raw values without sign.
        unused: Option<u8>,
        zigzag: bool,
    },
    Float,
    Double,
}

#[derive(Debug)]
struct Label {
    tag: Tag,
    known: Known,
    key: Key,
}

/// What of the raw bits a value table is about; see [`Signal::label`].
#[derive(Clone, Copy, Debug)]
enum Key {
    Unsigned,
    /// Bits above the sign.
    Signed(u8),
    Float32,
    Float64,
}

/// A field's number and wire type, encoded.
#[derive(Clone, Copy, Debug)]
struct Tag {
    bytes: [u8; 4],
    length: u8,
}

/// Tag and longest value.
const LONGEST_FIELD: usize = 4 + 10;

impl Encoder {
    /// That of `message`; with `addresses` the two fields of J1939 follow its signals.
    pub fn new(message: &Message, addresses: bool) -> Self {
        let mut labelled: Vec<bool> = message.signals.iter().map(is_labelled).collect();
        if addresses {
            labelled.extend([false, false]);
        }
        let numbers = numbers(&labelled);
        let steps = message.signals.iter().zip(&numbers);
        let steps: Box<[Step]> =
            steps.map(|(signal, numbers)| Step::of(signal, *numbers)).collect();
        let longest = LONGEST_FIELD * (numbers.len() + labelled.iter().filter(|l| **l).count() + 2);
        let address = |index: usize| numbers.get(index).map(|(n, _)| Tag::of(*n, wire::VARINT));
        let count = message.signals.len();
        let addresses = if addresses { address(count).zip(address(count + 1)) } else { None };
        Self { steps, addresses: addresses.map(|(from, to)| [from, to]), longest }
    }

    /// Appends the message that `frame` carries.
    #[inline]
    pub fn encode(&self, found: &Match<'_>, frame: &CanFrame, out: &mut Vec<u8>) {
        let start = out.len();
        out.resize(start + self.longest, 0);
        let mut put = Put { out: &mut out[start..], at: 0 };
        found.decode(frame, |reading| {
            if let Some(step) = self.steps.get(reading.signal) {
                step.put(&reading, &mut put);
            }
        });
        if let (Some(tags), Some(id)) = (&self.addresses, found.j1939) {
            put_addresses(tags, id, &mut put);
        }
        let end = start + put.at;
        out.truncate(end);
    }
}

fn put_addresses(tags: &[Tag; 2], id: Identifier, put: &mut Put<'_>) {
    put.tag(tags[0]);
    put.varint(id.source.into());
    if let Some(destination) = id.destination {
        put.tag(tags[1]);
        put.varint(destination.into());
    }
}

impl Step {
    fn of(signal: &Signal, (number, label): (u32, Option<u32>)) -> Self {
        let (_, form) = kind_of(signal);
        let wire_type = match form {
            Form::Varint | Form::Zigzag | Form::Whole { .. } => wire::VARINT,
            Form::Float => wire::FIXED32,
            Form::Double => wire::FIXED64,
        };
        let key = match signal.number {
            Number::Unsigned => Key::Unsigned,
            Number::Signed => Key::Signed(unused(signal)),
            Number::Float32 => Key::Float32,
            Number::Float64 => Key::Float64,
        };
        let label = label.map(|number| {
            let known = signal.labels.iter().flat_map(|labels| labels.iter());
            let known = Known::of(known.map(|(value, _)| *value));
            Box::new(Label { tag: Tag::of(number, wire::VARINT), known, key })
        });
        Self { tag: Tag::of(number, wire_type), form, label }
    }

    #[inline]
    fn put(&self, reading: &Reading, put: &mut Put<'_>) {
        put.tag(self.tag);
        match (self.form, reading.value) {
            (Form::Varint, _) => put.varint(reading.raw),
            (Form::Zigzag, Value::Signed(number)) => put.varint(zigzag(number)),
            (Form::Zigzag, _) => put.varint(zigzag(reading.raw as i64)),
            (Form::Whole { factor, offset, unused, zigzag: signed }, _) => {
                let raw = reading.raw as i64;
                let raw = unused.map_or(raw, |unused| extend(raw, unused));
                // Modulo 2^64, and the result fits (see `whole`).
                let number = raw.wrapping_mul(factor).wrapping_add(offset);
                put.varint(if signed { zigzag(number) } else { number as u64 });
            }
            // The bits as they were in the frame, so that a NaN stays the NaN it is.
            #[allow(clippy::cast_possible_truncation, reason = "32 bits")]
            (Form::Float, _) => put.fixed((reading.raw as u32).to_le_bytes()),
            (Form::Double, Value::Float(number)) => put.fixed(number.to_bits().to_le_bytes()),
            (Form::Double, Value::Unsigned(number)) => {
                put.fixed((number as f64).to_bits().to_le_bytes());
            }
            (Form::Double, Value::Signed(number)) => {
                put.fixed((number as f64).to_bits().to_le_bytes());
            }
        }
        if let Some(label) = &self.label {
            label.put(reading.raw, put);
        }
    }
}

impl Label {
    #[inline]
    fn put(&self, raw: u64, put: &mut Put<'_>) {
        let number = match self.key {
            Key::Unsigned => i64::try_from(raw).ok(),
            Key::Signed(unused) => Some(extend(raw as i64, unused)),
            #[allow(clippy::cast_possible_truncation, reason = "32 bits")]
            Key::Float32 => whole_number(f32::from_bits(raw as u32).into()),
            Key::Float64 => whole_number(f64::from_bits(raw)),
        };
        if let Some(number) = number.filter(|number| self.known.has(*number)) {
            put.tag(self.tag);
            put.varint(number as u64);
        }
    }
}

/// The integer that a number is, as far as every integer is a double.
#[allow(clippy::cast_possible_truncation, reason = "the range is checked")]
pub fn whole_number(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < EXACT).then_some(value as i64)
}

/// Up to here every integer is a double.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// True when the signal's field has a twin: some of its values have a text.
pub fn is_labelled(signal: &Signal) -> bool {
    signal.labels.as_ref().is_some_and(|labels| !labels.is_empty())
}

/// The type of a signal's field: integers where every value is one and fits, else floats.
pub fn kind(signal: &Signal) -> Kind {
    kind_of(signal).0
}

fn kind_of(signal: &Signal) -> (Kind, Form) {
    let scaled = signal.factor != 1.0 || signal.offset != 0.0;
    match signal.number {
        Number::Float32 if !scaled => (Kind::Float, Form::Float),
        Number::Float32 | Number::Float64 => (Kind::Double, Form::Double),
        Number::Unsigned if !scaled && signal.length <= 32 => (Kind::Uint32, Form::Varint),
        Number::Unsigned if !scaled => (Kind::Uint64, Form::Varint),
        Number::Signed if !scaled && signal.length <= 32 => (Kind::Sint32, Form::Zigzag),
        Number::Signed if !scaled => (Kind::Sint64, Form::Zigzag),
        Number::Unsigned | Number::Signed => whole(signal).unwrap_or((Kind::Double, Form::Double)),
    }
}

/// A scaled signal whose values are integers.
fn whole(signal: &Signal) -> Option<(Kind, Form)> {
    let (factor, offset) = (whole_number(signal.factor)?, whole_number(signal.offset)?);
    let signed = signal.number == Number::Signed;
    let span = 1_i128 << (signal.length - u16::from(signed));
    let ends = if signed { [-span, span - 1] } else { [0, span - 1] };
    let [a, b] = ends.map(|raw| raw * i128::from(factor) + i128::from(offset));
    let kind = integer_kind(a.min(b), a.max(b))?;
    let zigzag = matches!(kind, Kind::Sint32 | Kind::Sint64);
    let unused = signed.then(|| unused(signal));
    Some((kind, Form::Whole { factor, offset, unused, zigzag }))
}

/// The smallest type that holds all from `least` to `largest`.
pub fn integer_kind(least: i128, largest: i128) -> Option<Kind> {
    if least >= 0 {
        return match largest {
            0..=0xFFFF_FFFF => Some(Kind::Uint32),
            _ => u64::try_from(largest).ok().map(|_| Kind::Uint64),
        };
    }
    let small = i32::try_from(least).is_ok() && i32::try_from(largest).is_ok();
    let fits = i64::try_from(least).is_ok() && i64::try_from(largest).is_ok();
    fits.then_some(if small { Kind::Sint32 } else { Kind::Sint64 })
}

#[allow(clippy::cast_possible_truncation, reason = "1 to 64 bits")]
fn unused(signal: &Signal) -> u8 {
    (64 - signal.length) as u8
}

#[inline]
fn extend(raw: i64, unused: u8) -> i64 {
    raw << (unused & 63) >> (unused & 63)
}

/// Numbers with a sign as the wire has them: small ones stay short.
#[inline]
pub(super) fn zigzag(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)) as u64
}

impl Tag {
    fn of(field: u32, wire_type: u32) -> Self {
        let mut bytes = Vec::with_capacity(4);
        wire::put_varint(&mut bytes, u64::from(field << 3 | wire_type));
        let mut tag = Self { bytes: [0; 4], length: 0 };
        for (place, byte) in tag.bytes.iter_mut().zip(&bytes) {
            *place = *byte;
            tag.length += 1;
        }
        tag
    }
}

/// Bytes being filled, with room for the longest message.
struct Put<'a> {
    out: &'a mut [u8],
    at: usize,
}

impl Put<'_> {
    #[inline]
    fn tag(&mut self, tag: Tag) {
        self.out[self.at..self.at + 4].copy_from_slice(&tag.bytes);
        self.at += usize::from(tag.length);
    }

    #[inline]
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.out[self.at] = value.to_le_bytes()[0] | 0x80;
            self.at += 1;
            value >>= 7;
        }
        self.out[self.at] = value.to_le_bytes()[0];
        self.at += 1;
    }

    #[inline]
    fn fixed<const N: usize>(&mut self, bytes: [u8; N]) {
        self.out[self.at..self.at + N].copy_from_slice(&bytes);
        self.at += N;
    }
}
