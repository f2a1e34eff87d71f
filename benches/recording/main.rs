//! What a frame costs on its way into a recording and back: `cargo bench --bench recording`.
//!
//! Times are CPU times of the process, throughput is frames per CPU second.

#![allow(clippy::unwrap_used, reason = "a bench that cannot run must end")]

mod cpu_time;
mod traffic;

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use bustape::clock::Timeline;
use bustape::frame::{Frame, Stamped, Unit};
use bustape::queue::{Allowance, Inlet, Queue, Tally};
use bustape::recording::definition::Facts;
use bustape::recording::disk::OutputFile;
use bustape::recording::reader::Recording;
use bustape::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};
use bustape::sys::SystemClock;
use cpu_time::CpuTime;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const FRAMES: usize = 200_000;
const LAYOUTS: [Layout; 2] = [Layout::Frame, Layout::Batch];

fn write(c: &mut Criterion<CpuTime>) {
    let frames = frames();
    let mut group = c.benchmark_group("write");
    group.throughput(Throughput::Elements(frames.len() as u64));
    for layout in LAYOUTS {
        group.bench_function(layout.name(), |b| {
            b.iter(|| {
                let counter = Arc::new(AtomicU64::new(0));
                write_to(Box::new(Counter(counter.clone())), layout, &frames).unwrap();
                counter.load(Relaxed)
            });
        });
    }
    group.finish();
}

fn read(c: &mut Criterion<CpuTime>) {
    let frames = frames();
    let folder = tempfile::tempdir().unwrap();
    let mut group = c.benchmark_group("read");
    group.throughput(Throughput::Elements(frames.len() as u64));
    for layout in LAYOUTS {
        let path = folder.path().join(format!("{}.mcap", layout.name()));
        write_to(Box::new(std::fs::File::create(&path).unwrap()), layout, &frames).unwrap();
        group.bench_function(layout.name(), |b| {
            b.iter(|| {
                let recording = Recording::open(std::slice::from_ref(&path)).unwrap();
                let count = recording.entries(Recording::ALL, |_| true).count();
                assert_eq!(count, frames.len());
            });
        });
    }
    group.finish();
}

/// From capture to the writer, with as many frames at once as a busy socket gives. Includes
/// making the frames that are pushed, a copy each.
fn queue(c: &mut Criterion<CpuTime>) {
    let frames = frames();
    let queue = Queue::new(64 << 20);
    let timeline = Timeline::start(Arc::new(SystemClock));
    let (tally, allowance) = (Arc::new(Tally::default()), Allowance::new(None));
    let mut inlet = Inlet::new(0, Unit::Frames, queue.clone(), tally, allowance, timeline);
    let (mut read, mut taken) = (Vec::new(), Vec::new());
    let mut group = c.benchmark_group("queue");
    group.throughput(Throughput::Elements(frames.len() as u64));
    group.bench_function("push and take", |b| {
        b.iter(|| {
            for some in frames.chunks(4096) {
                for one_read in some.chunks(32) {
                    read.extend_from_slice(one_read);
                    inlet.push(&mut read);
                }
                queue.take(&mut taken, usize::MAX, Duration::ZERO);
                assert_eq!(taken.len(), some.len());
                taken.clear();
            }
        });
    });
    group.finish();
}

fn frames() -> Vec<Stamped<Frame>> {
    traffic::Traffic::new().take(FRAMES).collect()
}

fn write_to(out: Box<dyn OutputFile>, layout: Layout, frames: &[Stamped<Frame>]) -> io::Result<()> {
    let options = WriterOptions { layout, ..WriterOptions::default() };
    let buses = vec![("can0".to_owned(), Facts::new())];
    let head = Head { buses, time: frames[0].time, ..Head::default() };
    let mut writer = SegmentWriter::create(out, options, &head)?;
    for frame in frames {
        writer.add(0, frame)?;
        if writer.is_full() {
            writer.cut()?;
        }
    }
    writer.finish(Facts::new())
}

/// A disk that costs nothing.
struct Counter(Arc<AtomicU64>);

impl Write for Counter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.fetch_add(bytes.len() as u64, Relaxed);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl OutputFile for Counter {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

criterion_group! {
    name = recording;
    config = Criterion::default().with_measurement(CpuTime).sample_size(20);
    targets = write, read, queue
}
criterion_main!(recording);
