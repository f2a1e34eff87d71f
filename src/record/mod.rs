//! The recorder: from sources to the file, never letting one wait for the other.
//!
//! Sources push through [`Inlet`]s into one [`Queue`] that is bounded by bytes; the [`Recorder`],
//! a plain thread, takes from it and writes. Each bus has its [`Tally`], and at the end of every
//! recording received = written + dropped.

mod alarm;
mod bus;
mod decoders;
mod entry;
mod inlet;
pub mod leftovers;
mod pace;
mod progress;
mod queue;
mod recorder;
mod retention;
mod segments;
mod session;
mod tally;
mod tape;
mod windows;
mod wire;

pub use bus::{Account, RecordedBus, summary};
pub use inlet::{Allowance, Inlet};
pub use pace::Pace;
pub use progress::{Progress, State};
pub use queue::{BusIndex, Item, Queue, weight};
pub use recorder::{Outcome, Recorder};
pub use retention::{Limits, Open, Retention, Room, WhenFull, keep_mark};
pub use segments::{Align, LEAST_FREE, Segment, SegmentError, Segments, Split, Target, WINDOWS};
pub use session::Session;
pub use tally::{Controller, REASONS, Tally, Totals, reason_name, unit_name};
pub use tape::Tape;
pub use windows::{Keeping, Windows};
