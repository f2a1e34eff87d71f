//! received = written + dropped, whatever happens on the way, and received is what was sent.

use std::io::Write as _;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use nix::sys::signal::Signal;

use super::calls::injected;
use super::feed::{RECORD, record};
use super::item::{Found, Item, Job};
use super::kills::{files, start, terminal};
use super::runs::{Run, runs};
use crate::record::{in_order, weight};
use crate::support::mcap::Mcap;
use crate::support::messages::{self, Raw};
use crate::support::peers;
use crate::support::process::args;

pub const ITEM: Item = Item {
    name: "books",
    promise: "received = written + dropped = what was sent, with random stalls of recorder and disk, queues of 1 \
              KiB to 1 MiB, segments, and an end by SIGTERM at a random moment; every gap where it belongs",
    count: 1_000,
    unit: "recordings",
    side_by_side: 8,
    run,
};

/// What a recording has lost.
struct Books {
    sent: u64,
    dropped: u64,
    gaps: usize,
}

fn run(job: &Job) -> Found {
    peers::peers();
    let (mut found, books) = runs(job, one);
    let sum = |value: fn(&Books) -> u64| books.iter().map(value).sum::<u64>();
    let lossy = books.iter().filter(|b| b.dropped > 0).count();
    found.number(
        "bytes sent / of these dropped",
        format!("{} / {}", sum(|b| b.sent), sum(|b| b.dropped)),
    );
    found.number("recordings in which the queue ran over", lossy);
    found.number("gaps", sum(|b| b.gaps as u64));
    found
}

fn one(mut run: Run<'_>) -> Books {
    let (tty, out) = (run.folder.join("tty"), run.folder.join("out"));
    std::fs::create_dir(&out).unwrap();
    let random = &mut run.random;
    let line = format!("line=pty:{}", tty.display());
    let queue = format!("{}KiB", 1 << random.below(11));
    let layout = ["frame", "batch"][random.below(2)];
    let chunk = format!("{}ms", [5, 20, 200, 1000][random.below(4)]);
    let sync = format!("{}ms", [20, 100, 1000][random.below(3)]);
    let split = format!("{}ms", [300, 700, 60_000][random.below(3)]);
    let options = args(&[
        &"record",
        &line,
        &"sim:hmi-can",
        &"-d",
        &out,
        &"--json",
        &"--queue",
        &queue,
        &"--layout",
        &layout,
        &"--chunk-time",
        &chunk,
        &"--sync",
        &sync,
        &"--split-time",
        &split,
    ]);
    let running = match random.below(3) {
        0 => start(run.bustape, options),
        _ => {
            let call = ["fdatasync", "write"][random.below(2)];
            let delay = [5, 50, 400][random.below(3)] * 1000;
            let (first, every) = (6 + random.below(20), 1 + random.below(10));
            let inject = format!("inject={call}:delay_enter={delay}:when={first}+{every}");
            injected(run.bustape, &[&format!("trace={call}"), &inject], &[], options)
        }
    };
    let never = AtomicBool::new(false);
    let mut line = terminal(&tty, &never).expect("a terminal");
    let end = Duration::from_millis(200 + random.below(1200) as u64);
    let started = std::time::Instant::now();
    let mut number = 0;
    while started.elapsed() < end {
        // The recorder stands still now and then; the terminal holds what it does not read.
        match random.below(40) {
            0 => {
                running.signal(Signal::SIGSTOP);
                std::thread::sleep(Duration::from_millis(random.below(60) as u64));
                running.signal(Signal::SIGCONT);
            }
            1 => std::thread::sleep(Duration::from_millis(random.below(50) as u64)),
            _ => {}
        }
        let burst = 1 + random.below(200) as u64;
        let records: Vec<u8> = (number..number + burst).flat_map(record).collect();
        line.write_all(&records).expect("the terminal takes it");
        number += burst;
        std::thread::sleep(Duration::from_millis(random.below(8) as u64));
    }
    running.signal(Signal::SIGTERM);
    let ran = running.wait();
    let code = ran.status.code();
    assert!(matches!(code, Some(0 | 3)), "{ran:?}");
    let files: Vec<Mcap> = files(&out)
        .into_iter()
        .map(|(path, file)| {
            assert!(
                path.extension().is_some_and(|e| e == "mcap"),
                "{} is not finished",
                path.display()
            );
            in_order(&file, true);
            file
        })
        .collect();
    let json = ran.json();
    let mut dropped_somewhere = false;
    for bus in json["buses"].as_array().unwrap() {
        let name = bus["bus"].as_str().unwrap();
        let number = |key: &str| bus[key].as_u64().unwrap();
        assert_eq!(number("received"), number("written") + number("dropped"), "{bus}");
        let found: u64 = files.iter().map(|file| weight(file, name)).sum();
        assert_eq!(found, number("written"), "{bus}");
        dropped_somewhere |= number("dropped") > 0;
    }
    assert_eq!(code == Some(3), dropped_somewhere, "{json}");
    let books = &json["buses"][0];
    let sent = number * RECORD as u64;
    assert_eq!(books["received"].as_u64(), Some(sent), "received is not what was sent: {books}");
    let gaps = in_its_place(&files, number);
    Books { sent, dropped: books["dropped"].as_u64().unwrap(), gaps }
}

/// Walked along what was sent, what was recorded fits between the gaps, byte by byte. Returns how
/// many gaps there are.
fn in_its_place(files: &[Mcap], records: u64) -> usize {
    let sent: Vec<u8> = (0..records).flat_map(record).collect();
    let (mut at, mut gaps) = (0, 0);
    for file in files {
        for raw in in_file_order(file) {
            match raw {
                Raw::Rx(data) => {
                    assert!(
                        sent[at..].starts_with(&data),
                        "{} bytes at {at} of {}",
                        data.len(),
                        sent.len()
                    );
                    at += data.len();
                }
                Raw::Gap(count, _) => {
                    at += count as usize;
                    gaps += usize::from(count > 0);
                }
                other => panic!("{other:?}"),
            }
        }
    }
    assert_eq!(at, sent.len(), "bytes without a trace at the end");
    gaps
}

/// What is on the line, in the order of the file.
fn in_file_order(file: &Mcap) -> Vec<Raw> {
    let of_line = |m: &&crate::support::mcap::Message| {
        let topic = file.topic(m);
        topic == "/line/raw" || topic == "/line/gaps"
    };
    let mut one = Mcap { messages: Vec::new(), ..file.clone() };
    file.messages
        .iter()
        .filter(of_line)
        .map(|message| {
            one.messages = vec![message.clone()];
            messages::raw(&one, "line").remove(0).1
        })
        .collect()
}
