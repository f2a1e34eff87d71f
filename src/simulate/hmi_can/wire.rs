//! The wire: one frame at a time, the lower identifier first.

use crate::frame::CanFrame;

use super::BIT_RATE;

const NANOS_PER_BIT: u64 = 1_000_000_000 / BIT_RATE as u64;

/// Who sends a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sender {
    /// The control controller.
    Controller,
    /// The HMI controller.
    Hmi,
}

/// Frames that wait for the wire.
#[derive(Clone, Debug, Default)]
pub struct Wire {
    waiting: Vec<(u64, Sender, CanFrame)>,
    /// The wire is busy until here, ns.
    busy: u64,
}

impl Wire {
    /// `frame` is ready to be sent at `time`, ns.
    pub fn put(&mut self, time: u64, sender: Sender, frame: CanFrame) {
        self.waiting.push((time, sender, frame));
    }

    /// The next frame whose transmission begins before `limit` (ns), and when it ends. What other
    /// nodes will put until then cannot come before it.
    pub fn take_before(&mut self, limit: u64) -> Option<(u64, Sender, CanFrame)> {
        let earliest = self.waiting.iter().map(|(time, ..)| *time).min()?;
        let start = earliest.max(self.busy);
        if start >= limit {
            return None;
        }
        // Everybody who is ready takes part in the arbitration; equal identifiers keep their order.
        let ready = self.waiting.iter().enumerate().filter(|(_, (time, ..))| *time <= start);
        let (index, _) = ready.min_by_key(|(_, (_, _, frame))| frame.id)?;
        let (_, sender, frame) = self.waiting.remove(index);
        self.busy = start + bits(&frame) * NANOS_PER_BIT;
        Some((self.busy, sender, frame))
    }
}

/// Bits of an extended classic frame on the wire with the gap behind it and about as many stuff
/// bits as such data need.
pub fn bits(frame: &CanFrame) -> u64 {
    let data = frame.data().len() as u64 * 8;
    67 + data + (54 + data) / 12
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::CanFlags;

    fn frame(id: u32) -> CanFrame {
        CanFrame::new(id, CanFlags::EXTENDED, &[0; 8])
    }

    #[test]
    fn the_lower_identifier_wins_and_no_two_frames_overlap() {
        let mut wire = Wire::default();
        for (time, id) in [(0, 9), (10, 7), (20, 3), (5_000_000, 1)] {
            wire.put(time, Sender::Hmi, frame(id));
        }
        let mut sent = Vec::new();
        while let Some((time, _, frame)) = wire.take_before(6_000_000) {
            sent.push((time, frame.id));
        }
        let length = bits(&frame(0)) * NANOS_PER_BIT;
        assert_eq!(sent, [(length, 9), (2 * length, 3), (3 * length, 7), (5_000_000 + length, 1)]);
    }
}
