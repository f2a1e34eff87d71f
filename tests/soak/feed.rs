//! A serial line on which everything that is said is known, and when it was said.

use std::fs::File;
use std::io::Write as _;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Bytes of one record.
pub const RECORD: usize = 16;

/// What was said on a line.
#[derive(Default)]
pub struct Log {
    /// After each write: when, and how many bytes so far.
    pub writes: Vec<(Instant, usize)>,
    /// The longest that a pause of 2 ms has taken: how busy the machine was.
    pub held_up: Duration,
}

impl Log {
    /// Everything that was said.
    pub fn bytes(&self) -> Vec<u8> {
        let count = self.writes.last().map_or(0, |(_, total)| *total);
        (0..count.div_ceil(RECORD) as u64).flat_map(record).take(count).collect()
    }

    /// How long before `end` the oldest byte was said of those that are not among the first
    /// `kept`; zero if they all are.
    pub fn lost(&self, kept: usize, end: Instant) -> Duration {
        let missing = self.writes.iter().find(|(at, total)| *total > kept && *at <= end);
        missing.map_or(Duration::ZERO, |(at, _)| end - *at)
    }
}

/// Record number `number` of the line: its number in text.
pub fn record(number: u64) -> [u8; RECORD] {
    let mut bytes = *b"000000000000000\n";
    let text = number.to_string();
    bytes[RECORD - 1 - text.len()..RECORD - 1].copy_from_slice(text.as_bytes());
    bytes
}

/// Says about `rate` records a second until `stop`, or until nobody takes them any more.
pub fn talk(line: &mut File, rate: u64, stop: &AtomicBool) -> Log {
    let mut log = Log::default();
    let (mut number, start) = (0, Instant::now());
    while !stop.load(Relaxed) {
        let due = start.elapsed().as_micros() as u64 * rate / 1_000_000;
        let records: Vec<u8> = (number..due).flat_map(record).collect();
        if !records.is_empty() {
            if line.write_all(&records).is_err() {
                break;
            }
            number = due;
            log.writes.push((Instant::now(), number as usize * RECORD));
        }
        let before = Instant::now();
        std::thread::sleep(Duration::from_millis(2));
        log.held_up = log.held_up.max(before.elapsed().saturating_sub(Duration::from_millis(2)));
    }
    log
}

/// Stops what it is given to when it goes out of scope, also by a panic.
pub struct Until<'a>(pub &'a AtomicBool);

impl Drop for Until<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}
