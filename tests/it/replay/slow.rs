//! Targets that take less than they are given, and what becomes of it.

use std::io::Read as _;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use bustape::frame::Direction;
use bustape::recording::writer::Layout;
use nix::sys::signal::Signal;
use serde_json::Value;

use super::{Controlled, Killed, MILLI, Made, lines, mixed, serial};
use crate::support::bytes::noise;
use crate::support::make::at;
use crate::support::process::{BUSTAPE, args, start};
use crate::support::terminal::open;
use crate::support::until;

#[test]
fn a_reader_of_a_terminal_that_reads_no_more_loses_bytes_and_does_not_hold_up_the_end() {
    let pieces: Vec<_> =
        (0..1000u64).map(|n| (1, at(n * MILLI, serial(Direction::Rx, &noise(n, 100))))).collect();
    let made = Made::new(Layout::Frame, &pieces);
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let mut replay = Controlled::start(&made.file, &["--to", &to, "--rate", "max"]);
    let reader = open(&tty);
    replay.ask("status", "paused at");
    replay.say("resume");
    let began = Instant::now();
    until("the end", || replay.child.0.try_wait().unwrap());
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
    let (code, report, said) = replay.end();
    drop(reader);
    let bus = &report["buses"][0];
    assert_eq!(code, 3, "{said}");
    let lost = bus["not_sent"]["not_read"].as_u64().unwrap();
    assert_eq!(bus["sent"].as_u64().unwrap() + lost, 1000, "{report}");
    // Nobody is told of CAN where there is none.
    assert!(!said.contains("acknowledges"), "{said}");
}

#[test]
fn a_reader_of_a_trace_that_is_always_behind_costs_no_memory() {
    let made = Made::new(Layout::Batch, &mixed(4000));
    let mut command = Command::new(BUSTAPE);
    command.arg("replay").arg(&made.file);
    command.args(["--to", "can0=trace:", "--rate", "max", "--loop", "400", "--json"]);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
    let mut child = Killed(child.unwrap());
    let status = format!("/proc/{}/status", child.0.id());
    let (mut read, mut most) = (0, 0);
    let mut out = child.0.stdout.take().unwrap();
    let mut buffer = vec![0; 64 << 10];
    while let Ok(length @ 1..) = out.read(&mut buffer) {
        read += length;
        let status = std::fs::read_to_string(&status).unwrap_or_default();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kib = resident.and_then(|text| text.split_whitespace().next()?.parse().ok());
        most = most.max(kib.unwrap_or(0));
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(read > 40 << 20, "{read} bytes of text");
    assert!(most < 30 << 10, "{most} KiB of memory for {read} bytes of text");
}

#[test]
fn what_is_counted_as_sent_is_written_when_a_signal_ends_it() {
    let made = Made::new(Layout::Frame, &mixed(400));
    for _ in 0..5 {
        let all = ["--to", "can0=trace:", "--rate", "max", "--loop", "forever", "--json"];
        let mut command = args(&[&"replay", &made.file]);
        command.extend(all.iter().map(Into::into));
        let running = start(command);
        std::thread::sleep(Duration::from_millis(300));
        running.signal(Signal::SIGINT);
        let ran = running.wait().expect(0);
        let report: Value = serde_json::from_str(ran.err.lines().last().unwrap()).unwrap();
        let sent = report["buses"][0]["sent"].as_u64().unwrap();
        assert_eq!(lines(&ran.out).len() as u64, sent, "{report}");
    }
}
