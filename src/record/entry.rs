//! What files of a recording hold, in the order it happened.

use std::io;

use crate::frame::error::CanError;
use crate::frame::{Frame, Notice, Timestamp};
use crate::queue::{Item, heap};
use crate::recording::event::Event;
use crate::recording::schema::bustape::{BusStats, ClockSync};
use crate::recording::writer::SegmentWriter;

/// Something for the files that are being written.
#[derive(Clone, Debug)]
pub enum Entry {
    /// Something that happened on a bus.
    Frame(Item),
    /// The state of bus number `bus`.
    Stats { bus: usize, time: Timestamp, stats: BusStats },
    /// Both clocks.
    Clock { time: Timestamp, sync: ClockSync },
    /// A sentence about the recorder itself.
    Notice { time: Timestamp, notice: Notice },
    /// A mark or a trigger.
    Event(Event),
}

impl Entry {
    /// Adds it to a file.
    pub fn write(&self, writer: &mut SegmentWriter) -> io::Result<()> {
        match self {
            Self::Frame(Item { bus, frame }) => {
                let bus = usize::from(*bus);
                writer.add(bus, frame)?;
                if let Frame::Can(can) = &frame.value
                    && let Some(error) = CanError::of(can)
                {
                    writer.add_error(bus, frame.time, &error)?;
                }
                Ok(())
            }
            Self::Stats { bus, time, stats } => writer.add_stats(*bus, *time, stats),
            Self::Clock { time, sync } => writer.add_clock(*time, sync),
            Self::Notice { time, notice } => writer.add_notice(*time, "bustape", notice),
            Self::Event(event) => writer.add_event(event),
        }
    }

    /// When it happened.
    pub fn time(&self) -> Timestamp {
        match self {
            Self::Frame(item) => item.frame.time,
            Self::Stats { time, .. } | Self::Clock { time, .. } | Self::Notice { time, .. } => {
                *time
            }
            Self::Event(event) => event.time,
        }
    }

    /// The same, at `first` if that is later.
    #[must_use]
    pub fn not_before(mut self, first: Timestamp) -> Self {
        match &mut self {
            Self::Frame(item) => item.frame.time = item.frame.time.max(first),
            Self::Stats { time, .. } | Self::Clock { time, .. } | Self::Notice { time, .. } => {
                *time = (*time).max(first);
            }
            // An event keeps the time that it is about.
            Self::Event(_) => {}
        }
        self
    }

    /// Bytes of memory that it takes.
    pub fn bytes(&self) -> usize {
        let more = match self {
            Self::Frame(item) => heap(&item.frame.value),
            Self::Notice { notice, .. } => notice.text.capacity(),
            Self::Event(event) => event.bytes(),
            Self::Stats { .. } | Self::Clock { .. } => 0,
        };
        size_of::<Self>() + more
    }
}
