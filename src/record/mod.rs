//! The recorder: from sources to the file, never letting one wait for the other.

mod queue;
mod tally;

pub use queue::{Allowance, BusIndex, Inlet, Item, Queue, weight};
pub use tally::{REASONS, Tally, Totals, unit_name};
