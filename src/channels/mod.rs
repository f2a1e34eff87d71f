//! Decoded channels: what frames mean, as messages of a recording that every viewer plots.
//!
//! A definition (a DBC database, a serial protocol) becomes one protobuf schema for each message,
//! generated when the first such message is written. Encoding is compiled when the definition is
//! loaded; for CAN it allocates nothing. `docs/file-format.md` tells what the messages look like.

mod assembly;
mod can;
mod definition;
mod encoder;
mod fields;
mod labels;
mod names;
mod schema;
mod sentences;
mod serial;
mod serial_shapes;
mod shape;
mod stream;

#[cfg(test)]
mod tests;

pub use definition::{Definition, Meaning};
pub use stream::{Counts, Sink, Stream};
