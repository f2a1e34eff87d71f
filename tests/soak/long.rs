//! A recorder that runs for long: leaks, and the seams between its files.

use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use super::adapter;
use super::disks::memory;
use super::feed::{Log, Until, talk};
use super::item::{Found, Item, Job};
use super::kills::{files, start, terminal};
use super::runs::runs;
use super::serial::plug;
use crate::record::{from_the_beginning, in_order, weight};
use crate::support::process::args;
use crate::support::{messages, until};

pub const SOAK: Item = Item {
    name: "soak",
    promise: "days without leaks: 4,000 CAN frames/s of an adapter and two serial lines, decoded, segments of 1 min, \
              the oldest deleted; memory slope at most 1 MiB/h, descriptors constant but for a segment that waits for its name, books balance (default: 8 h)",
    count: 1,
    unit: "recordings",
    side_by_side: 1,
    run: soak,
};

pub const SEAMS: Item = Item {
    name: "seams",
    promise: "a new segment each second at 4,000 records/s: each file valid alone, together nothing missing and \
              nothing twice (default: 10 min)",
    count: 1,
    unit: "recordings",
    side_by_side: 1,
    run: seams,
};

/// Time in which a recorder reaches its size.
const WARM_UP: f64 = 600.0;

/// What the recorder took at one moment.
struct Sample {
    seconds: f64,
    resident: u64,
    descriptors: usize,
}

fn sample(pid: u32, started: Instant) -> Sample {
    let descriptors = std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count);
    Sample { seconds: started.elapsed().as_secs_f64(), resident: memory(pid, "VmRSS"), descriptors }
}

/// KiB an hour, by least squares.
fn slope(samples: &[Sample]) -> f64 {
    let count = samples.len() as f64;
    let mean = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(value).sum::<f64>() / count;
    let (time, size) = (mean(&|s| s.seconds), mean(&|s| s.resident as f64));
    let covariance: f64 =
        samples.iter().map(|s| (s.seconds - time) * (s.resident as f64 - size)).sum();
    let variance: f64 = samples.iter().map(|s| (s.seconds - time).powi(2)).sum();
    if variance > 0.0 { covariance / variance * 3600.0 } else { 0.0 }
}

fn soak(job: &Job) -> Found {
    let time = job.duration.unwrap_or(Duration::from_secs(8 * 3600));
    let warm_up = WARM_UP.min(time.as_secs_f64() / 4.0);
    let (mut found, results) = runs(job, |run| {
        let (link, tty, out) =
            (run.folder.join("adapter"), run.folder.join("tty"), run.folder.join("out"));
        std::fs::create_dir(&out).unwrap();
        let stop = AtomicBool::new(false);
        let mut device = plug(&link);
        let (can, line) = (
            format!("can0=slcan:{}@500000", link.display()),
            format!("line=pty:{}", tty.display()),
        );
        std::thread::scope(|scope| {
            let _until = Until(&stop);
            let serving = scope.spawn(|| adapter::serve(&mut device, 4_000, &stop));
            let running = start(
                run.bustape,
                args(&[
                    &"record",
                    &can,
                    &line,
                    &"sim:zhongheng-09",
                    &"-d",
                    &out,
                    &"--json",
                    &"--layout",
                    &"batch",
                    &"--decode",
                    &"can0=hmi-can",
                    &"--decode",
                    &"zhongheng-09=zhongheng-09",
                    &"--split-time",
                    &"1m",
                    &"--keep-size",
                    &"64MiB",
                ]),
            );
            let talking = scope.spawn(|| {
                terminal(&tty, &stop)
                    .map_or_else(Log::default, |mut line| talk(&mut line, 500, &stop))
            });
            let (started, mut samples) = (Instant::now(), Vec::new());
            while started.elapsed() < time {
                std::thread::sleep(Duration::from_secs(10).min(time));
                samples.push(sample(running.pid(), started));
                let last = samples.last().unwrap();
                if samples.len() % 30 == 0 {
                    eprintln!(
                        "  {:.0} s: {} KiB, {} descriptors",
                        last.seconds, last.resident, last.descriptors
                    );
                }
            }
            // The line first, so that what it has said is what was received.
            stop.store(true, Relaxed);
            let log = talking.join().expect("the sender goes on");
            let cpu = cpu_seconds(running.pid());
            let ran = running.stop();
            let said = serving.join().expect("the adapter goes on");
            let json = ran.json();
            assert_eq!(ran.status.code(), Some(0), "{json} {}", ran.err);
            for bus in json["buses"].as_array().unwrap() {
                let number = |key: &str| bus[key].as_u64().unwrap();
                assert_eq!(number("received"), number("written") + number("dropped"), "{bus}");
            }
            assert_eq!(json["buses"][0]["received"], said, "frames");
            assert_eq!(json["buses"][1]["received"], log.bytes().len(), "bytes");
            let kept = files(&out);
            for (path, _) in &kept {
                assert!(
                    path.extension().is_some_and(|e| e == "mcap"),
                    "{} is not finished",
                    path.display()
                );
            }
            let bytes: u64 = kept.iter().map(|(path, _)| path.metadata().unwrap().len()).sum();
            assert!(bytes <= 66 << 20, "{bytes} bytes are kept");
            samples.retain(|s| s.seconds >= warm_up);
            (samples, said, log.bytes().len(), kept.len(), cpu / started.elapsed().as_secs_f64())
        })
    });
    for (samples, frames, bytes, kept, cpu) in results {
        let slope = slope(&samples) / 1024.0;
        let of = |value: fn(&Sample) -> u64| {
            let values: Vec<u64> = samples.iter().map(value).collect();
            (values.iter().min().copied().unwrap_or(0), values.iter().max().copied().unwrap_or(0))
        };
        let ((least, most), descriptors) = (of(|s| s.resident), of(|s| s.descriptors as u64));
        found.number(
            "time, of it behind the warm-up",
            format!(
                "{:.0} min, {:.0} min",
                time.as_secs_f64() / 60.0,
                (time.as_secs_f64() - warm_up) / 60.0
            ),
        );
        found.number(
            "recorded",
            format!("{frames} frames, {bytes} bytes of one line; {kept} segments kept at the end"),
        );
        found.number("memory, least / most behind the warm-up", format!("{least} / {most} KiB"));
        found.number("memory slope", format!("{slope:+.2} MiB/h"));
        found.number("descriptors, least / most", format!("{} / {}", descriptors.0, descriptors.1));
        found.number("processor time", format!("{:.1} % of a core", cpu * 100.0));
        found.require(slope <= 1.0, || format!("memory grows by {slope:.2} MiB/h"));
        // A segment that waits for its name has one beside the open one's.
        let constant = descriptors.1 <= descriptors.0 + 1;
        found.require(constant, || format!("descriptors {descriptors:?}"));
    }
    found
}

/// User and system time so far.
fn cpu_seconds(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    fields.get(11..13).map_or(0.0, |times| {
        times.iter().filter_map(|t| t.parse::<f64>().ok()).sum::<f64>() / 100.0
    })
}

fn seams(job: &Job) -> Found {
    let time = job.duration.unwrap_or(Duration::from_secs(600));
    let (mut found, results) = runs(job, |run| {
        let (tty, out) = (run.folder.join("tty"), run.folder.join("out"));
        std::fs::create_dir(&out).unwrap();
        let line = format!("line=pty:{}", tty.display());
        let running = start(
            run.bustape,
            args(&[
                &"record",
                &line,
                &"sim:hmi-can",
                &"-d",
                &out,
                &"--json",
                &"--split-time",
                &"1s",
            ]),
        );
        let stop = AtomicBool::new(false);
        let mut line = terminal(&tty, &stop).expect("a terminal");
        let log = std::thread::scope(|scope| {
            let _until = Until(&stop);
            let talking = scope.spawn(|| talk(&mut line, 4_000, &stop));
            std::thread::sleep(time);
            stop.store(true, Relaxed);
            talking.join().expect("the sender goes on")
        });
        let ran = running.stop().expect(0);
        let files = files(&out);
        let (mut at, mut frames) = (0, Vec::new());
        let sent = log.bytes();
        for (path, file) in &files {
            assert!(
                path.extension().is_some_and(|e| e == "mcap"),
                "{} is not finished",
                path.display()
            );
            if file.messages.is_empty() {
                continue;
            }
            in_order(file, true);
            let bytes = messages::streams(file, "line").0;
            assert!(
                sent[at..].starts_with(&bytes),
                "{} does not go on at byte {at}",
                path.display()
            );
            at += bytes.len();
            frames.extend(messages::cans(file, "hmi-can"));
        }
        assert_eq!(at, sent.len(), "the end is missing");
        from_the_beginning(&files[0].1, &frames);
        let json = ran.json();
        assert_eq!(json["buses"][0]["dropped"], 0, "{json}");
        let weighed: u64 = files.iter().map(|(_, file)| weight(file, "line")).sum();
        assert_eq!(json["buses"][0]["written"], weighed);
        (files.len(), sent.len(), frames.len())
    });
    for (files, bytes, frames) in results {
        found.number("time", format!("{} s", time.as_secs()));
        found.number("files, bytes, frames", format!("{files}, {bytes}, {frames}"));
    }
    found
}
