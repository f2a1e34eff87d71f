//! What the tests share.

pub mod adapter;
pub mod bytes;
pub mod capture;
pub mod line_protocol;
pub mod make;
pub mod mcap;
pub mod messages;
pub mod peers;
pub mod person;
pub mod process;
pub mod terminal;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use bustape::frame::CanFrame;
use bustape::simulate::hmi_can::HmiCan;

/// How long anything may take before a test gives up. Nothing waits this long unless it is broken.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// Returns what `look` finds, as soon as it finds something.
pub fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < end, "waited {PATIENCE:?} for {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// What the simulated station of a recording says, from its beginning.
pub fn station(file: &mcap::Mcap, bus: &str) -> impl Iterator<Item = CanFrame> + use<> {
    let facts = file.facts(&format!("bustape.bus.{bus}"));
    let (seed, scale) = (facts["seed"].parse().unwrap(), facts["time_scale"].parse().unwrap());
    HmiCan::new(seed, scale).map(|(_, frame)| frame)
}

/// Runs `work` for each item, a few at a time: most of them wait more than they work.
pub fn several<T: Send, R: Send>(items: Vec<T>, work: impl Fn(T) -> R + Sync) -> Vec<R> {
    let mut results = Vec::new();
    let mut rest = items;
    while !rest.is_empty() {
        let batch: Vec<T> = rest.drain(..rest.len().min(5)).collect();
        results.extend(std::thread::scope(|scope| {
            let running: Vec<_> = batch.into_iter().map(|i| scope.spawn(|| work(i))).collect();
            let done = running.into_iter().map(std::thread::ScopedJoinHandle::join);
            done.map(|r| r.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect::<Vec<R>>()
        }));
    }
    results
}

/// All files in a folder and below.
pub fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(inside).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned());
            }
        }
    }
    found.sort();
    found
}
