//! Disks that are slower than the bus.

use std::io::Write as _;
use std::time::Duration;

use crate::record::{balanced, in_order};
use crate::support::bytes::noise;
use crate::support::mcap;
use crate::support::messages::{self, RECORDER_QUEUE, Raw};
use crate::support::process::{args, start_injected};
use crate::support::terminal::open;
use crate::support::{station, until};

/// Each sync after the first takes this long, in microseconds.
const SLOW_SYNC: [&str; 2] = ["trace=fdatasync", "inject=fdatasync:delay_enter=900000:when=2+"];

/// Each write but those of the head does.
const SLOW_WRITE: [&str; 2] = ["trace=write", "inject=write:delay_enter=600000:when=8+"];

#[test]
fn bytes_that_a_slow_disk_costs_are_counted_and_placed_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let terminal = folder.path().join("tty");
    let running = start_injected(
        &SLOW_WRITE,
        &[&part],
        args(&[
            &"record",
            &format!("line=pty:{}", terminal.display()),
            &"-o",
            &path,
            &"--json",
            &"--queue",
            &"64KiB",
        ]),
    );
    let sent = noise(3, 3_000_000);
    let mut line = open(&terminal);
    for piece in sent.chunks(30_000) {
        line.write_all(piece).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    // The recorder says itself, in its statistics, how much has arrived.
    until("everything to arrive", || {
        let file = part.exists().then(|| mcap::cut(&part))?;
        let mut stats = messages::decoded(&file).filter(|(m, _)| file.topic(m) == "/line/stats");
        stats.any(|(_, s)| messages::as_python(&s)["received"] == sent.len()).then_some(())
    });
    let ran = running.stop().expect(3);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    in_order(&file, true);
    let books = &ran.json()["buses"][0];
    assert_eq!(books["received"], sent.len());
    assert_eq!(books["dropped"], books["dropped_by_reason"]["recorder_queue"]);
    // Walked along what was sent, what was recorded fits between the gaps, byte by byte.
    let mut at = 0;
    let mut gaps = 0;
    for message in &file.messages {
        let raw = match file.topic(message) {
            "/line/raw" | "/line/gaps" => message,
            _ => continue,
        };
        match one(&file, raw) {
            Raw::Rx(data) => {
                assert!(sent[at..].starts_with(&data), "{} bytes at {at}", data.len());
                at += data.len();
            }
            Raw::Gap(count, reason) => {
                assert_eq!(reason, RECORDER_QUEUE);
                at += count as usize;
                gaps += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(at, sent.len());
    assert!(gaps > 0, "the queue never ran over");
}

/// One message of a file, understood.
fn one(file: &mcap::Mcap, message: &mcap::Message) -> Raw {
    let alone = mcap::Mcap { messages: vec![message.clone()], ..file.clone() };
    messages::raw(&alone, "line").remove(0).1
}

#[test]
fn frames_that_a_slow_disk_costs_are_counted_and_placed_exactly() {
    for layout in ["frame", "batch"] {
        let folder = tempfile::tempdir().unwrap();
        let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
        let running = start_injected(
            &SLOW_WRITE,
            &[&part],
            args(&[
                &"record",
                &"can=sim:hmi-can",
                &"-o",
                &path,
                &"--json",
                &"--queue",
                &"2KiB",
                &"--layout",
                &layout,
                &"--duration",
                &"3s",
            ]),
        );
        let ran = running.wait().expect(3);
        let file = mcap::finished(&path);
        balanced(&ran, &file);
        let mut station = station(&file, "can");
        let mut gaps = 0;
        for (_, raw) in messages::raw(&file, "can") {
            match raw {
                Raw::Can(frame) => assert_eq!(Some(frame), station.next()),
                Raw::Gap(count, reason) => {
                    assert_eq!(reason, RECORDER_QUEUE);
                    for _ in 0..count {
                        station.next();
                    }
                    gaps += 1;
                }
                other => panic!("{other:?}"),
            }
        }
        assert!(gaps > 0, "the queue never ran over");
    }
}

/// With this queue, and while this is slow, nothing is lost.
fn costs_nothing(slow: &[&str], queue: &str) {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let running = start_injected(
        slow,
        &[&part],
        args(&[
            &"record",
            &"sim:hmi-can",
            &"sim:zhongheng-09",
            &"-o",
            &path,
            &"--json",
            &"--sync",
            &"100ms",
            &"--duration",
            &"2s",
            &"--queue",
            &queue,
        ]),
    );
    let ran = running.wait().expect(0);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    crate::record::from_the_beginning(&file, &messages::cans(&file, "hmi-can"));
}

#[test]
fn slow_writes_cost_nothing_while_the_queue_has_room() {
    costs_nothing(&SLOW_WRITE, "16MiB");
}

#[test]
fn slow_syncs_cost_nothing_at_all() {
    costs_nothing(&SLOW_SYNC, "2KiB");
}

#[test]
fn a_disk_that_does_not_come_after_gets_longer_segments_and_not_more_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    // A file each 300 ms, where finishing one takes a second.
    let slow = ["trace=fdatasync", "inject=fdatasync:delay_enter=1000000"];
    let options = args(&[
        &"record",
        &"sim:hmi-can",
        &"-d",
        &out,
        &"--json",
        &"--split-time",
        &"300ms",
        &"--duration",
        &"12s",
    ]);
    let running = start_injected(&slow, &[], options);
    let mut most = 0;
    let names = || crate::support::files(&out);
    until("the end", || {
        most = most.max(names().iter().filter(|name| name.ends_with(".part")).count());
        let longer = names().iter().any(|name| name.contains("_0008_"));
        longer.then_some(())
    });
    let ran = running.wait().expect(0);
    assert!((2..=8).contains(&most), "{most} files were open at once");
    let files: Vec<_> = names().iter().map(|name| mcap::finished(&out.join(name))).collect();
    assert!(files.len() < 30, "{} files", files.len());
    let frames: Vec<_> = files.iter().flat_map(|f| messages::cans(f, "hmi-can")).collect();
    assert_eq!(frames.len() as u64, ran.json()["buses"][0]["received"].as_u64().unwrap());
    crate::record::from_the_beginning(&files[0], &frames);
}
