//! What decoding costs: `cargo bench --bench decoding`.
//!
//! Times are CPU times of the process; throughput is signals, or frames, per CPU second.

#![allow(clippy::unwrap_used, reason = "a bench that cannot run must end")]

#[path = "../recording/cpu_time.rs"]
mod cpu_time;
#[path = "../recording/traffic.rs"]
mod traffic;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::hint::black_box;
use std::io;

use bustape::channels::{Definition, Meaning, Stream};
use bustape::decode::bus::{CanBus, CanItem};
use bustape::decode::dbc;
use bustape::decode::definition::CanDefinition;
use bustape::frame::{CanFlags, Frame, Stamped};
use bustape::recording::definition::Facts;
use bustape::recording::disk::OutputFile;
use bustape::recording::writer::{Head, SegmentWriter, WriterOptions};
use cpu_time::CpuTime;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const FRAMES: usize = 200_000;

/// What stands in every message: both byte orders, signs, scales, a table, flags.
const SIGNALS: &str = " SG_ Speed : 0|16@1+ (0.01,0) [0|655.35] \"km/h\" Y
 SG_ Torque : 23|12@0- (0.5,0) [0|0] \"Nm\" Y
 SG_ Mode : 24|3@1+ (1,0) [0|7] \"\" Y
 SG_ Ready : 27|1@1+ (1,0) [0|1] \"\" Y
 SG_ Temperature : 32|8@1+ (1,-40) [-40|215] \"degC\" Y
 SG_ Current : 40|16@1- (0.1,0) [0|0] \"A\" Y
 SG_ Counter : 56|4@1+ (1,0) [0|15] \"\" Y
 SG_ Check : 60|4@1+ (1,0) [0|15] \"\" Y
";

/// A database for the traffic.
fn database(frames: &[Stamped<Frame>]) -> String {
    let cans = frames.iter().filter_map(|frame| match &frame.value {
        Frame::Can(can) => Some((can.id, can.flags.has(CanFlags::EXTENDED))),
        _ => None,
    });
    let ids: BTreeMap<u32, bool> = cans.collect();
    let mut text = String::new();
    for (id, extended) in ids {
        let key = id | if extended { 0x8000_0000 } else { 0 };
        write!(text, "BO_ {key} M{id:X}: 8 X\n{SIGNALS}").unwrap();
        writeln!(text, "VAL_ {key} Mode 0 \"Off\" 1 \"On\" 2 \"Fault\" ;").unwrap();
    }
    text
}

fn definition(text: &str) -> CanDefinition {
    let parsed = dbc::parse(text.as_bytes()).unwrap();
    CanDefinition::of_database("bench", parsed.database, false)
}

fn frames() -> Vec<Stamped<Frame>> {
    traffic::Traffic::new().take(FRAMES).collect()
}

/// Every signal of every frame, one bus.
fn decode(bus: &mut CanBus, frames: &[Stamped<Frame>]) -> u64 {
    let mut signals = 0;
    for frame in frames {
        let Frame::Can(can) = &frame.value else { continue };
        bus.feed(frame.time, can, &mut |item| {
            if let CanItem::Message(found) = item {
                found.decode(can, |reading| {
                    black_box(reading);
                    signals += 1;
                });
            }
        });
    }
    signals
}

fn signals(c: &mut Criterion<CpuTime>) {
    let frames = frames();
    let mut bus = CanBus::new(definition(&database(&frames)).into());
    let mut group = c.benchmark_group("decode");
    group.throughput(Throughput::Elements(decode(&mut bus, &frames)));
    group.bench_function("signals", |b| b.iter(|| decode(&mut bus, &frames)));
    group.finish();
}

fn write(c: &mut Criterion<CpuTime>) {
    let frames = frames();
    let text = database(&frames);
    let mut group = c.benchmark_group("write");
    group.throughput(Throughput::Elements(frames.len() as u64));
    for decoded in [false, true] {
        let name = if decoded { "raw and decoded" } else { "raw" };
        group.bench_function(name, |b| {
            b.iter(|| {
                let meaning = Meaning::Can(definition(&text).into());
                let (protocol, attachments) = ("bench".to_owned(), Vec::new());
                let definition = Definition { protocol, attachments, meaning };
                let stream = decoded.then(|| Stream::new("can0", definition));
                record(&frames, stream).unwrap();
            });
        });
    }
    group.finish();
}

fn record(frames: &[Stamped<Frame>], mut stream: Option<Stream>) -> io::Result<()> {
    let buses = vec![("can0".to_owned(), Facts::new())];
    let head = Head { buses, time: frames[0].time, ..Head::default() };
    let mut writer = SegmentWriter::create(Box::new(Nothing), WriterOptions::default(), &head)?;
    for frame in frames {
        writer.add(0, frame)?;
        if let Some(stream) = &mut stream {
            stream.take(frame, &mut writer).map_err(io::Error::other)?;
        }
        if writer.is_full() {
            writer.cut()?;
        }
    }
    writer.finish(Facts::new())
}

/// A database with 10,000 signals: reading it, and making it ready to write channels.
fn load(c: &mut Criterion<CpuTime>) {
    let mut text = String::new();
    for id in 0..1250 {
        write!(text, "BO_ {id} M{id}: 8 X\n{SIGNALS}").unwrap();
        writeln!(text, "VAL_ {id} Mode 0 \"Off\" 1 \"On\" 2 \"Fault\" ;").unwrap();
    }
    let stream = || {
        let meaning = Meaning::Can(definition(&text).into());
        let (protocol, attachments) = ("bench".to_owned(), Vec::new());
        Stream::new("can0", Definition { protocol, attachments, meaning })
    };
    let before = resident();
    let loaded = stream();
    println!("10,000 signals loaded: {} KiB of memory", resident().saturating_sub(before));
    drop(loaded);
    c.bench_function("load 10,000 signals", |b| b.iter(stream));
}

/// Resident memory of this process in KiB.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

/// A disk that costs nothing.
struct Nothing;

impl io::Write for Nothing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl OutputFile for Nothing {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

criterion_group! {
    name = decoding;
    config = Criterion::default().with_measurement(CpuTime).sample_size(10);
    targets = load, signals, write
}
criterion_main!(decoding);
