//! The recorder: from the queue to the file.
//!
//! The [`Recorder`], a plain thread, takes from the [`Queue`](crate::queue::Queue) and writes: to the
//! [`Tape`], which is the continuous recording, and to the [`Windows`] around triggers. It names,
//! splits and finishes files, keeps the disk in its bounds, and closes the books.

mod alarm;
mod bus;
mod decoders;
mod disk_thread;
mod entry;
pub mod leftovers;
mod pace;
mod progress;
mod recorder;
mod retention;
mod segments;
mod session;
mod tape;
mod windows;

pub use bus::{Account, RecordedBus, summary};
pub use pace::Pace;
pub use progress::{Progress, State};
pub use recorder::{Outcome, Recorder};
pub use retention::{Limits, Open, Retention, Room, WhenFull, keep_mark};
pub use segments::{Align, LEAST_FREE, Segment, SegmentError, Segments, Split, Target, WINDOWS};
pub use session::Session;
pub use tape::Tape;
pub use windows::{Keeping, Windows};
