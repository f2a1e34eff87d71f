//! Where the bits of a signal are: compiled once to a load, a shift and a mask.

use crate::decode::dbc::{ByteOrder, Number, Signal};
use crate::frame::CAN_MAX_DATA;

/// A payload followed by zeros, so that 16 bytes can be loaded from every byte of it.
pub struct Payload {
    bytes: [u8; CAN_MAX_DATA + 16],
    len: u8,
}

impl Payload {
    /// Up to 64 bytes of a frame.
    #[inline]
    pub fn new(data: &[u8]) -> Self {
        let len = data.len().min(CAN_MAX_DATA);
        let mut bytes = [0; CAN_MAX_DATA + 16];
        bytes[..len].copy_from_slice(&data[..len]);
        #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
        Self { bytes, len: len as u8 }
    }

    #[inline]
    fn load<const N: usize>(&self, at: u8) -> [u8; N] {
        let at = usize::from(at) & (CAN_MAX_DATA - 1);
        let mut out = [0; N];
        out.copy_from_slice(&self.bytes[at..at + N]);
        out
    }
}

/// Takes the raw bits of one signal out of a payload.
#[derive(Clone, Copy, Debug)]
pub struct Bits {
    mask: u64,
    byte: u8,
    /// Bits to the right of the signal in the loaded word.
    shift: u8,
    /// Bytes the frame must have.
    needs: u8,
    motorola: bool,
    /// The signal lies in nine bytes.
    wide: bool,
}

impl Bits {
    /// Those of `signal`.
    #[allow(clippy::cast_possible_truncation, reason = "a signal ends within 64 bytes")]
    pub fn of(signal: &Signal) -> Self {
        let (start, length) = (signal.start, signal.length);
        let motorola = signal.order == ByteOrder::Motorola;
        // Bits in front of the signal in its first byte, in the order of counting.
        let before = if motorola { 7 - start % 8 } else { start % 8 };
        let wide = before + length > 64;
        let word = if wide { 128 } else { 64 };
        Self {
            mask: u64::MAX >> (64 - length),
            byte: (start / 8) as u8,
            shift: if motorola { word - before - length } else { before } as u8,
            needs: signal.bytes() as u8,
            motorola,
            wide,
        }
    }

    /// The bits, if all of them are in the frame.
    #[inline]
    pub fn take(&self, payload: &Payload) -> Option<u64> {
        if payload.len < self.needs {
            return None;
        }
        Some(if self.wide { self.take_wide(payload) } else { self.take_word(payload) })
    }

    #[inline]
    fn take_word(&self, payload: &Payload) -> u64 {
        let loaded = payload.load(self.byte);
        let word =
            if self.motorola { u64::from_be_bytes(loaded) } else { u64::from_le_bytes(loaded) };
        (word >> (self.shift & 63)) & self.mask
    }

    #[cold]
    fn take_wide(&self, payload: &Payload) -> u64 {
        let loaded = payload.load(self.byte);
        let word =
            if self.motorola { u128::from_be_bytes(loaded) } else { u128::from_le_bytes(loaded) };
        #[allow(clippy::cast_possible_truncation, reason = "the mask takes the lower half")]
        let low = (word >> (self.shift & 127)) as u64;
        low & self.mask
    }
}

/// What a signal says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Without sign, not scaled.
    Unsigned(u64),
    /// With sign, not scaled.
    Signed(i64),
    /// A float, or scaled: raw × factor + offset.
    Float(f64),
}

/// Makes values of raw bits.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    factor: f64,
    offset: f64,
    number: Number,
    /// Bits above the sign.
    unused: u8,
    scaled: bool,
}

impl Scale {
    /// That of `signal`.
    #[allow(clippy::cast_possible_truncation, reason = "1 to 64 bits")]
    pub fn of(signal: &Signal) -> Self {
        Self {
            factor: signal.factor,
            offset: signal.offset,
            number: signal.number,
            unused: (64 - signal.length) as u8,
            scaled: signal.factor != 1.0 || signal.offset != 0.0,
        }
    }

    /// The value of `raw`.
    #[inline]
    pub fn value(&self, raw: u64) -> Value {
        match self.number {
            Number::Unsigned if self.scaled => self.scale(raw as f64),
            Number::Unsigned => Value::Unsigned(raw),
            Number::Signed => {
                let signed = ((raw << (self.unused & 63)) as i64) >> (self.unused & 63);
                if self.scaled { self.scale(signed as f64) } else { Value::Signed(signed) }
            }
            #[allow(clippy::cast_possible_truncation, reason = "32 bits were taken")]
            Number::Float32 => self.scale(f64::from(f32::from_bits(raw as u32))),
            Number::Float64 => self.scale(f64::from_bits(raw)),
        }
    }

    #[inline]
    fn scale(&self, number: f64) -> Value {
        // Not × 1 + 0 for all: that would make 0 of -0.
        Value::Float(if self.scaled { number * self.factor + self.offset } else { number })
    }
}
