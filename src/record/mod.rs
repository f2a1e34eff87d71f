//! The recorder: from sources to the file, never letting one wait for the other.
//!
//! Sources push through [`Inlet`]s into one [`Queue`] that is bounded by bytes; the [`Recorder`],
//! a plain thread, takes from it and writes. Each bus has its [`Tally`], and at the end of every
//! recording received = written + dropped.

mod alarm;
mod bus;
mod inlet;
pub mod leftovers;
mod progress;
mod queue;
mod recorder;
mod retention;
mod segments;
mod tally;
mod wire;

pub use bus::{RecordedBus, summary};
pub use inlet::{Allowance, Inlet};
pub use progress::{Progress, State};
pub use queue::{BusIndex, Item, Queue, weight};
pub use recorder::{Outcome, Pace, Recorder};
pub use retention::{Limits, Open, Retention, Room, WhenFull, keep_mark};
pub use segments::{Align, LEAST_FREE, Segment, SegmentError, Segments, Split, Target};
pub use tally::{REASONS, Tally, Totals, reason_name, unit_name};
