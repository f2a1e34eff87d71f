//! Told to end with much in the queue: everything is in a finished file.

use std::io::Write as _;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use super::calls::injected;
use super::feed::record;
use super::item::{Found, Item, Job, spread};
use super::kills::terminal;
use super::runs::{Run, runs};
use crate::record::{balanced, in_order};
use crate::support::process::args;
use crate::support::{mcap, messages, peers};

const SIGNALS: [Signal; 3] = [Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP];

/// What was promised for the end of a recording on a disk with syncs of 50 ms.
const SOON: Duration = Duration::from_secs(2);

pub const ITEM: Item = Item {
    name: "signals",
    promise: "SIGTERM, SIGINT and SIGHUP with 2 MB just sent, syncs and writes of 50 ms, a second signal while \
              finishing: a finished file with everything that was sent, exit status 0, within 2 s",
    count: 300,
    unit: "ends",
    side_by_side: 4,
    run,
};

fn run(job: &Job) -> Found {
    peers::peers();
    let (mut found, times) = runs(job, one);
    let mut times: Vec<f64> = times.iter().map(|time| time.as_secs_f64() * 1e3).collect();
    let (p50, max) = spread(&mut times, 0.5);
    found.number("from the signal to the end, p50 / max", format!("{p50:.0} / {max:.0} ms"));
    found
}

fn one(mut run: Run<'_>) -> Duration {
    let (tty, path) = (run.folder.join("tty"), run.folder.join("a.mcap"));
    let line = format!("line=pty:{}", tty.display());
    let options =
        args(&[&"record", &line, &"sim:hmi-can", &"-o", &path, &"--json", &"--queue", &"64MiB"]);
    let slow = "inject=fdatasync,write:delay_enter=50000";
    let running = injected(
        run.bustape,
        &["trace=fdatasync,write", slow],
        &[&run.folder.join("a.mcap.part")],
        options,
    );
    let mut line = terminal(&tty, &AtomicBool::new(false)).expect("a terminal");
    std::thread::sleep(Duration::from_millis(100 + run.random.below(200) as u64));
    let sent: Vec<u8> = (0..131_072).flat_map(record).collect();
    line.write_all(&sent).expect("the terminal takes it");
    let signal = SIGNALS[(run.number % 3) as usize];
    let told = Instant::now();
    running.signal(signal);
    if run.random.below(2) == 0 {
        std::thread::sleep(Duration::from_millis(run.random.below(80) as u64));
        running.signal(SIGNALS[run.random.below(3)]);
    }
    let ran = running.wait().expect(0);
    let took = told.elapsed();
    assert_eq!(ran.json()["reason"], signal.as_str());
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    in_order(&file, true);
    assert!(messages::streams(&file, "line").0 == sent, "not everything that was sent");
    assert!(took <= SOON, "it took {took:?}");
    took
}
