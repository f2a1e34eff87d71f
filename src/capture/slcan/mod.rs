//! CAN adapters that speak the Lawicel ASCII protocol (slcan) over a serial port.
//!
//! Frames have the time of the read that returned them: what the adapter stamps is used only for
//! the distance of frames within one read. Nothing is ever transmitted on the bus.

mod address;
pub mod codec;
mod lines;
mod session;
mod set_up;
mod source;
mod spacing;

pub use address::SlcanAddress;
pub(crate) use lines::{Cut, Lines};
pub(crate) use set_up::set_up;
pub use source::Slcan;
