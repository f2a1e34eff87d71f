//! From raw frames to signals with names and units.
//!
//! A DBC file is read into a [`dbc::Database`], whatever it looks like, and compiled once into a
//! [`can::CanDecoder`]; from then on decoding a frame allocates nothing and cannot fail. What a
//! DBC file cannot say stands in [`rules::Rules`] beside it; both together are a
//! [`definition::CanDefinition`], with which a [`bus::CanBus`] decodes the frames of a bus.

pub mod answers;
pub mod assembly;
pub mod bus;
pub mod can;
mod context;
pub mod dbc;
pub mod definition;
pub mod j1939;
mod layout;
mod plan;
pub mod protocol;
pub mod rules;

#[cfg(test)]
mod tests;
