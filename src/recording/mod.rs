//! The recording: what stands in an MCAP file, and how it gets there and back.

pub mod can_batch;
pub mod can_frame;
pub mod chunk;
pub mod container;
pub mod definition;
pub mod disk;
pub mod event;
pub mod limits;
pub mod message;
pub mod reader;
pub mod records;
pub mod rewrite;
pub mod schema;
pub mod segment;
pub mod shift;
pub mod unpack;
pub mod walk;
pub mod wire;
pub mod writer;
