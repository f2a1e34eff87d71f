//! Recordings in several files.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use bustape::frame::{CanFlags, CanFrame, Frame};
use bustape::recording::writer::Layout;

use crate::record::{from_the_beginning, in_order};
use crate::support::bytes::noise;
use crate::support::make::{START, at, head, make_with};
use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{args, bustape, start};
use crate::support::terminal::open;
use crate::support::{several, until};

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Reads all segments and checks what holds for each of them and between them.
fn read(paths: &[PathBuf]) -> Vec<Mcap> {
    let files: Vec<Mcap> = paths.iter().map(|path| mcap::finished(path)).collect();
    let mut sessions = BTreeSet::new();
    let mut end = 0;
    for (number, file) in (1..).zip(&files) {
        in_order(file, true);
        let facts = file.facts("bustape.recording");
        assert_eq!(facts["segment"], number.to_string());
        sessions.insert(facts["session_id"].clone());
        // The rest of a bus's last read may share its time with the first of the next segment.
        let times = || file.messages.iter().filter(|m| file.topic(m).ends_with("/raw"));
        // The last one may have been begun when all was over.
        if times().count() > 0 || number < files.len() {
            assert!(times().map(|m| m.time).min().unwrap() >= end, "segment {number} begins early");
            end = times().map(|m| m.time).max().unwrap();
        }
        let reason = &file.facts("bustape.summary")["reason"];
        assert_eq!(reason == "split", number < files.len(), "segment {number}: {reason}");
    }
    assert_eq!(sessions.len(), 1);
    files
}

#[test]
fn segments_by_time_are_each_whole_and_together_miss_nothing() {
    let folder = tempfile::tempdir().unwrap();
    several(vec!["frame", "batch"], |layout| {
        let folder = folder.path().join(layout);
        std::fs::create_dir(&folder).unwrap();
        let ran = bustape(args(&[
            &"record",
            &"sim:hmi-can",
            &"sim:zhongheng-09",
            &"-d",
            &folder,
            &"--name",
            &"plant",
            &"--json",
            &"--layout",
            &layout,
            &"--split-time",
            &"400ms",
            &"--duration",
            &"2200ms",
        ]));
        let ran = ran.expect(0).json();
        let paths: Vec<PathBuf> =
            ran["files"].as_array().unwrap().iter().map(|p| p.as_str().unwrap().into()).collect();
        assert!(paths.len() >= 3, "{ran}");
        let files = read(&paths);
        for (number, name) in (1..).zip(names(&folder)) {
            let start = format!("plant_s0001_{number:04}_2");
            let end = name.strip_prefix(&start).unwrap_or_else(|| panic!("{name}, not {start}"));
            assert!(end.ends_with("Z.mcap") && end.len() == "0261122T031500Z.mcap".len(), "{name}");
            assert_eq!(folder.join(&name), paths[number - 1]);
        }
        let frames: Vec<_> = files.iter().flat_map(|f| messages::cans(f, "hmi-can")).collect();
        assert_eq!(ran["buses"][0]["received"], frames.len());
        assert_eq!(ran["buses"][0]["written"], frames.len());
        from_the_beginning(&files[0], &frames);
        as_one(&folder, &paths, frames.len());
    });
}

/// `info` and `cat` take a folder, or its files in any order, for one recording.
fn as_one(folder: &Path, paths: &[PathBuf], frames: usize) {
    let info = bustape(args(&[&"info", &"--json", &folder])).expect(0).json();
    assert_eq!(info["segments"].as_array().unwrap().len(), paths.len());
    assert_eq!(info["buses"].as_array().unwrap().len(), 2);
    assert_eq!(info["buses"][0]["totals"]["written"], frames.to_string());
    let cat = bustape(args(&[&"cat", &"-N", &folder])).expect(0).out;
    assert_eq!(cat.lines().filter(|line| line.contains(" hmi-can ")).count(), frames);
    let mut reversed = args(&[&"cat", &"-N"]);
    reversed.extend(paths.iter().rev().map(Into::into));
    assert_eq!(bustape(reversed).expect(0).out, cat);
    let one = folder.join("one.mcap");
    bustape(args(&[&"convert", &folder, &"-o", &one])).expect(0);
    assert_eq!(bustape(args(&[&"cat", &"-N", &one])).expect(0).out, cat);
    mcap::finished(&one);
}

#[test]
fn segments_by_size_share_out_a_serial_line_byte_by_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (terminal, out) = (folder.path().join("tty"), folder.path().join("rec"));
    std::fs::create_dir(&out).unwrap();
    let running = start(args(&[
        &"record",
        &format!("line=pty:{}", terminal.display()),
        &"-d",
        &out,
        &"--split-size",
        &"64KiB",
        &"--json",
        &"--chunk-time",
        &"20ms",
    ]));
    let sent = noise(7, 400_000);
    let mut line = open(&terminal);
    for piece in sent.chunks(10_000) {
        std::io::Write::write_all(&mut line, piece).unwrap();
        std::thread::sleep(Duration::from_millis(25));
    }
    // Seen from outside: one file is open, the others are finished under their names.
    let seen = names(&out);
    let open = seen.iter().filter(|name| name.ends_with(".mcap.part")).count();
    assert_eq!(open, 1, "{seen:?}");
    let finished = seen.iter().map(|name| name.strip_suffix(".part").unwrap_or(name));
    assert!(finished.into_iter().all(|name| name.strip_suffix("Z.mcap").is_some()), "{seen:?}");
    let info = bustape(args(&[&"info", &out])).expect(0);
    assert!(info.out.contains("NOT FINISHED") && info.err.contains("still running"), "{info:?}");
    until("every byte in the files", || {
        let files = names(&out).into_iter().map(|name| mcap_at(&out.join(name)));
        let bytes: usize =
            files.map(|f| f.map_or(0, |f| messages::streams(&f, "line").0.len())).sum();
        (bytes == sent.len()).then_some(())
    });
    let ran = running.stop().expect(0).json();
    let paths: Vec<PathBuf> = names(&out).iter().map(|name| out.join(name)).collect();
    assert!(paths.len() >= 3, "{paths:?}");
    let files = read(&paths);
    let got: Vec<u8> = files.iter().flat_map(|f| messages::streams(f, "line").0).collect();
    assert!(got == sent, "{} bytes of {}", got.len(), sent.len());
    assert_eq!(ran["buses"][0]["written"], sent.len());
    for path in &paths[..paths.len() - 1] {
        // A size is a wish: the chunk that crosses it still belongs to the segment.
        assert!(std::fs::metadata(path).unwrap().len() < 4 * (64 << 10), "{}", path.display());
    }
}

/// A file that may be finished, and get its name, between two looks at it.
fn mcap_at(path: &Path) -> Option<Mcap> {
    let bytes = std::fs::read(path).ok()?;
    Some(mcap::parse(&bytes, false).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
}

#[test]
fn with_one_output_file_the_number_stands_in_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("night.mcap");
    bustape(args(&[
        &"record",
        &"sim:hmi-can",
        &"-o",
        &path,
        &"--split-time",
        &"300ms",
        &"--duration",
        &"1500ms",
    ]))
    .expect(0);
    let found = names(folder.path());
    assert!(found.len() >= 2, "{found:?}");
    for (number, name) in (1..).zip(&found) {
        assert_eq!(*name, format!("night_{number:04}.mcap"));
    }
    read(&found.iter().map(|name| folder.path().join(name)).collect::<Vec<_>>());
}

#[test]
fn recordings_in_one_folder_are_numbered() {
    let folder = tempfile::tempdir().unwrap();
    for number in 1..=2 {
        bustape(args(&[&"record", &"sim:hmi-can", &"-d", &folder.path(), &"--count", &"3"]))
            .expect(0);
        let found = names(folder.path());
        assert!(found[number - 1].starts_with(&format!("bustape_s{number:04}_0001_")), "{found:?}");
    }
}

#[test]
fn the_books_of_several_recordings_are_added_up_and_what_has_none_is_marked() {
    let folder = tempfile::tempdir().unwrap();
    let frame = |n| at(n, Frame::Can(CanFrame::new(1, CanFlags::default(), &[])));
    let write = |name: &str, buses: &[&str], frames: u64, more: &[(&str, &str)]| {
        let mut head = head(buses);
        head.recording.insert("session_id".to_owned(), name.to_owned());
        let frames: Vec<_> = (0..frames).map(|n| (0, frame(n))).collect();
        let path = folder.path().join(name);
        make_with(&path, Layout::Frame, &head, &frames, more);
        path
    };
    let (seventy_nine, sixty) = (("can0.received", "79"), ("can1.received", "60"));
    let one = write("one.mcap", &["can0", "can1"], 79, &[seventy_nine, sixty]);
    let two = write("two.mcap", &["can0"], 137, &[("can0.received", "137")]);
    let info = bustape(args(&[&"info", &"--json", &one, &two])).expect(0).json();
    let received = |info: &serde_json::Value, bus: usize| {
        let bus = &info["buses"][bus];
        (bus["totals"]["received"].as_str().unwrap().to_owned(), bus["complete"] == true)
    };
    assert_eq!(received(&info, 0), ("216".to_owned(), true));
    assert_eq!(received(&info, 1), ("60".to_owned(), true));
    // Made one file of, they are as many.
    let both = folder.path().join("both.mcap");
    bustape(args(&[&"convert", &one, &two, &"-o", &both])).expect(0);
    assert_eq!(mcap::finished(&both).facts("bustape.summary")["can0.received"], "216");

    let three = write("three.mcap", &["can0"], 500, &[("can0.received", "500")]);
    let bytes = std::fs::read(&three).unwrap();
    std::fs::write(&three, &bytes[..bytes.len() / 2]).unwrap();
    let info = bustape(args(&[&"info", &"--json", &one, &two, &three])).expect(0).json();
    assert_eq!(received(&info, 0), ("216".to_owned(), false));
    assert_eq!(received(&info, 1), ("60".to_owned(), true));
    let shown = bustape(args(&[&"info", &one, &two, &three])).expect(0).out;
    assert!(shown.contains(" 216+ ") && shown.contains(" 60 "), "{shown}");
}

#[test]
fn the_final_totals_are_those_of_the_last_segment_even_if_nothing_is_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let frame = at(0, Frame::Can(CanFrame::new(1, CanFlags::default(), &[])));
    for (number, written, frames) in [(1, "1", &[(0, frame)][..]), (2, "7", &[])] {
        let mut head = head(&["can0"]);
        // What can be known of a segment's time when it has no message.
        head.clock.insert("log_time_ns".to_owned(), (START + number).to_string());
        let path = folder.path().join(format!("{number}.mcap"));
        make_with(&path, Layout::Frame, &head, frames, &[("can0.written", written)]);
    }
    let info = bustape(args(&[&"info", &"--json", &folder.path()])).expect(0).json();
    assert_eq!(info["buses"][0]["totals"]["written"], "7");
}
