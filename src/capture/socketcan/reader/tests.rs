use std::sync::Arc;
use std::time::Duration;

use super::*;
use crate::clock::{ManualClock, Reading, Timeline};
use crate::frame::Unit;
use crate::queue::{Allowance, Queue, Tally};

const START: u64 = 1_700_000_000_000_000_000;
const FOREVER: Timestamp = Timestamp(u64::MAX);

struct Bench {
    clock: ManualClock,
    queue: Arc<Queue>,
    tally: Arc<Tally>,
    reader: Reader,
}

fn bench() -> Bench {
    let clock = ManualClock::new(Reading { wall: START, steady: 5 });
    let timeline = Timeline::start(Arc::new(clock.clone()));
    let (queue, tally) = (Queue::new(1 << 20), Arc::new(Tally::default()));
    let allowance = Allowance::new(None);
    let inlet = Inlet::new(0, Unit::Frames, queue.clone(), tally.clone(), allowance, timeline);
    let reader = Reader::new("can0", inlet, false);
    Bench { clock, queue, tally, reader }
}

/// Control messages as the kernel writes them on this machine.
fn control(wall: u64, drops: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut add = |kind: i32, value: &[u8]| {
        bytes.extend((size_of::<usize>() + 8 + value.len()).to_ne_bytes());
        bytes.extend(libc::SOL_SOCKET.to_ne_bytes());
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(value);
        bytes.resize(bytes.len().next_multiple_of(size_of::<usize>()), 0);
    };
    let (seconds, nanos) = (wall / 1_000_000_000, wall % 1_000_000_000);
    add(libc::SO_TIMESTAMPNS, &[seconds.to_ne_bytes(), nanos.to_ne_bytes()].concat());
    if drops > 0 {
        add(libc::SO_RXQ_OVFL, &drops.to_ne_bytes());
    }
    bytes
}

impl Bench {
    /// Reads frames that were received so many ns after the start, with the drop counter.
    fn read(&mut self, frames: &[(u64, u32)], until: Timestamp) -> bool {
        let payload = [0u8; 16];
        let controls: Vec<_> =
            frames.iter().map(|(at, drops)| control(START + at, *drops)).collect();
        let messages =
            controls.iter().map(|control| RawMessage { payload: &payload, control, flags: 0 });
        self.reader.take(messages, until).is_some()
    }

    /// What went into the recording: `f30` for a frame at 30, `kernel 5: 10..30` for a gap.
    fn recorded(&self) -> Vec<String> {
        let mut items = Vec::new();
        self.queue.poke();
        self.queue.take(&mut items, usize::MAX, Duration::ZERO);
        let offset = |time: Timestamp| time.nanos() - START;
        let text = |item: crate::queue::Item| match item.frame.value {
            Frame::Can(_) => Some(format!("f{}", offset(item.frame.time))),
            Frame::Gap(gap) => {
                assert_eq!(item.frame.time, gap.to);
                let reason = if gap.reason == GapReason::LinkDown { "down" } else { "kernel" };
                Some(format!("{reason} {}: {}..{}", gap.count, offset(gap.from), offset(gap.to)))
            }
            _ => None,
        };
        items.into_iter().filter_map(text).collect()
    }

    fn at(&self, nanos: u64) -> Timestamp {
        Timestamp(START + nanos)
    }
}

#[test]
fn a_drop_is_recorded_in_front_of_the_frame_that_tells_of_it() {
    let mut bench = bench();
    bench.clock.advance(100);
    bench.read(&[(10, 0), (20, 0), (30, 5), (40, 5), (50, 7)], FOREVER);
    let expected = ["f10", "f20", "kernel 5: 20..30", "f30", "f40", "kernel 2: 40..50", "f50"];
    assert_eq!(bench.recorded(), expected);
    let totals = bench.tally.totals();
    assert_eq!((totals.received, totals.lost_to(GapReason::KernelQueue)), (12, 7));
}

#[test]
fn the_two_ways_to_the_counter_count_a_drop_once() {
    let mut bench = bench();
    bench.clock.advance(100);
    bench.read(&[(10, 0)], FOREVER);
    bench.reader.settle(3, bench.at(60));
    bench.reader.settle(3, bench.at(70));
    // Queued before the third drop, read after the counter was.
    bench.read(&[(50, 2), (80, 3), (90, 4)], FOREVER);
    let expected = ["f10", "kernel 3: 10..60", "f50", "f80", "kernel 1: 80..90", "f90"];
    assert_eq!(bench.recorded(), expected);
}

#[test]
fn the_counter_wraps_and_starts_again_with_a_new_socket() {
    let mut drops = Drops { seen: u32::MAX - 1 };
    assert_eq!(drops.new_at(3), Some(5));
    assert_eq!(drops.new_at(u32::MAX), None);
    assert_eq!(drops.new_at(3), None);
    let mut bench = bench();
    bench.reader.settle(9, bench.at(0));
    bench.reader.new_socket();
    bench.reader.settle(2, bench.at(0));
    assert_eq!(bench.recorded(), ["kernel 9: 0..0", "kernel 2: 0..0"]);
}

#[test]
fn what_was_received_after_the_end_is_not_recorded() {
    let mut bench = bench();
    bench.clock.advance(100);
    assert!(!bench.read(&[(10, 0), (20, 1), (31, 2), (32, 2)], bench.at(30)));
    assert_eq!(bench.recorded(), ["f10", "kernel 1: 10..20", "f20"]);
    assert_eq!(bench.tally.totals().received, 3);
}

#[test]
fn an_outage_lasts_from_the_last_to_the_first_frame() {
    let mut bench = bench();
    bench.clock.advance(100);
    bench.read(&[(10, 0)], FOREVER);
    bench.reader.link_lost(bench.at(5));
    bench.read(&[(20, 0)], FOREVER); // Was still queued.
    assert!(bench.reader.link_down(bench.at(5)));
    assert!(!bench.reader.link_down(bench.at(5)));
    bench.read(&[(25, 0)], FOREVER); // Was still on its way through the kernel.
    bench.clock.advance(500);
    bench.read(&[(400, 0), (410, 0)], FOREVER);
    assert_eq!(bench.recorded(), ["f10", "f20", "f25", "down 0: 25..400", "f400", "f410"]);
    assert!(!bench.reader.is_down());
}

#[test]
fn a_quiet_bus_is_up_again_when_the_kernel_says_so() {
    let mut bench = bench();
    bench.reader.link_down(bench.at(50));
    bench.clock.advance(1_000);
    bench.reader.link_up(bench.at(900));
    bench.reader.link_up(bench.at(950));
    assert_eq!(bench.recorded(), ["down 0: 50..900"]);
}

#[test]
fn a_link_that_was_down_unseen_is_a_gap_around_what_was_queued() {
    let mut bench = bench();
    bench.clock.advance(100);
    bench.reader.link_lost(bench.at(5));
    bench.read(&[(10, 0), (60, 0)], FOREVER);
    bench.reader.link_up(bench.at(90));
    assert_eq!(bench.recorded(), ["f10", "f60", "down 0: 5..90"]);
}

#[test]
fn an_outage_at_the_end_is_recorded() {
    let mut bench = bench();
    bench.reader.link_lost(bench.at(5));
    bench.reader.finish(bench.at(70));
    assert_eq!(bench.recorded(), ["down 0: 5..70"]);
}
