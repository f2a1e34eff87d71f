//! Windows against a model, with random frames and triggers; the memory against a list.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use proptest::prelude::*;

use super::memory::{Memory, Place};
use super::{Keeping, Windows};
use crate::capture::BusFacts;
use crate::clock::{ManualClock, Reading, Timeline};
use crate::frame::{
    CanFlags, CanFrame, Direction, Frame, Level, LineError, LineErrorKind, Notice, SerialBytes,
    Stamped, Timestamp, Unit,
};
use crate::queue::Item;
use crate::queue::Tally;
use crate::record::entry::Entry;
use crate::record::recorder::Outcome;
use crate::record::session::Session;
use crate::record::{Pace, Progress, RecordedBus, Segments, Split, Target};
use crate::recording::definition::Facts;
use crate::recording::disk::RealDisk;
use crate::recording::reader::{Entry as Read, Recording};
use crate::recording::writer::{Layout, WriterOptions};
use crate::trigger::{Fired, Window};

const MILLI: u64 = 1_000_000;
const START: u64 = 1_700_000_000_000_000_000;

fn frame(number: u32, bus: u16, time: Timestamp) -> Entry {
    let flags = CanFlags::EXTENDED;
    let value = Frame::Can(CanFrame::new(number, flags, &[number as u8; 8][..number as usize % 9]));
    Entry::Frame(Item { bus, frame: Stamped { time, value } })
}

fn session(timeline: &Timeline) -> Session {
    let bus = |name: &str| RecordedBus {
        name: name.to_owned(),
        address: "test".to_owned(),
        facts: BusFacts { unit: Some(Unit::Frames), ..BusFacts::default() },
        tally: Arc::new(Tally::default()),
    };
    let buses = vec![bus("a"), bus("b")];
    let about = (Facts::new(), Vec::new());
    let progress = Arc::new(Progress::default());
    Session::new(buses, timeline.clone(), Pace::default(), about, None, progress)
}

fn windows(folder: &std::path::Path, layout: Layout, keeping: Keeping) -> Windows {
    let options = WriterOptions { layout, ..WriterOptions::default() };
    let target = Target::Folder(folder.to_owned(), "t".to_owned());
    let segments = Segments::new(Arc::new(RealDisk), target, Split::default(), options).unwrap();
    Windows::new(keeping, segments.windows().unwrap(), vec![None, None], 2)
}

/// A trigger with a window of so many milliseconds before and after.
fn fired(time: Timestamp, before: u64, after: u64) -> Fired {
    Fired {
        time,
        name: "t".to_owned(),
        condition: "mark".to_owned(),
        bus: None,
        value: None,
        run: Vec::new(),
        window: Some(Window { before: before * MILLI, after: after * MILLI }),
    }
}

/// What happens in a step of a test.
#[derive(Clone, Debug)]
enum Step {
    /// A frame after so many milliseconds, which comes so many milliseconds late.
    Frame(u64, u64),
    /// A trigger: milliseconds before and after.
    Fire(u64, u64),
    /// The writer goes round.
    Round,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        12 => (0u64..40, 0u64..5).prop_map(|(after, late)| Step::Frame(after, late)),
        1 => (0u64..300, 0u64..200).prop_map(|(before, after)| Step::Fire(before, after)),
        4 => Just(Step::Round),
    ];
    prop::collection::vec(step, 1..400)
}

/// The frames of a file, by bus and number.
fn read(path: &PathBuf) -> Vec<(usize, u32)> {
    let recording = Recording::open(std::slice::from_ref(path)).unwrap();
    let frames = recording.entries(Recording::ALL, |topic| topic.ends_with("/raw"));
    let mut frames: Vec<(usize, u32)> = frames
        .filter_map(|entry| match entry.value {
            Read::Frame(bus, Frame::Can(can)) => Some((bus, can.id)),
            _ => None,
        })
        .collect();
    frames.sort_unstable();
    frames
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn each_window_has_what_happened_in_it_and_nothing_is_in_two(
        steps in steps(),
        batch in any::<bool>(),
        only in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let clock = ManualClock::new(Reading { wall: START, steady: 0 });
        let timeline = Timeline::start(Arc::new(clock.clone()));
        let mut session = session(&timeline);
        let layout = if batch { Layout::Batch } else { Layout::Frame };
        let keeping = Keeping { reach: 300 * MILLI, memory: 1 << 20, only };
        let mut windows = windows(folder.path(), layout, keeping);
        // The model: all frames, and the windows as intervals.
        let mut frames: Vec<(usize, u32, u64)> = Vec::new();
        let mut spans: Vec<(u64, u64)> = Vec::new();
        for step in steps {
            let now = timeline.now();
            match step {
                Step::Frame(after, late) => {
                    clock.advance(after * MILLI);
                    let time = Timestamp(timeline.now().nanos() - late * MILLI);
                    let number = frames.len() as u32;
                    let bus = number % 2;
                    session.buses[bus as usize].tally.received(1);
                    windows.take(&frame(number, bus as u16, time), &mut session);
                    frames.push((bus as usize, number, time.nanos()));
                }
                Step::Fire(before, after) => {
                    let (from, to) = (now.nanos() - before * MILLI, now.nanos() + after * MILLI);
                    match spans.last_mut() {
                        Some(last) if from <= last.1 => {
                            // Not into a window before, which has its frames already.
                            *last = (last.0.min(from), last.1.max(to));
                        }
                        _ => spans.push((from, to)),
                    }
                    windows.want(fired(now, before, after), &mut session);
                }
                Step::Round => {
                    windows.pass(Timestamp(now.nanos() - 5 * MILLI));
                    windows.on_tick(now, true, &mut session);
                }
            }
        }
        let mut outcome = Outcome::default();
        windows.finish("end", &mut session, &mut outcome);
        prop_assert!(outcome.error.is_none() && !outcome.windows_incomplete);
        prop_assert_eq!(outcome.windows.len(), spans.len());
        let mut floor = 0;
        let mut kept = 0;
        for (path, (from, to)) in outcome.windows.iter().zip(&spans) {
            let within = |time: u64| time >= (*from).max(floor) && time <= *to;
            let mut expected: Vec<(usize, u32)> = frames
                .iter()
                .filter(|(_, _, time)| within(*time))
                .map(|(bus, number, _)| (*bus, *number))
                .collect();
            expected.sort_unstable();
            prop_assert_eq!(&read(path), &expected);
            kept += expected.len() as u64;
            floor = to + 1;
        }
        for bus in &session.buses {
            let totals = bus.tally.totals();
            prop_assert!(!only || totals.balanced(), "{totals:?}");
        }
        let written: u64 = session.buses.iter().map(|bus| bus.tally.totals().written).sum();
        prop_assert_eq!(written, if only { kept } else { 0 });
    }

    #[test]
    fn the_memory_gives_back_what_was_put_in_and_accounts_for_what_goes(
        sizes in prop::collection::vec((0usize..3, 0usize..3000, any::<bool>()), 1..200),
        limit in 20_000usize..200_000,
    ) {
        let mut memory = Memory::new(limit, 2);
        let mut put = Vec::new();
        let (mut outside, mut kept) = (BTreeMap::<usize, u64>::new(), 0);
        for (number, (kind, size, keep)) in sizes.iter().enumerate() {
            let time = Timestamp(number as u64 + 1);
            let bytes = |errors| SerialBytes { direction: Direction::Tx, data: vec![7; *size], errors };
            let value = match kind {
                0 => Frame::Serial(bytes(Vec::new())),
                1 => {
                    let kind = LineErrorKind::Parity;
                    Frame::Serial(bytes(vec![LineError { offset: 0, kind }]))
                }
                _ => Frame::Notice(Notice { level: Level::Info, text: "x".repeat(*size) }),
            };
            let entry = Entry::Frame(Item { bus: (number % 2) as u16, frame: Stamped { time, value } });
            memory.push(&entry);
            while memory.is_over() {
                memory.give_up(|bus, count| *outside.entry(bus).or_default() += count);
            }
            put.push((entry, *keep));
        }
        let mut place = Place::default();
        let mut found = Vec::new();
        while let Some(one) = memory.next(&mut place) {
            found.push(one);
        }
        // What is there is the end of what was put in, as it was.
        let rest = &put[put.len() - found.len()..];
        prop_assert!(!found.is_empty());
        for (found, (entry, keep)) in found.iter().zip(rest) {
            prop_assert_eq!(format!("{:?}", found.entry), format!("{entry:?}"));
            prop_assert!(!found.marked);
            if *keep {
                memory.mark(found, true);
                kept += weight(entry);
            }
        }
        memory.expire(Timestamp(u64::MAX), Place::LAST, |bus, count| {
            *outside.entry(bus).or_default() += count;
        });
        let all: u64 = put.iter().map(|(entry, _)| weight(entry)).sum();
        prop_assert_eq!(all, kept + outside.values().sum::<u64>());
    }
}

#[test]
fn behind_a_disk_that_stood_still_a_window_has_all_that_it_reaches() {
    let folder = tempfile::tempdir().unwrap();
    let clock = ManualClock::new(Reading { wall: START, steady: 0 });
    let timeline = Timeline::start(Arc::new(clock.clone()));
    let mut session = session(&timeline);
    let keeping = Keeping { reach: 3_000 * MILLI, memory: 1 << 20, only: false };
    let mut windows = windows(folder.path(), Layout::Frame, keeping);
    let begun = timeline.now();
    // The recorder's own sentence is of now; the frames that come behind it are of long before.
    clock.advance(10_000 * MILLI);
    let notice = Notice { level: Level::Info, text: "now".to_owned() };
    windows.take(&Entry::Notice { time: timeline.now(), notice }, &mut session);
    for number in 0..3_000_u32 {
        let time = begun.plus(u64::from(number) * MILLI);
        windows.take(&frame(number, 0, time), &mut session);
        if number % 100 == 99 {
            windows.on_tick(timeline.now(), false, &mut session);
        }
    }
    windows.want(fired(begun.plus(2_999 * MILLI), 3_000, 0), &mut session);
    let mut outcome = Outcome::default();
    windows.finish("end", &mut session, &mut outcome);
    assert_eq!(read(&outcome.windows[0]).len(), 3_000);
}

// Found by the model: a place behind a block that still grew.
#[test]
fn a_place_for_a_time_to_come_is_in_front_of_what_comes_then() {
    let mut memory = Memory::new(1 << 20, 2);
    memory.push(&frame(1, 0, Timestamp(1)));
    let mut place = memory.place_of(Timestamp(5));
    memory.push(&frame(2, 0, Timestamp(6)));
    let found = std::iter::from_fn(|| memory.next(&mut place));
    assert_eq!(found.last().map(|found| found.entry.time()), Some(Timestamp(6)));
}

fn weight(entry: &Entry) -> u64 {
    match entry {
        Entry::Frame(item) => item.frame.value.weight(),
        _ => 0,
    }
}
