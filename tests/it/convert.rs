//! `bustape convert`, and that both layouts hold the same.

use std::path::Path;

use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, Level, LineError, LineErrorKind, Notice,
    SerialBytes, Stamped, Timestamp, Unit,
};
use bustape::recording::reader::{Entry, Recording};
use bustape::recording::writer::Layout;
use proptest::prelude::*;

use crate::record::in_order;
use crate::support::bytes::noise;
use crate::support::make::{START, make};
use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, Raw};
use crate::support::peers;
use crate::support::process::{args, bustape, start};
use crate::support::{files, until};

const BUSES: [&str; 2] = ["can0", "rect"];
const FD_LENGTHS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// A frame of any kind that can be on a bus.
fn any_can() -> impl Strategy<Value = CanFrame> {
    let payload = prop::collection::vec(any::<u8>(), 64);
    // Few identifiers, so that frames share them; few kinds of everything else.
    let id = prop_oneof![0u32..4, Just(0x7FF), Just(0x1FFF_FFFF), any::<u32>()];
    (id, 0usize..16, 0u8..=5, any::<[bool; 4]>(), payload).prop_map(
        |(id, length, kind, [extended, tx, brs, esi], payload)| {
            let mut flags = CanFlags::default();
            let mut set = |flag, on| flags |= if on { flag } else { CanFlags::default() };
            set(CanFlags::TX, tx);
            set(CanFlags::EXTENDED, extended && kind != 5);
            let id = if extended { id & 0x1FFF_FFFF } else { id & 0x7FF };
            match kind {
                0 => {
                    set(CanFlags::REMOTE, true);
                    CanFrame::new(id, flags, &[]).with_dlc(length as u8)
                }
                1 | 2 => {
                    set(CanFlags::FD, true);
                    set(CanFlags::BRS, brs);
                    set(CanFlags::ESI, esi);
                    CanFrame::new(id, flags, &payload[..FD_LENGTHS[length]])
                }
                5 => {
                    set(CanFlags::ERROR, true);
                    CanFrame::new(id, flags, &payload[..8])
                }
                _ if length > 8 => CanFrame::new(id, flags, &payload[..8]).with_dlc(length as u8),
                _ => CanFrame::new(id, flags, &payload[..length]),
            }
        },
    )
}

/// Something that can happen: on which bus, how long after the thing before (often at once), what.
fn any_event() -> impl Strategy<Value = (usize, u64, Frame)> {
    let pause = prop_oneof![
        Just(0u64),
        Just(1),
        (1u64..5000).prop_map(|us| us * 1000),
        0u64..2_000_000_000
    ];
    let serial = (any::<bool>(), prop::collection::vec(any::<u8>(), 0..40), any::<bool>());
    let serial = serial.prop_map(|(rx, data, broken)| {
        let direction = if rx { Direction::Rx } else { Direction::Tx };
        let error = LineError { offset: data.len() as u32, kind: LineErrorKind::Break };
        Frame::Serial(SerialBytes {
            direction,
            errors: broken.then_some(error).into_iter().collect(),
            data,
        })
    });
    let gap = (0u64..1000).prop_map(|count| {
        let (from, to) = (Timestamp(START), Timestamp(START + count));
        Frame::Gap(Gap { count, unit: Unit::Frames, reason: GapReason::KernelQueue, from, to })
    });
    let notice = Just(Frame::Notice(Notice { level: Level::Warning, text: "a sentence".into() }));
    let what = prop_oneof![
        20 => any_can().prop_map(|can| (0, Frame::Can(can))),
        6 => serial.prop_map(|serial| (1, serial)),
        1 => gap.prop_map(|gap| (0, gap)),
        1 => notice.prop_map(|notice| (1, notice)),
    ];
    (pause, what).prop_map(|(pause, (bus, frame))| (bus, pause, frame))
}

fn stamped(events: Vec<(usize, u64, Frame)>) -> Vec<(usize, Stamped<Frame>)> {
    let mut time = START;
    let stamp = events.into_iter().map(|(bus, pause, value)| {
        time += pause;
        (bus, Stamped { time: Timestamp(time), value })
    });
    stamp.collect()
}

/// What went in, as the strict reader puts it.
fn expected(frames: &[(usize, Stamped<Frame>)], bus: usize) -> Vec<(u64, Raw)> {
    let of_bus = frames.iter().filter(|(of, _)| *of == bus);
    let raws = of_bus.filter_map(|(_, Stamped { time, value })| {
        let raw = match value {
            Frame::Can(can) => Raw::Can(*can),
            Frame::Serial(SerialBytes { direction: Direction::Rx, data, .. }) => {
                Raw::Rx(data.clone())
            }
            Frame::Serial(SerialBytes { direction: Direction::Tx, data, .. }) => {
                Raw::Tx(data.clone())
            }
            Frame::Gap(gap) => Raw::Gap(gap.count, 1),
            Frame::Notice(_) => return None,
        };
        Some((time.nanos(), raw))
    });
    raws.collect()
}

/// Gaps travel on a topic of their own, so among equal times only the order of the rest is kept.
fn apart(all: &[(u64, Raw)]) -> [Vec<&(u64, Raw)>; 2] {
    let (gaps, rest) = all.iter().partition(|(_, raw)| matches!(raw, Raw::Gap(..)));
    [gaps, rest]
}

fn read_back(path: &Path, bus: usize) -> Vec<(u64, Frame)> {
    let recording = Recording::open(&[path.to_owned()]).unwrap();
    let bus = recording.buses.iter().position(|name| name == BUSES[bus]).unwrap();
    let mut entries = recording.entries(Recording::ALL, |_| true);
    let mut all = Vec::new();
    for Stamped { time, value } in entries.by_ref() {
        match value {
            Entry::Frame(of, frame) if of == bus => all.push((time.nanos(), frame)),
            _ => {}
        }
    }
    assert_eq!(entries.damage(), [""; 0]);
    all
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_happens_on_a_bus_comes_back_as_it_was(
        events in prop::collection::vec(any_event(), 1..250),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let frames = stamped(events);
        for layout in [Layout::Frame, Layout::Batch] {
            let path = folder.path().join(layout.name());
            make(&path, layout, &BUSES, &frames);
            let file = mcap::finished(&path);
            for (bus, name) in BUSES.into_iter().enumerate() {
                let (found, sent) = (messages::raw(&file, name), expected(&frames, bus));
                prop_assert_eq!(apart(&found), apart(&sent));
                // And by our own reader.
                let is_gap = |frame: &Frame| matches!(frame, Frame::Gap(_));
                let read = read_back(&path, bus);
                let read = read.iter().filter(|(_, frame)| !is_gap(frame));
                let sent = frames.iter().filter(|(of, _)| *of == bus).map(|(_, f)| f);
                let sent = sent.filter(|f| !is_gap(&f.value) && !matches!(f.value, Frame::Notice(_)));
                prop_assert!(read.map(|(t, f)| (*t, f)).eq(sent.map(|f| (f.time.nanos(), &f.value))));
            }
        }
    }
}

/// A few thousand frames of all kinds, the same each time.
fn frames() -> Vec<(usize, Stamped<Frame>)> {
    use proptest::strategy::ValueTree as _;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let events = prop::collection::vec(any_event(), 3000).new_tree(&mut runner).unwrap();
    stamped(events.current())
}

/// All messages but CAN frames, and everything beside the messages.
fn rest(file: &Mcap) -> impl PartialEq + std::fmt::Debug + use<> {
    let others = file.messages.iter().filter(|m| file.topic(m) != "/can0/raw");
    let mut others: Vec<_> =
        others.map(|m| (m.time, file.topic(m).to_owned(), m.data.clone())).collect();
    others.sort();
    let mut metadata = file.metadata.clone();
    for key in ["layout", "batch_max_ns", "segment"] {
        metadata[0].1.remove(key);
    }
    let mut channels: Vec<_> =
        file.channels.values().map(|c| (c.topic.clone(), c.metadata.clone())).collect();
    channels.sort();
    (others, metadata, channels, file.attachments.clone())
}

#[test]
fn from_one_layout_to_the_other_and_back_nothing_changes() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(format!("{name}.mcap"));
    make(&path("a"), Layout::Frame, &BUSES, &frames());
    let convert = |from: &str, to: &str, layout: &str| {
        let args = args(&[&"convert", &path(from), &"-o", &path(to), &"--layout", &layout]);
        bustape(args).expect(0);
        mcap::finished(&path(to))
    };
    let original = mcap::finished(&path("a"));
    let cat = |name: &str| bustape(args(&[&"cat", &"-N", &"-x", &path(name)])).expect(0).out;
    let (batch, again) = (convert("a", "b", "batch"), convert("b", "c", "frame"));
    for (name, file) in [("b", &batch), ("c", &again)] {
        in_order(file, true);
        assert_eq!(rest(file), rest(&original), "{name}");
        assert_eq!(messages::cans(file, "can0"), messages::cans(&original, "can0"), "{name}");
        assert!(cat(name) == cat("a"), "{name} is printed differently");
    }
    assert_eq!(batch.facts("bustape.recording")["layout"], "batch");
    assert!(batch.on("/can0/raw").count() * 2 < original.on("/can0/raw").count());
    // Message by message, not only in what they mean.
    let bytes =
        |file: &Mcap| file.on("/can0/raw").map(|m| (m.time, m.data.clone())).collect::<Vec<_>>();
    assert!(bytes(&again) == bytes(&original));
    for (name, file) in [("b", &batch), ("c", &again)] {
        let (python, node) = (peers::python_reads(&path(name)), peers::node_reads(&path(name)));
        assert_eq!(python.messages.len(), file.messages.len());
        assert_eq!(node.messages.len(), file.messages.len());
        assert_eq!(python.file["attachments"].as_array().unwrap().len(), 2);
        assert_eq!(python.file["attachments"], node.file["attachments"]);
    }
}

#[test]
fn without_a_layout_it_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let (path, new) =
            (folder.path().join(layout.name()), folder.path().join(format!("{}2", layout.name())));
        make(&path, layout, &BUSES, &frames()[..500]);
        let ran = bustape(args(&[&"convert", &path, &"-o", &new])).expect(0);
        assert_eq!(ran.out, "");
        assert!(ran.err.contains(new.to_str().unwrap()), "{}", ran.err);
        let (old, new) = (mcap::finished(&path), mcap::finished(&new));
        assert_eq!(new.facts("bustape.recording")["layout"], layout.name());
        assert_eq!(messages::cans(&old, "can0"), messages::cans(&new, "can0"));
    }
}

#[test]
fn a_copy_that_is_interrupted_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let [raw, copy, part] = ["raw", "copy", "copy.part"].map(|name| folder.path().join(name));
    let frame = |n: u64| Stamped {
        time: Timestamp(START + n * 1000),
        value: Frame::Can(CanFrame::new(n as u32 % 0x700, CanFlags::default(), &noise(n, 8))),
    };
    let frames: Vec<_> = (0..400_000).map(|n| (0, frame(n))).collect();
    make(&raw, Layout::Frame, &BUSES, &frames);
    for verb in [&["convert"][..], &["decode", "--decode", "can0=hmi-can"]] {
        let mut command = args(&[&verb[0], &raw, &"-o", &copy, &"--compression", &"19"]);
        command.extend(verb[1..].iter().map(Into::into));
        let running = start(command);
        until("the copy", || part.exists().then_some(()));
        let ran = running.stop().expect(1);
        assert!(ran.err.contains("interrupted"), "{}", ran.err);
        assert_eq!(files(folder.path()), ["raw"]);
    }
}
