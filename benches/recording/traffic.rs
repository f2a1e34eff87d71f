//! Made-up traffic of a 500 kbit/s bus of a car's body and power train. The same every time.
//!
//! Sixty cyclic messages, every fourth with a 29-bit identifier, at about 3,000 frames/s: counters,
//! checksums, slow and noisy measured values, flags, constants. Neither noise nor a constant, for
//! both would make file sizes and compression times meaningless.

#![allow(clippy::cast_possible_truncation, reason = "counters and checksums wrap")]

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use bustape::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};

const MESSAGES: u32 = 60;
/// 2023-11-14T22:13:20Z, in microseconds.
const BEGIN: u64 = 1_700_000_000_000_000;
/// Cycle times in microseconds.
const CYCLES: [u64; 15] = [
    5_000, 10_000, 10_000, 10_000, 20_000, 20_000, 20_000, 20_000, 50_000, 50_000, 100_000,
    100_000, 200_000, 500_000, 1_000_000,
];
/// What the bytes of a message are, see [`Message::payload`].
const LAYOUTS: [&[u8; 8]; 8] = [
    b"WwWwWwnK",
    b"WwWwbFnK",
    b"bbWwFFnK",
    b"FFCCWwbb",
    b"WwWwWwWw",
    b"bbbbbbNK",
    b"nFWwbCCK",
    b"WwCCFFFN",
];

/// Frames in the order they pass on the bus, without end.
pub struct Traffic {
    messages: Vec<Message>,
    /// When each message is due next: time, place in `messages`, cycle.
    due: BinaryHeap<Reverse<(u64, usize, u64)>>,
    /// When the bus is free again.
    free: u64,
    random: Random,
}

impl Traffic {
    /// The traffic from its beginning.
    pub fn new() -> Self {
        let mut random = Random(0x5EED_0F1A_B0A7_CAFE);
        let messages: Vec<Message> = (0..MESSAGES).map(|i| Message::new(i, &mut random)).collect();
        let due = messages.iter().enumerate();
        let due = due.map(|(i, message)| Reverse((message.phase, i, 0))).collect();
        Self { messages, due, free: 0, random }
    }
}

impl Iterator for Traffic {
    type Item = Stamped<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        let Reverse((due, place, cycle)) = self.due.pop()?;
        let message = &mut self.messages[place];
        let late = self.random.below(60) + self.random.below(60);
        // A frame that is due while another passes waits for it.
        let time = self.free.max(due + late);
        self.free = time + if message.extended { 262 } else { 222 } + self.random.below(18);
        self.due.push(Reverse((message.phase + (cycle + 1) * message.cycle, place, cycle + 1)));
        let flags = if message.extended { CanFlags::EXTENDED } else { CanFlags::default() };
        let data = message.payload(cycle, &mut self.random);
        let frame = Frame::Can(CanFrame::new(message.id, flags, &data));
        Some(Stamped { time: Timestamp((BEGIN + time) * 1_000), value: frame })
    }
}

struct Message {
    id: u32,
    extended: bool,
    cycle: u64,
    phase: u64,
    layout: &'static [u8; 8],
    /// Noise of the measured values, in steps of the last bit.
    noise: u64,
    data: [u8; 8],
}

impl Message {
    fn new(number: u32, random: &mut Random) -> Self {
        let extended = number % 4 == 3;
        let id = if extended {
            0x1000_0000 + number * 0x10_0000 + random.bits(16)
        } else {
            0x40 + number * 30 + random.bits(4)
        };
        let cycle = CYCLES[(number * 7) as usize % CYCLES.len()];
        Self {
            id,
            extended,
            cycle,
            phase: random.below(cycle),
            layout: LAYOUTS[random.bits(3) as usize],
            noise: 1 << random.bits(3).min(6),
            data: random.next().to_le_bytes(),
        }
    }

    /// The data of the given cycle: each byte moves on from what it was before.
    fn payload(&mut self, cycle: u64, random: &mut Random) -> [u8; 8] {
        let mut place = 0;
        while place < 8 {
            match self.layout[place] {
                // A measured value of 16 bits: a slow wave and noise.
                b'W' => {
                    let value = self.wave(cycle, place) + random.below(self.noise);
                    self.data[place..place + 2].copy_from_slice(&(value as u16).to_le_bytes());
                    place += 1;
                }
                // One of 8 bits: it walks.
                b'b' if random.below(8) == 0 => {
                    let step = if random.below(2) == 0 { 1 } else { u8::MAX };
                    self.data[place] = self.data[place].wrapping_add(step);
                }
                // Flags: one turns over now and then.
                b'F' if random.below(250) == 0 => self.data[place] ^= 1 << random.below(8),
                // Counters of 4 bits, beside flags that rest, and of 8.
                b'n' => self.data[place] = (self.data[place] & 0xF0) | (cycle & 0x0F) as u8,
                b'N' => self.data[place] = cycle as u8,
                b'K' => self.data[place] = crc8(&self.data[..place]),
                // Constant, or nothing new.
                _ => {}
            }
            place += 1;
        }
        self.data
    }

    fn wave(&self, cycle: u64, place: usize) -> u64 {
        let period = 20.0 + f64::from(self.id % 40) + place as f64;
        let seconds = (self.phase + cycle * self.cycle) as f64 / 1e6;
        (32_768.0 + 20_000.0 * (seconds * std::f64::consts::TAU / period).sin()) as u64
    }
}

/// CRC-8 with the polynomial of SAE J1850, as many checksum bytes in cars have it.
fn crc8(bytes: &[u8]) -> u8 {
    let mut crc = 0xFF;
    for byte in bytes {
        crc ^= byte;
        for _ in 0..8 {
            crc = if crc & 0x80 != 0 { (crc << 1) ^ 0x1D } else { crc << 1 };
        }
    }
    !crc
}

/// xorshift64*: small, fast, and the same everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn bits(&mut self, count: u32) -> u32 {
        (self.next() >> (64 - count)) as u32
    }

    fn below(&mut self, end: u64) -> u64 {
        ((self.next() >> 32) * end) >> 32
    }
}
