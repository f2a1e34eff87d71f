//! Promises of the definition language and the decoder, as a whole.

mod decoding;
mod definitions;
mod vectors;
