//! Frames in the formats of other tools.

pub mod blf;
pub mod channels;
