//! What a format cannot keep, counted.

use std::collections::BTreeMap;

use crate::frame::Frame;

/// Frames before the first one, in a format whose times count from that.
pub const EARLIER: &str = "times before that of the first frame";
/// Frames of buses that `fitting.rs` had to give another name.
pub const NAMES: &str = "names of buses with blanks or other marks";

/// Counts what is lost on the way into a format.
#[derive(Debug, Default)]
pub struct Unkept(BTreeMap<&'static str, u64>);

impl Unkept {
    /// Counts one.
    pub fn add(&mut self, what: &'static str) {
        *self.0.entry(what).or_default() += 1;
    }

    /// Counts something of a kind the format has no place for.
    pub fn frame(&mut self, frame: &Frame) {
        match frame {
            Frame::Can(_) => self.add("CAN frames"),
            Frame::Serial(_) => self.add("serial frames"),
            Frame::Gap(_) => self.add("gaps"),
            Frame::Notice(_) => {}
        }
    }

    /// Counts a time that is finer than `unit` nanoseconds.
    pub fn time(&mut self, nanos: u64, unit: u64) {
        if !nanos.is_multiple_of(unit) {
            self.add(match unit {
                1000 => "nanoseconds",
                _ => "parts of milliseconds",
            });
        }
    }

    /// What, and how often.
    pub fn list(&self) -> &BTreeMap<&'static str, u64> {
        &self.0
    }
}
