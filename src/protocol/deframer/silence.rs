//! Frames with nothing but quiet between them.

use super::super::framing::Layout;
use super::{Cut, Take};
use crate::frame::Timestamp;

#[derive(Debug, Default)]
pub struct Silence {
    bytes: Vec<u8>,
    begun: Timestamp,
    last: Timestamp,
    dropped: u64,
}

impl Silence {
    /// Only the times of the pieces are known, so the quiet is the time between two of them.
    pub fn feed(
        &mut self,
        gap: u64,
        layout: &Layout,
        time: Timestamp,
        bytes: &[u8],
        take: &mut Take<'_>,
    ) {
        self.pass(gap, layout, time, take);
        if self.bytes.is_empty() && self.dropped == 0 {
            self.begun = time;
        }
        self.last = time;
        let room = layout.max.saturating_sub(self.bytes.len());
        let (kept, over) = bytes.split_at(room.min(bytes.len()));
        self.bytes.extend_from_slice(kept);
        self.dropped += over.len() as u64;
    }

    pub fn pass(&mut self, gap: u64, layout: &Layout, time: Timestamp, take: &mut Take<'_>) {
        if time.since(self.last) >= gap {
            self.close(layout, take);
        }
    }

    pub fn close(&mut self, layout: &Layout, take: &mut Take<'_>) {
        let frame = std::mem::take(&mut self.bytes);
        let dropped = std::mem::take(&mut self.dropped);
        if dropped > 0 {
            take(self.begun, Cut::TooLong { bytes: dropped + frame.len() as u64 });
        } else if !frame.is_empty() {
            take(self.begun, layout.close(frame));
        }
    }
}
