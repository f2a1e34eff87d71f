//! The recording: what stands in an MCAP file, and how it gets there and back.

mod bytes;
pub mod can_batch;
pub mod can_frame;
pub mod chunk;
pub mod container;
pub mod definition;
pub mod descriptor;
pub mod disk;
pub mod event;
pub mod limits;
pub mod message;
mod options;
pub mod reader;
mod ready;
pub mod records;
pub mod rewrite;
pub mod schema;
pub mod segment;
pub mod shift;
mod summary;
pub mod unpack;
pub mod walk;
pub mod wire;
pub mod writer;
