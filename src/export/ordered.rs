//! Rows in the order of their times, where they come a little out of it.
//!
//! A message of several frames is known when its last frame has come, one that stays incomplete
//! later yet, and meanwhile there were rows of other messages.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;

use super::TableWriter;
use super::catalogue::Catalogue;
use crate::frame::Timestamp;

/// So many rows wait for earlier ones at most.
const MOST_ROWS: usize = 16_384;
/// And so many bytes of them.
const MOST_BYTES: usize = 4 << 20;

/// Passes rows on in the order of their times. Those that come later than the room for waiting
/// rows allows are passed on at once.
pub struct Ordered<W> {
    writer: W,
    waiting: BinaryHeap<Reverse<Waiting>>,
    bytes: usize,
    count: u64,
}

/// Ordered by its first fields: rows of the same time stay as they came.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Waiting {
    time: Timestamp,
    number: u64,
    table: u32,
    payload: Box<[u8]>,
}

impl<W: TableWriter> Ordered<W> {
    /// For `writer`.
    pub fn new(writer: W) -> Self {
        Self { writer, waiting: BinaryHeap::new(), bytes: 0, count: 0 }
    }

    /// Passes rows on until `rows` and `bytes` are left.
    fn pass(&mut self, catalogue: &Catalogue, rows: usize, bytes: usize) -> io::Result<()> {
        while self.waiting.len() > rows || self.bytes > bytes {
            let Some(Reverse(next)) = self.waiting.pop() else { break };
            self.bytes -= next.payload.len();
            self.writer.write(catalogue, next.table, next.time, &next.payload)?;
        }
        Ok(())
    }
}

impl<W: TableWriter> TableWriter for Ordered<W> {
    fn write(
        &mut self,
        catalogue: &Catalogue,
        table: u32,
        time: Timestamp,
        payload: &[u8],
    ) -> io::Result<()> {
        self.count += 1;
        self.bytes += payload.len();
        let (number, payload) = (self.count, payload.into());
        self.waiting.push(Reverse(Waiting { time, number, table, payload }));
        self.pass(catalogue, MOST_ROWS, MOST_BYTES)
    }

    fn finish(&mut self, catalogue: &Catalogue) -> io::Result<()> {
        self.pass(catalogue, 0, 0)?;
        self.writer.finish(catalogue)
    }

    fn files(&self) -> u64 {
        self.writer.files()
    }

    fn notes(&self) -> Vec<String> {
        self.writer.notes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Seen(Vec<(u64, u8)>);

    impl TableWriter for Seen {
        fn write(&mut self, _: &Catalogue, _: u32, at: Timestamp, data: &[u8]) -> io::Result<()> {
            self.0.push((at.nanos(), data[0]));
            Ok(())
        }

        fn finish(&mut self, _: &Catalogue) -> io::Result<()> {
            Ok(())
        }

        fn files(&self) -> u64 {
            0
        }
    }

    #[test]
    fn rows_leave_by_time_and_those_of_one_time_as_they_came() {
        let catalogue = Catalogue::new(Box::new(|_| true));
        let mut ordered = Ordered::new(Seen::default());
        for (time, mark) in [(3, 0), (1, 1), (2, 2), (1, 3), (3, 4)] {
            ordered.write(&catalogue, 0, Timestamp(time), &[mark]).unwrap();
        }
        ordered.finish(&catalogue).unwrap();
        assert_eq!(ordered.writer.0, [(1, 1), (1, 3), (2, 2), (3, 0), (3, 4)]);
    }

    #[test]
    fn the_room_for_waiting_rows_is_bounded() {
        let catalogue = Catalogue::new(Box::new(|_| true));
        let mut ordered = Ordered::new(Seen::default());
        let row = vec![0; 1 << 20];
        for number in 0..100_u64 {
            ordered.write(&catalogue, 0, Timestamp(100 - number), &row).unwrap();
            assert!(ordered.bytes <= MOST_BYTES, "{}", ordered.bytes);
        }
        assert_eq!(ordered.writer.0.len(), 96);
    }
}
