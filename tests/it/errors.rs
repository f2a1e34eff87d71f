//! Error frames by class, and buses that are not there at the start.

use std::os::unix::fs::symlink;
use std::path::Path;

use bustape::frame::CanFlags;

use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, LINK_DOWN};
use crate::support::process::{args, bustape, start};
use crate::support::terminal::Device;
use crate::support::until;

fn errors(file: &Mcap) -> Vec<(u64, serde_json::Value)> {
    let all = messages::decoded(file).filter(|(m, _)| file.topic(m) == "/station/errors");
    all.map(|(message, error)| (message.time, messages::as_python(&error))).collect()
}

#[test]
fn every_error_frame_has_its_meaning_beside_it() {
    for layout in ["frame", "batch"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let bus = "station=sim:hmi-can,bus-error=0.3";
        let options = [&"--count" as &dyn AsRef<std::ffi::OsStr>, &"300", &"--layout", &layout];
        let mut all = args(&[&"record", &bus, &"-o", &path]);
        all.extend(args(&options));
        bustape(all).expect(0);
        let file = mcap::finished(&path);
        let frames = messages::cans(&file, "station").into_iter();
        let frames: Vec<_> = frames.filter(|(_, f)| f.flags.has(CanFlags::ERROR)).collect();
        let said = errors(&file);
        assert!(frames.len() > 30, "{}", frames.len());
        assert_eq!(said.len(), frames.len());
        for ((time, frame), (said_at, said)) in frames.iter().zip(&said) {
            assert_eq!(time, said_at);
            // CAN_ERR_PROT and CAN_ERR_BUSERROR, with what the data tell.
            assert_eq!(said["classes"], frame.id);
            assert!(said["protocol"] == true && said["bus_error"] == true, "{said}");
            for (name, bit) in [("bit", 1), ("form", 2), ("stuff", 4)] {
                assert_eq!(said[name] == true, frame.data()[2] == bit, "{said}");
            }
            assert_eq!(said["location"], frame.data()[3], "{said}");
            assert!(said.get("no_ack").is_none_or(|value| *value == false), "{said}");
        }
        // For a person, a program and a table.
        let info = bustape(args(&[&"info", &path])).expect(0).out;
        let words = |line: &str| line.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        let row = ["station", "bus-error", &frames.len().to_string()];
        assert!(info.lines().any(|line| words(line) == row), "{info}");
        let json = bustape(args(&[&"info", &"--json", &path])).expect(0).json();
        assert_eq!(json["errors"]["station"]["protocol"], frames.len());
        let cat = bustape(args(&[&"cat", &path, &"--topics", &"/station/errors"])).expect(0).out;
        assert_eq!(cat.lines().count(), frames.len());
        assert!(cat.contains("in CRC sequence"), "{cat}");
        let tables = folder.path().join("tables");
        bustape(args(&[&"export", &path, &"--format", &"csv", &"-o", &tables])).expect(0);
        let table = find(&tables, "errors");
        assert_eq!(table.lines().count(), frames.len() + 1, "{table}");
        assert!(table.lines().next().unwrap().contains("stuff"), "{table}");
        // Another layout does not change what they say, nor double it.
        let (new, other) =
            (folder.path().join("new.mcap"), if layout == "frame" { "batch" } else { "frame" });
        bustape(args(&[&"convert", &path, &"-o", &new, &"--layout", &other])).expect(0);
        assert_eq!(errors(&mcap::finished(&new)), said);
    }
}

/// The text of the file in a folder whose name has `part` in it.
fn find(folder: &Path, part: &str) -> String {
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.file_name().unwrap().to_string_lossy().contains(part) {
                return std::fs::read_to_string(path).unwrap();
            }
        }
    }
    panic!("no file {part} in {}", folder.display())
}

#[test]
fn a_missing_port_fails_or_is_waited_for_as_one_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (port, path) = (folder.path().join("port"), folder.path().join("a.mcap"));
    let address = format!("line={},9600,8N1", port.display());
    let ran = bustape(args(&[&"record", &address, &"-o", &path])).expect(1);
    assert!(ran.err.contains("there is no such device"), "{}", ran.err);
    assert!(!path.exists() && !path.with_extension("mcap.part").exists());

    let more = args(&[&"record", &address, &"other=sim:hmi-can", &"-o", &path, &"--json"]);
    let running = start(more.into_iter().chain(args(&[&"--missing", &"wait"])));
    let part = path.with_extension("mcap.part");
    let read = || mcap::parse(&std::fs::read(&part).ok()?, false).ok();
    // The other bus is recorded meanwhile.
    until("frames", || read()?.on("/other/raw").nth(20).map(drop));
    let mut device = Device::new();
    symlink(device.port(), &port).unwrap();
    until("the port is waited for no more", || {
        let file = read()?;
        file.on("/line/gaps").next()?;
        Some(())
    });
    until("it listens", || {
        device.say(b"hello");
        std::thread::sleep(std::time::Duration::from_millis(300));
        read()?.on("/line/raw").next().map(drop)
    });
    let ran = running.stop().expect(3);
    let file = mcap::finished(&path);
    assert_eq!(messages::gaps(&file, "line"), [(0, LINK_DOWN)]);
    let (bytes, _) = messages::streams(&file, "line");
    assert!(bytes.starts_with(b"hello"));
    let books = &ran.json()["buses"][0];
    assert_eq!((&books["outages"], &books["dropped"]), (&1.into(), &0.into()));
    assert!(ran.err.contains("it is waited for") && ran.err.contains("there it is"), "{}", ran.err);
}

#[test]
fn a_port_that_never_comes_is_one_gap_from_start_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let all = args(&[
        &"record",
        &"slcan:/no/such/adapter@500000",
        &"other=sim:hmi-can",
        &"-o",
        &path,
        &"--missing",
        &"wait",
        &"--duration",
        &"1s",
    ]);
    bustape(all).expect(3);
    let file = mcap::finished(&path);
    let gap = messages::decoded(&file).find(|(m, _)| file.topic(m) == "/adapter/gaps").unwrap().1;
    let gap = messages::as_python(&gap);
    let nanos = |key: &str| gap[key].as_u64().unwrap();
    let lasted = nanos("to_ns") - nanos("from_ns");
    assert!((800_000_000..3_000_000_000).contains(&lasted), "{lasted} ns");
}
