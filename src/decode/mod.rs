//! From raw frames to signals with names and units.
//!
//! A DBC file is read into a [`dbc::Database`], whatever it looks like, and compiled once into a
//! [`can::CanDecoder`]; from then on decoding a frame allocates nothing and cannot fail.

pub mod can;
pub mod dbc;
pub mod j1939;
mod layout;
mod plan;
pub mod protocol;

#[cfg(test)]
mod tests;
