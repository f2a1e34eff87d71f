//! The recorder: from the queue to the file.
//!
//! The [`Recorder`], a plain thread, takes from the [`Queue`](crate::queue::Queue) and writes. It
//! names, splits and finishes files, keeps the disk in its bounds, and closes the books.

mod alarm;
mod bus;
pub mod leftovers;
mod progress;
mod recorder;
mod retention;
mod segments;

pub use bus::{RecordedBus, summary};
pub use progress::{Progress, State};
pub use recorder::{Outcome, Pace, Recorder};
pub use retention::{Limits, Open, Retention, Room, WhenFull, keep_mark};
pub use segments::{Align, LEAST_FREE, Segment, SegmentError, Segments, Split, Target};
