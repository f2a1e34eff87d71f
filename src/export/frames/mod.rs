//! Frames in the formats of other tools.

pub mod asc;
pub mod blf;
pub mod candump;
pub mod candump_line;
pub mod channels;
pub mod csv;
pub mod hex;
pub mod hex_rows;
mod kept;
pub mod mf4;
pub mod pcapng;
pub mod raw;
mod text;
pub mod trc;

/// The DLC for data of this length: the smallest that has room.
fn fd_dlc(length: usize) -> u8 {
    match length {
        0..=8 => u8::try_from(length).unwrap_or(8),
        9..=12 => 9,
        13..=16 => 10,
        17..=20 => 11,
        21..=24 => 12,
        25..=32 => 13,
        33..=48 => 14,
        _ => 15,
    }
}
