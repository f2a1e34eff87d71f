//! One target and what waits for it, in order. A target that takes nothing holds up only its own
//! lane, until that is full.

use std::collections::VecDeque;
use std::time::Duration;

use nix::poll::PollFlags;

use super::ReplayError;
use super::feed::Item;
use super::sink::{Blocked, Due, Sink, Took};
use super::tally::{NotSent, Tally, Waits};
use super::verify::{Verdict, Witness};
use crate::frame::{Frame, SerialBytes};
use crate::sys::timing::steady_nanos;

/// Most that may wait for one target.
const MOST: usize = 4096;

/// A serial line that is given bytes at the speed at which it could carry them.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// What one byte takes, nanoseconds.
    pub byte: u64,
}

/// Parts of a piece are at least so long, nanoseconds, so that a fast line costs no more wake-ups.
const PART: u64 = 1_000_000;

/// One target.
pub struct Lane {
    /// As it was written on the command line.
    pub target: String,
    /// How often and how long it made others wait.
    pub waits: Waits,
    sink: Box<dyn Sink>,
    queue: VecDeque<Due>,
    pace: Option<Pace>,
    witness: Option<Witness>,
    /// When a paced line is free again, on the steady clock.
    free: u64,
    blocked: Option<Blocked>,
    /// When it took something last, on the steady clock.
    since: u64,
    /// When it was asked last, on the steady clock.
    asked: u64,
}

impl Lane {
    /// A lane to `sink`.
    pub fn new(target: String, sink: Box<dyn Sink>, pace: Option<Pace>) -> Self {
        let (queue, waits) = (VecDeque::with_capacity(64), Waits::default());
        let witness = None;
        Self {
            target,
            waits,
            sink,
            queue,
            pace,
            witness,
            free: 0,
            blocked: None,
            since: 0,
            asked: 0,
        }
    }

    /// Has somebody else listen to the target and compare.
    pub fn watch(&mut self, witness: Witness) {
        self.witness = Some(witness);
    }

    /// What was found by comparing, after the last frame.
    pub fn verdict(&mut self) -> Option<Verdict> {
        self.witness.take().map(Witness::finish)
    }

    /// True if no more may be given to it now.
    pub fn is_full(&self) -> bool {
        self.queue.len() >= MOST
    }

    /// True if nothing waits.
    pub fn is_empty(&self) -> bool {
        self.queue.is_empty()
    }

    /// True while the target takes nothing.
    pub fn is_blocked(&self) -> bool {
        self.blocked.is_some()
    }

    /// True if it takes a frame only when another node on the bus acknowledges it.
    pub fn waits_for_nodes(&self) -> bool {
        self.sink.is_can()
    }

    /// The target.
    pub fn sink(&mut self) -> &mut dyn Sink {
        &mut *self.sink
    }

    /// The target, to be waited for.
    pub fn waiting(&self) -> (&dyn Sink, PollFlags) {
        let mut events = PollFlags::empty();
        events.set(PollFlags::POLLIN, self.sink.listens());
        events.set(PollFlags::POLLOUT, self.blocked == Some(Blocked::Writable));
        (&*self.sink, events)
    }

    /// Adds something that is due at `at` on the steady clock. The queue stays in the order of its
    /// moments, although answers come with theirs in any order: frames go out when they are due,
    /// bytes of a line never before those that were said earlier.
    pub fn push(&mut self, at: u64, item: Item) {
        if let Frame::Serial(_) = &item.frame {
            let at = at.max(self.queue.back().map_or(0, |due| due.at));
            return match self.pace {
                Some(pace) => self.push_paced(pace, at, item),
                None => self.queue.push_back(Due { at, item, last: true }),
            };
        }
        let place = self.queue.partition_point(|due| due.at <= at);
        // A target that takes nothing now may have a part of the first one.
        let place = place.max(usize::from(self.is_blocked())).min(self.queue.len());
        self.queue.insert(place, Due { at, item, last: true });
    }

    fn push_paced(&mut self, pace: Pace, at: u64, item: Item) {
        let Item { media, time, bus, frame: Frame::Serial(bytes) } = item else { return };
        let part = usize::try_from(PART / pace.byte.max(1)).unwrap_or(1).max(1);
        let parts = bytes.data.len().div_ceil(part);
        let mut at = at.max(self.free);
        for (number, data) in bytes.data.chunks(part).enumerate() {
            let piece =
                SerialBytes { direction: bytes.direction, data: data.to_vec(), errors: Vec::new() };
            let item = Item { media, time, bus, frame: Frame::Serial(piece) };
            self.queue.push_back(Due { at, item, last: number + 1 == parts });
            at += pace.byte * data.len() as u64;
        }
        self.free = at;
    }

    /// Something came back from the target: whatever it waits for may be over.
    pub fn wake(&mut self) {
        if let Some(Blocked::For(time)) = &mut self.blocked {
            *time = Duration::ZERO;
        }
    }

    /// When it has to be looked at again, on the steady clock.
    pub fn next_look(&self) -> Option<u64> {
        match self.blocked {
            Some(Blocked::Writable) => None,
            Some(Blocked::For(time)) => {
                Some(self.asked + u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
            }
            None => self.queue.front().map(|due| due.at),
        }
    }

    /// Since when the target has taken nothing, on the steady clock, if it is so.
    pub fn stuck_since(&self) -> Option<u64> {
        self.blocked.map(|_| self.since)
    }

    /// Hands over what is due at `now`, as far as the target takes it. With `measure`, how late
    /// each was goes into the books.
    pub fn flush(
        &mut self,
        now: u64,
        measure: bool,
        tallies: &mut [Tally],
    ) -> Result<(), ReplayError> {
        if let Some(Blocked::For(_)) = self.blocked
            && self.next_look().is_some_and(|look| now < look)
        {
            return Ok(());
        }
        loop {
            let front = self.queue.as_slices().0;
            let due = front.partition_point(|due| due.at <= now);
            if due == 0 {
                return Ok(());
            }
            let took = self.sink.send(&front[..due])?;
            let after = steady_nanos();
            self.account(took, measure.then_some(after), tallies);
            self.note_block(took, after);
            if self.blocked.is_some() {
                return Ok(());
            }
        }
    }

    /// Takes what is done with off the queue.
    fn account(&mut self, took: Took, measured: Option<u64>, tallies: &mut [Tally]) {
        for Due { at, item, last } in self.queue.drain(..took.count) {
            let Some(tally) = tallies.get_mut(item.bus) else { continue };
            if let Some(why) = took.omitted {
                tally.omitted.add(why, u64::from(last));
                continue;
            }
            tally.sent += u64::from(last);
            tally.bytes += match &item.frame {
                Frame::Can(frame) => frame.data().len() as u64,
                Frame::Serial(bytes) => bytes.data.len() as u64,
                Frame::Gap(_) | Frame::Notice(_) => 0,
            };
            if let Some(witness) = &self.witness {
                witness.note(measured.map(|_| at), item.frame.clone());
            }
            if let Some(now) = measured {
                tally.lateness.add(now.saturating_sub(at));
            }
        }
    }

    /// Keeps count of waiting.
    fn note_block(&mut self, took: Took, now: u64) {
        if self.blocked.is_some() {
            self.waits.nanos += now.saturating_sub(self.asked);
        }
        self.asked = now;
        if took.count > 0 || took.blocked.is_none() || self.blocked.is_none() {
            self.since = now;
        }
        let newly = self.blocked.is_none() || took.count > 0;
        self.waits.count += u64::from(took.blocked.is_some() && newly);
        self.blocked = took.blocked;
    }

    /// Gives up what still waits.
    pub fn abandon(&mut self, tallies: &mut [Tally]) {
        for due in self.queue.drain(..).filter(|due| due.last) {
            if let Some(tally) = tallies.get_mut(due.item.bus) {
                tally.omitted.add(NotSent::Unfinished, 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::os::fd::BorrowedFd;
    use std::rc::Rc;

    use super::*;
    use crate::frame::{CanFlags, CanFrame, Direction, Timestamp};

    /// Takes everything at once.
    struct Taker(Rc<RefCell<Vec<Frame>>>);

    impl Sink for Taker {
        fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
            self.0.borrow_mut().extend(front.iter().map(|due| due.item.frame.clone()));
            Ok(Took::sent(front.len()))
        }

        fn descriptor(&self) -> Option<BorrowedFd<'_>> {
            None
        }
    }

    fn can(id: u32) -> Frame {
        Frame::Can(CanFrame::new(id, CanFlags::default(), &[]))
    }

    fn piece(byte: u8) -> Frame {
        let (direction, data) = (Direction::Rx, vec![byte]);
        Frame::Serial(SerialBytes { direction, data, errors: Vec::new() })
    }

    /// What has come out at `now` of what was pushed with the moments in front.
    fn out(pushed: &[(u64, Frame)], now: u64) -> Vec<Frame> {
        let taken = Rc::default();
        let mut lane = Lane::new("x".to_owned(), Box::new(Taker(Rc::clone(&taken))), None);
        for (at, frame) in pushed {
            let (time, frame) = (Timestamp(0), frame.clone());
            lane.push(*at, Item { media: 0, time, bus: 0, frame });
        }
        lane.flush(now, true, &mut [Tally::default()]).unwrap();
        taken.take()
    }

    #[test]
    fn frames_go_out_at_their_moments_whatever_waits_before_them() {
        let frames = [(300, can(3)), (100, can(1)), (100, can(2)), (200, can(9))];
        assert_eq!(out(&frames, 99), []);
        assert_eq!(out(&frames, 150), [can(1), can(2)]);
        assert_eq!(out(&frames, 300), [can(1), can(2), can(9), can(3)]);
    }

    #[test]
    fn bytes_keep_their_order_and_wait_for_those_before_them() {
        let pieces = [(300, piece(1)), (100, piece(2)), (400, piece(3))];
        assert_eq!(out(&pieces, 150), []);
        assert_eq!(out(&pieces, 300), [piece(1), piece(2)]);
    }
}
