//! Windows around triggers: each a recording of its own, with everything that happened in it.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use crate::support::bytes::noise;
use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, Raw};
use crate::support::process::{BUSTAPE, Ran, Running, args, spawn};
use crate::support::terminal::open;
use crate::support::{make::SECOND, until};

fn here(folder: &Path, args: Vec<std::ffi::OsString>) -> Running {
    let mut command = Command::new(BUSTAPE);
    command.args(args).env("RUNTIME_DIRECTORY", folder).env_remove("XDG_RUNTIME_DIR");
    spawn(command)
}

/// A recorder of a simulated station and a line, with `more` in its configuration.
fn recorder(folder: &Path, more: &str) -> Running {
    let (dir, tty) = (folder.join("rec"), folder.join("tty"));
    std::fs::create_dir_all(&dir).unwrap();
    let file = folder.join("plant.toml");
    let text = format!(
        "bus = [\"station=sim:hmi-can\", \"line=pty:{}\"]\ndecode = [\"station=hmi-can\"]\n\
         dir = \"{}\"\nname = \"plant\"\n{more}",
        tty.display(),
        dir.display()
    );
    std::fs::write(&file, text).unwrap();
    here(folder, args(&[&"record", &"--json", &"--config", &file]))
}

fn mark(folder: &Path, text: &str) {
    here(folder, args(&[&"mark", &text])).wait().expect(0);
}

/// Waits until so many frames of the station have come.
fn received(folder: &Path, frames: u64) {
    until("frames", || {
        let ran = here(folder, args(&[&"status", &"--json"])).wait();
        let status = ran.status.success().then(|| ran.json()[0].clone())?;
        (status["buses"][0]["received"].as_u64()? >= frames).then_some(())
    });
}

/// The files in a folder, by name.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.is_file());
    files.sort();
    files
}

fn windows(folder: &Path) -> Vec<PathBuf> {
    files(&folder.join("rec/windows"))
}

/// From when to when a window goes, by its own word.
fn span(window: &Mcap) -> (u64, u64) {
    let facts = window.facts("bustape.summary");
    (facts["window_from_ns"].parse().unwrap(), facts["window_to_ns"].parse().unwrap())
}

fn within(mcap: &Mcap, bus: &str, (from, to): (u64, u64)) -> Vec<(u64, Raw)> {
    let all = messages::raw(mcap, bus).into_iter();
    all.filter(|(time, _)| (from..=to).contains(time)).collect()
}

/// The decoded messages of a range of time, by topic.
fn decoded(mcap: &Mcap, (from, to): (u64, u64)) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let mut all = BTreeMap::<String, Vec<(u64, Vec<u8>)>>::new();
    for message in &mcap.messages {
        let channel = &mcap.channels[&message.channel];
        if channel.metadata.contains_key("protocol") && (from..=to).contains(&message.time) {
            let of_topic = all.entry(channel.topic.clone()).or_default();
            of_topic.push((message.time, message.data.clone()));
        }
    }
    all
}

fn balanced(window: &Mcap) {
    let facts = window.facts("bustape.summary");
    for bus in ["station", "line"] {
        let number = |key: &str| facts[&format!("{bus}.{key}")].parse::<u64>().unwrap();
        assert_eq!(number("received"), number("written") + number("dropped"), "{facts:?}");
        assert_eq!(number("written"), number("segment_written"), "{facts:?}");
        let found = messages::raw(window, bus).into_iter().map(|(_, raw)| match raw {
            Raw::Can(_) => 1,
            Raw::Rx(data) | Raw::Tx(data) => data.len() as u64,
            Raw::Gap(..) => 0,
        });
        assert_eq!(found.sum::<u64>(), number("written"), "{bus}: {facts:?}");
    }
}

fn events(file: &Mcap) -> Vec<(u64, String)> {
    let all = messages::decoded(file).filter(|(m, _)| file.topic(m) == "/bustape/event");
    let name = |event| messages::as_python(&event)["event_type"]["name"].as_str().unwrap().into();
    all.map(|(message, event)| (message.time, name(event))).collect()
}

/// What `work` does while a line is being talked on.
fn with_talk(folder: &Path, work: impl FnOnce()) {
    let mut line = open(&folder.join("tty"));
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut number = 0u32;
            while !done.load(std::sync::atomic::Ordering::Relaxed) {
                line.write_all(&number.to_be_bytes()).ok();
                number += 1;
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        work();
        done.store(true, std::sync::atomic::Ordering::Relaxed);
    });
}

#[test]
fn a_window_holds_exactly_what_the_continuous_recording_has_of_its_time() {
    for layout in ["frame", "batch"] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let running = recorder(
            folder,
            &format!(
                "layout = \"{layout}\"\n[[trigger]]\nname = \"by hand!\"\nwhen = \"mark\"\n\
                 before = \"900ms\"\nafter = \"600ms\"\n"
            ),
        );
        with_talk(folder, || {
            received(folder, 100);
            // The first two overlap.
            mark(folder, "one");
            mark(folder, "two");
            std::thread::sleep(Duration::from_millis(2500));
            mark(folder, "three");
            std::thread::sleep(Duration::from_millis(800));
        });
        let ran = running.stop().expect(0);
        let whole = files(&folder.join("rec"));
        assert_eq!(whole.len(), 1, "{whole:?}");
        let whole = mcap::finished(&whole[0]);
        let found = windows(folder);
        assert_eq!(found.len(), 2, "{found:?}: {}", ran.err);
        let marks: Vec<u64> =
            events(&whole).into_iter().filter(|e| e.1 == "mark").map(|e| e.0).collect();
        let asked = [(marks[0], marks[1]), (marks[2], marks[2])];
        for (number, (path, (first, last))) in found.iter().zip(asked).enumerate() {
            let window = mcap::finished(path);
            let span = span(&window);
            assert_eq!(span, (first - 900_000_000, last + 600_000_000));
            balanced(&window);
            for bus in ["station", "line"] {
                let expected = within(&whole, bus, span);
                assert!(expected.len() > 10, "{bus}: {}", expected.len());
                assert_eq!(messages::raw(&window, bus), expected, "{layout} {bus}");
            }
            // Also what the frames mean; only messages of several frames need their beginning.
            let mut expected = decoded(&whole, span);
            let found = decoded(&window, span);
            expected.retain(|topic, _| found.contains_key(topic) || !topic.contains("modbus"));
            assert!(found.len() > 10, "{}", found.len());
            for (topic, messages) in &found {
                if messages.len() == expected[topic].len() {
                    assert_eq!(messages, &expected[topic], "{topic}");
                }
            }
            // Clocks, statistics and events are there, and a head as in every segment.
            assert!(window.on("/station/stats").next().is_some());
            assert!(window.on("/bustape/clock").next().is_some());
            let named = events(&window).into_iter().filter(|e| e.1 == "by hand!").count();
            assert_eq!(named, 2 - number);
            let facts = window.facts("bustape.recording");
            assert_eq!(facts["session_id"], whole.facts("bustape.recording")["session_id"]);
            assert_eq!(window.facts("bustape.window")["trigger"], "by hand!");
            assert!(window.attachments.iter().any(|a| a.name == "hmi-can.dbc"));
            let name = path.file_name().unwrap().to_str().unwrap();
            let (start, end) = (format!("plant_s0001_{:04}_", number + 1), "Z_by-hand.mcap");
            assert!(name.starts_with(&start) && name.ends_with(end), "{name}");
        }
        assert_eq!(ran.json()["windows"].as_array().unwrap().len(), 2);
        assert_eq!(ran.json()["buses"][0]["outside"], 0);
    }
}

#[test]
fn where_only_windows_are_kept_the_books_name_what_was_outside() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let running = recorder(
        folder,
        "windows-only = true\n[[trigger]]\nwhen = \"mark\"\nbefore = \"200ms\"\nafter = \"200ms\"\n\
         [[trigger]]\nname = \"longer\"\nwhen = \"mark\"\nbefore = \"500ms\"\n",
    );
    with_talk(folder, || {
        received(folder, 200);
        std::thread::sleep(Duration::from_millis(600));
        mark(folder, "one");
        std::thread::sleep(Duration::from_millis(700));
    });
    let ran = running.stop().expect(0);
    assert_eq!(files(&folder.join("rec")), Vec::<PathBuf>::new(), "nothing but windows");
    let found = windows(folder);
    assert_eq!(found.len(), 1, "{found:?}");
    let window = mcap::finished(&found[0]);
    balanced(&window);
    // Of the two that overlap the longer one counts on either side.
    let (from, to) = span(&window);
    let time: u64 = window.facts("bustape.window")["fired_ns"].parse().unwrap();
    assert_eq!((time - from, to - time), (500_000_000, 200_000_000));
    let first = messages::raw(&window, "line")[0].0;
    assert!(first < time - 200_000_000, "it has what came before the shorter one");
    for (index, bus) in ["station", "line"].into_iter().enumerate() {
        let books = &ran.json()["buses"][index];
        let number = |key: &str| books[key].as_u64().unwrap();
        assert_eq!(number("received"), number("written") + number("outside"), "{books}");
        assert_eq!(number("dropped"), 0);
        let written = &window.facts("bustape.summary")[&format!("{bus}.written")];
        assert_eq!(number("written").to_string(), *written);
        assert!(number("outside") > 20, "{books}");
    }
}

#[test]
fn what_had_left_the_memory_is_counted_and_said_in_the_window() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let running = recorder(
        folder,
        "window-memory = \"256KiB\"\n[[trigger]]\nwhen = \"line: no frames for 500ms\"\n\
         hold-off = \"1h\"\nbefore = \"1h\"\n",
    );
    let mut line = open(&folder.join("tty"));
    let sent = noise(3, 1 << 20);
    for piece in sent.chunks(4096) {
        line.write_all(piece).unwrap();
    }
    until("the window", || windows(folder).first().map(drop));
    let ran: Ran = running.stop().expect(3);
    let window = mcap::finished(&windows(folder)[0]);
    let gaps = messages::gaps(&window, "line");
    let lost: u64 = gaps.iter().map(|(count, _)| count).sum();
    assert!(lost > 700 << 10 && gaps.iter().all(|(_, why)| *why == 7), "{gaps:?}");
    let facts = window.facts("bustape.summary");
    assert_eq!(facts["line.dropped.window_memory"], lost.to_string());
    assert_eq!(facts["line.received"], (1u64 << 20).to_string());
    balanced(&window);
    let (bytes, _) = messages::streams(&window, "line");
    assert!(sent.ends_with(&bytes), "what is there is the end of what was sent");
    // The continuous recording has lost nothing.
    assert_eq!(ran.json()["buses"][1]["dropped"], 0);
}

/// What of the line is in a window: all that was said up to its end and from its beginning on, as bytes and
/// gaps in their order.
fn accounted(window: &Mcap, sent: u64) {
    let facts = window.facts("bustape.summary");
    let number = |key: &str| facts[key].parse::<u64>().unwrap();
    balanced(window);
    let gaps: u64 = messages::gaps(window, "line").iter().map(|(count, _)| count).sum();
    let bytes = messages::streams(window, "line").0.len() as u64;
    assert_eq!(number("line.received"), bytes + gaps);
    assert_eq!(bytes + gaps, sent);
}

#[test]
fn what_a_second_firing_reaches_and_the_memory_lost_in_between_is_a_gap() {
    for more in ["", "windows-only = true\n"] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let text = format!(
            "{more}window-memory = \"256KiB\"\n[[trigger]]\nwhen = \"mark\"\nbefore = \"1h\"\nafter = \"1s\"\n"
        );
        let running = recorder(folder, &text);
        received(folder, 1);
        let mut line = open(&folder.join("tty"));
        mark(folder, "one");
        line.write_all(&noise(1, 20_000)).unwrap();
        // The window of the first is over, and what comes then is more than the memory takes.
        let part = until("the end of the first window", || {
            let part = windows(folder).into_iter().next()?;
            let file = mcap::parse(&std::fs::read(&part).ok()?, false).ok()?;
            (file.on("/line/raw").count() > 0).then_some(part)
        });
        std::thread::sleep(Duration::from_millis(1500));
        for piece in noise(2, 1 << 20).chunks(4096) {
            line.write_all(piece).unwrap();
        }
        let all = 20_000 + (1 << 20);
        until("all of it", || {
            let ran = here(folder, args(&[&"status", &"--json"])).wait();
            let status = ran.status.success().then(|| ran.json()[0].clone())?;
            (status["buses"][1]["received"].as_u64()? >= all).then_some(())
        });
        mark(folder, "two");
        std::thread::sleep(Duration::from_millis(500));
        let ran = running.stop().expect(3);
        let window = mcap::finished(&windows(folder)[0]);
        assert!(part.starts_with(folder), "{part:?}");
        assert_eq!(window.facts("bustape.summary")["window_firings"], "2");
        accounted(&window, all);
        assert!(
            messages::gaps(&window, "line")
                .iter()
                .any(|(count, why)| *count > 500_000 && *why == 7)
        );
        if !more.is_empty() {
            let books = &ran.json()["buses"][1];
            assert!(books["dropped"].as_u64() > Some(500_000), "{books}");
        }
    }
}

#[test]
fn a_window_cut_off_by_a_kill_is_recovered_as_any_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = "[[trigger]]\nwhen = \"mark\"\nbefore = \"10s\"\nafter = \"1h\"\n";
    let running = recorder(folder, text);
    received(folder, 100);
    mark(folder, "now");
    // The mark, and the trigger that it has set off.
    let part = until("frames and events in the window", || {
        let part = windows(folder).into_iter().next()?;
        let file = mcap::parse(&std::fs::read(&part).ok()?, false).ok()?;
        let (frames, events) = (file.on("/station/raw"), file.on("/bustape/event"));
        (frames.count() > 150 && events.count() == 2).then_some(part)
    });
    running.kill();
    assert!(part.to_str().unwrap().ends_with("_mark.mcap.part"), "{part:?}");
    // Its number may be somebody else's terminal by now.
    std::fs::remove_file(folder.join("tty")).unwrap();
    let running = recorder(folder, text);
    let recovered = until("the recovery", || {
        let mut found = windows(folder).into_iter();
        found.find(|path| path.extension().is_some_and(|e| e == "mcap"))
    });
    running.stop().expect(0);
    let file = mcap::finished(&recovered);
    assert_eq!(file.facts("bustape.window")["trigger"], "mark");
    assert!(file.on("/station/raw").count() > 150);
    // A trigger called as marks are does not set itself off.
    assert_eq!(file.on("/bustape/event").count(), 2);
    let span = file.messages.iter().map(|m| m.time);
    assert!(span.clone().max().unwrap() - span.min().unwrap() < 60 * SECOND);
}

#[test]
fn windows_that_could_never_be_are_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (more, sentence) in [
        ("[[trigger]]\nwhen = \"gap\"\nbefore = \"soon\"\n", "is not a duration"),
        ("windows-only = true\n[[trigger]]\nwhen = \"gap\"\n", "nothing would be kept"),
        ("window-memory = \"1KiB\"\n", "is not between 256KiB and 4GiB"),
    ] {
        let ran = recorder(folder, more).wait().expect(2);
        assert!(ran.err.contains(sentence), "{more}: {}", ran.err);
    }
    let file = folder.join("b.toml");
    let text = "bus = [\"sim:hmi-can\"]\noutput = \"b.mcap\"\n[[trigger]]\nwhen = \"gap\"\nafter = \"1s\"\n";
    std::fs::write(&file, text).unwrap();
    let ran = here(folder, args(&[&"record", &"--config", &file])).wait().expect(2);
    assert!(ran.err.contains("record with --dir instead of --output"), "{}", ran.err);
    assert!(windows(folder).is_empty());
}
