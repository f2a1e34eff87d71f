//! Frames in the formats of other tools.

pub mod asc;
pub mod blf;
pub mod candump;
mod channels;
pub mod csv;
mod fitting;
pub mod hex;
pub mod kept;
mod lines;
pub mod mf4;
pub mod pcapng;
pub mod raw;
mod start;
mod text;
pub mod trc;
