//! `bustape record`: what it writes, and how it ends.

use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use bustape::frame::CanFrame;
use nix::sys::signal::Signal;
use serde_json::Value;

use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, Raw};
use crate::support::person::Person;
use crate::support::process::{Ran, args, bustape, start};
use crate::support::{peers, several, station, until};

const BUSES: [&str; 2] = ["hmi-can", "zhongheng-09"];

/// Checks the books of a recording of one file: what it printed as JSON against what it holds.
pub fn balanced(ran: &Ran, file: &Mcap) {
    let summary = file.facts("bustape.summary");
    assert_eq!(ran.json()["reason"], *summary["reason"]);
    for bus in ran.json()["buses"].as_array().unwrap() {
        let name = bus["bus"].as_str().unwrap();
        let number = |key: &str| bus[key].as_u64().unwrap();
        let (received, written, dropped) =
            (number("received"), number("written"), number("dropped"));
        assert_eq!(received, written + dropped, "{bus}");
        for key in ["received", "written", "dropped"] {
            assert_eq!(summary[&format!("{name}.{key}")], number(key).to_string(), "{bus}");
        }
        assert_eq!(summary[&format!("{name}.unit")], bus["unit"].as_str().unwrap());
        assert_eq!(weight(file, name), written, "{bus}");
        let lost: u64 = messages::gaps(file, name).iter().map(|(count, _)| count).sum();
        assert_eq!(lost, dropped, "{bus}");
    }
}

/// Frames or bytes of a bus in a file.
pub fn weight(file: &Mcap, bus: &str) -> u64 {
    let raw = messages::raw(file, bus).into_iter();
    raw.map(|(_, raw)| match raw {
        Raw::Can(_) => 1,
        Raw::Rx(data) | Raw::Tx(data) => data.len() as u64,
        Raw::Gap(..) => 0,
    })
    .sum()
}

/// What every file of ours keeps to, beside what the strict reader demands of any file.
pub fn in_order(file: &Mcap, finished: bool) {
    assert_eq!(file.library, format!("bustape/{}", env!("CARGO_PKG_VERSION")));
    let names: Vec<&str> = file.metadata.iter().map(|(name, _)| name.as_str()).collect();
    let (first, rest) = names.split_first().expect("metadata");
    assert_eq!(*first, "bustape.recording");
    let buses = rest.iter().take_while(|name| name.starts_with("bustape.bus.")).count();
    assert!(buses > 0, "{names:?}");
    let end = if finished { &["bustape.clock", "bustape.summary"][..] } else { &["bustape.clock"] };
    // What was done to the file later stands behind, or just in front of the summary.
    let later = |name: &str| name.starts_with("bustape.recovery") || name == "bustape.retime";
    let ours = rest[buses..].iter().filter(|name| name.starts_with("bustape.") && !later(name));
    assert_eq!(ours.copied().collect::<Vec<_>>(), *end, "{names:?}");
    // The head comes before the first chunk, the summary after the last.
    let places = |opcode| file.records.iter().filter(move |r| r.0 == opcode).map(|r| r.1);
    let last = |opcode| places(opcode).next_back();
    if let (Some(chunk), true) = (last(6), finished) {
        assert!(last(12).unwrap() > chunk && places(12).nth(buses + 1).unwrap() < chunk);
    }
    let mut latest = BTreeMap::new();
    for message in &file.messages {
        let before = latest.insert(message.channel, message.time).unwrap_or(0);
        let topic = file.topic(message);
        assert!(before <= message.time, "{topic} goes back from {before} to {}", message.time);
    }
    // What describes the recorder itself waits for the first frame.
    let own = ["/stats", "/clock"];
    let first = file.messages.iter().min_by_key(|message| message.time);
    let first = first.map_or("", |message| file.topic(message));
    assert!(!own.iter().any(|end| first.ends_with(end)), "{first} is first");
    assert!(messages::decoded(file).count() == file.messages.len());
}

/// The station's frames are the simulation's own, from its beginning, none missing, none twice.
pub fn from_the_beginning(file: &Mcap, frames: &[(u64, CanFrame)]) {
    if frames.is_empty() {
        return;
    }
    let station = station(file, "hmi-can");
    for (number, ((_, recorded), sent)) in frames.iter().zip(station).enumerate() {
        assert_eq!(*recorded, sent, "frame {number}");
    }
}

fn record(layout: &str, file: &Path, more: &[&str]) -> Ran {
    let mut all = args(&[&"record", &"sim:hmi-can", &"sim:zhongheng-09", &"--json", &"-o", &file]);
    all.extend(["--layout", layout].iter().chain(more).map(Into::into));
    bustape(all)
}

fn in_both_layouts(work: impl Fn(&str, PathBuf) + Sync) {
    let folder = tempfile::tempdir().unwrap();
    let file = |layout: &str| folder.path().join(format!("{layout}.mcap"));
    several(vec!["frame", "batch"], |layout| work(layout, file(layout)));
}

#[test]
fn a_recording_of_some_time_holds_everything_that_was_said_in_it() {
    in_both_layouts(|layout, path| {
        let ran = record(layout, &path, &["--duration", "2500ms"]).expect(0);
        assert_eq!(ran.err, "");
        let file = mcap::finished(&path);
        balanced(&ran, &file);
        in_order(&file, true);
        assert_eq!(ran.json()["reason"], "duration");
        let frames = messages::cans(&file, "hmi-can");
        assert!(frames.len() > 20, "{} frames in 2.5 s", frames.len());
        from_the_beginning(&file, &frames);
        let (answers, questions) = messages::streams(&file, "zhongheng-09");
        assert!(!answers.is_empty() && !questions.is_empty());
        // What a kill can cost: with a chunk each 200 ms there are a dozen.
        assert!(file.chunks.len() >= 4, "{} chunks in 2.5 s", file.chunks.len());
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o640);
    });
}

#[test]
fn the_reference_readers_find_the_same_in_a_file() {
    in_both_layouts(|layout, path| {
        record(layout, &path, &["--duration", "1500ms"]).expect(0);
        let file = mcap::finished(&path);
        let info = bustape(args(&[&"info", &"--json", &path])).expect(0).json();
        let (python, node) = (peers::python_reads(&path), peers::node_reads(&path));
        assert_eq!(info["topics"].as_array().unwrap().len(), file.channels.len());
        for topic in info["topics"].as_array().unwrap() {
            let (name, count) = (topic["topic"].as_str().unwrap(), &topic["messages"]);
            assert_eq!(file.on(name).count() as u64, *count, "{name}");
            assert_eq!(python.count(name), *count, "{name}");
            assert_eq!(node.count(name), *count, "{name}");
        }
        let start = file.messages.iter().map(|m| m.time).min();
        let first =
            messages::raw(&file, BUSES[0]).into_iter().chain(messages::raw(&file, BUSES[1]));
        assert_eq!(first.map(|(time, _)| time).min(), start);
        assert_eq!(node.file["statistics"]["message_start_time"].as_u64(), start);
        assert_eq!(python.file["statistics"]["message_start_time"].as_u64(), start);
        same_messages(&file, &python.messages, &node.messages);
        let raw: usize = BUSES.iter().map(|bus| messages::raw(&file, bus).len()).sum();
        let lines = bustape(args(&[&"cat", &"--json", &path])).expect(0).out.lines().count();
        assert_eq!(lines, raw);
        let only_can = bustape(args(&[&"cat", &"-f", &"hmi-can", &path])).expect(0).out;
        assert_eq!(only_can.lines().count(), messages::cans(&file, "hmi-can").len());
    });
}

/// Every message, and every field of it.
fn same_messages(file: &Mcap, python: &[Value], node: &[Value]) {
    let key = |topic: &str, time: u64, data: String| (time, topic.to_owned(), data);
    let of = |read: &Value, data: String| {
        let data = data.trim_matches('"').to_owned();
        assert_eq!((&read["sequence"], &read["publish_time"]), (&0.into(), &read["log_time"]));
        key(read["topic"].as_str().unwrap(), read["log_time"].as_u64().unwrap(), data)
    };
    let sorted = |keys: &mut dyn Iterator<Item = (u64, String, String)>| {
        let mut keys: Vec<_> = keys.collect();
        keys.sort();
        keys
    };
    let ours = messages::decoded(file).map(|(message, decoded)| {
        let value = rounded(messages::as_python(&decoded));
        key(file.topic(message), message.time, value.to_string())
    });
    let theirs = python.iter().map(|read| of(read, rounded(read["data"].clone()).to_string()));
    same(&sorted(&mut { ours }), &sorted(&mut { theirs }));
    let ours = file.messages.iter();
    let ours = ours.map(|m| key(file.topic(m), m.time, messages::hex(&m.data)));
    let theirs = node.iter().map(|read| of(read, read["data"].to_string()));
    same(&sorted(&mut { ours }), &sorted(&mut { theirs }));
}

fn same<T: PartialEq + std::fmt::Debug>(ours: &[T], theirs: &[T]) {
    assert_eq!(ours.len(), theirs.len());
    for (ours, theirs) in ours.iter().zip(theirs) {
        assert_eq!(ours, theirs);
    }
}

/// Decimal fractions, as two libraries print and read them, differ in their last digit.
fn rounded(mut value: Value) -> Value {
    match &mut value {
        Value::Object(fields) => fields.values_mut().for_each(|v| *v = rounded(v.take())),
        Value::Array(items) => items.iter_mut().for_each(|v| *v = rounded(v.take())),
        Value::Number(n) if n.is_f64() => {
            let text = format!("{:.9e}", n.as_f64().unwrap());
            return Value::String(text);
        }
        _ => {}
    }
    value
}

#[test]
fn a_recording_of_so_many_frames_has_exactly_as_many() {
    in_both_layouts(|layout, path| {
        let ran = record(layout, &path, &["--count", "57"]).expect(0);
        let file = mcap::finished(&path);
        balanced(&ran, &file);
        assert_eq!(ran.json()["reason"], "count");
        let raw: usize = BUSES.iter().map(|bus| messages::raw(&file, bus).len()).sum();
        assert_eq!(raw, 57);
        from_the_beginning(&file, &messages::cans(&file, "hmi-can"));
    });
}

#[test]
fn every_way_to_stop_it_ends_with_a_finished_file() {
    let folder = tempfile::tempdir().unwrap();
    let signals = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP];
    let ways = signals.into_iter().flat_map(|signal| [(signal, "frame"), (signal, "batch")]);
    several(ways.collect(), |(signal, layout)| {
        let path = folder.path().join(format!("{signal}-{layout}.mcap"));
        let part = folder.path().join(format!("{signal}-{layout}.mcap.part"));
        let running = start(args(&[
            &"record",
            &"sim:hmi-can",
            &"sim:zhongheng-09",
            &"--json",
            &"--layout",
            &layout,
            &"-o",
            &path,
        ]));
        until("frames in the file", || {
            (part.exists() && !mcap::cut(&part).messages.is_empty()).then_some(())
        });
        running.signal(signal);
        let ran = running.wait().expect(0);
        assert_eq!(ran.json()["reason"], signal.as_str());
        let file = mcap::finished(&path);
        balanced(&ran, &file);
        in_order(&file, true);
        from_the_beginning(&file, &messages::cans(&file, "hmi-can"));
        assert!(!part.exists());
    });
}

#[test]
fn the_totals_are_printed_for_a_person_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let ran =
        bustape(args(&[&"record", &"can=sim:hmi-can", &"-o", &path, &"--count", &"9"])).expect(0);
    assert!(ran.out.starts_with("can: received 9 = written 9 + dropped 0 frames\n"), "{}", ran.out);
    assert!(ran.out.contains(path.to_str().unwrap()), "{}", ran.out);
    assert_eq!(ran.err, "");
    let info = bustape(args(&[&"info", &path])).expect(0);
    for part in ["No gaps.", "/can/raw", "sim:hmi-can", "count"] {
        assert!(info.out.contains(part), "{part} is missing: {}", info.out);
    }
    assert_eq!(info.err, "");
}

#[test]
fn a_terminal_that_is_stopped_does_not_stop_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let command = args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--duration", &"3s"]);
    let mut person = Person::start(command);
    person.sees(" received, 0 dropped");
    person.press("\x13");
    // It ends by itself, and only its last words wait for the person.
    until("the finished file", || path.exists().then_some(()));
    person.press("\x11");
    assert_eq!(person.wait().0, Some(0));
    let file = mcap::finished(&path);
    assert_eq!(file.facts("bustape.summary")["reason"], "duration");
    let times: Vec<u64> = messages::cans(&file, "hmi-can").iter().map(|(time, _)| *time).collect();
    let widest = times.windows(2).map(|two| two[1] - two[0]).max();
    assert!(widest.is_some_and(|nanos| nanos < 1_000_000_000), "{widest:?}");
}
