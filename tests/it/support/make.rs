//! Recordings made to measure, through the library.

use std::fs::File;
use std::path::Path;

use bustape::frame::{Frame, Stamped, Timestamp};
use bustape::recording::definition::{Attachment, Facts};
use bustape::recording::schema::bustape::{BusStats, ClockSync};
use bustape::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};

/// What stands in the recording that [`make`] makes, frames aside.
pub fn head(buses: &[&str]) -> Head {
    let facts = |pairs: &[(&str, &str)]| -> Facts {
        pairs.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect()
    };
    let buses = buses.iter().map(|bus| {
        (bus.to_string(), facts(&[("address", "test"), ("kind", "made"), ("bitrate", "500000")]))
    });
    let attachment = |name: &str, data: &[u8]| Attachment {
        name: name.to_owned(),
        media_type: "text/plain".to_owned(),
        data: data.to_vec(),
    };
    Head {
        recording: facts(&[("format", "1"), ("session", "1"), ("session_id", "of the test")]),
        clock: facts(&[("steady_ns", "42"), ("wall_ns", "1700000000000000000")]),
        buses: buses.collect(),
        more: vec![("another.tool".to_owned(), facts(&[("kept", "yes")]))],
        attachments: vec![
            attachment("plant.dbc", b"VERSION \"\"\r\n\xE9\x00"),
            attachment("empty.txt", b""),
        ],
        time: Timestamp(START),
    }
}

/// 2023-11-14T22:13:20Z.
pub const START: u64 = 1_700_000_000_000_000_000;
pub const SECOND: u64 = 1_000_000_000;

/// Writes `frames` of `buses`, in chunks of a few, with clocks, statistics and notices between.
pub fn make(path: &Path, layout: Layout, buses: &[&str], frames: &[(usize, Stamped<Frame>)]) {
    make_with(path, layout, &head(buses), frames, &[]);
}

/// The same with another head, and with `more` in its summary.
pub fn make_with(
    path: &Path,
    layout: Layout,
    head: &Head,
    frames: &[(usize, Stamped<Frame>)],
    more: &[(&str, &str)],
) {
    let file = File::create(path).expect("a new file");
    let options = WriterOptions { layout, batch_frames: 40, ..WriterOptions::default() };
    let mut writer = SegmentWriter::create(Box::new(file), options, head).expect("a head");
    for (number, (bus, frame)) in frames.iter().enumerate() {
        writer.add(*bus, frame).expect("a frame");
        if number % 50 == 20 {
            let sync = ClockSync { steady_ns: 42, wall_ns: frame.time.nanos() + 7, step_ns: -3 };
            writer.add_clock(frame.time, &sync).expect("a clock");
            let stats = BusStats { received: number as u64, rate: 2.5, ..BusStats::default() };
            writer.add_stats(*bus, frame.time, &stats).expect("statistics");
        }
        if number % 64 == 63 {
            writer.cut().expect("a chunk");
        }
    }
    let summary = [("reason", "made")].iter().chain(more);
    let summary: Facts = summary.map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    writer.finish(summary).expect("an end");
}

/// `value` at `nanos` after the start.
pub fn at(nanos: u64, value: Frame) -> Stamped<Frame> {
    Stamped { time: Timestamp(START + nanos), value }
}
