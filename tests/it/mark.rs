//! Marks and the status of a running recorder.

use std::ffi::OsStr;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{BUSTAPE, Ran, Running, args, bustape, spawn};
use crate::support::until;

/// `bustape` whose recorders are in `folder`.
fn here<S: AsRef<OsStr>>(folder: &Path, args: impl IntoIterator<Item = S>) -> Running {
    let mut command = Command::new(BUSTAPE);
    command.args(args).env("RUNTIME_DIRECTORY", folder).env_remove("XDG_RUNTIME_DIR");
    spawn(command)
}

fn recorder(folder: &Path, name: &str, more: &[&str]) -> Running {
    let mut all = args(&[&"record", &"station=sim:hmi-can", &"-d", &folder, &"--name", &name]);
    all.extend(more.iter().map(Into::into));
    here(folder, all)
}

fn status(folder: &Path, name: &str) -> Option<serde_json::Value> {
    let ran = here(folder, ["status", "--json", "--name", name]).wait();
    ran.status.success().then(|| ran.json()[0].clone())
}

fn mark(folder: &Path, more: &[&str]) -> Ran {
    here(folder, ["mark"].iter().chain(more)).wait()
}

fn events(file: &Mcap) -> Vec<(u64, serde_json::Value)> {
    let all = messages::decoded(file).filter(|(m, _)| file.topic(m) == "/bustape/event");
    all.map(|(message, event)| (message.time, messages::as_python(&event))).collect()
}

fn only(folder: &Path) -> PathBuf {
    let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> =
        names.filter(|path| path.extension().is_some_and(|end| end == "mcap")).collect();
    files.sort();
    assert_eq!(files.len(), 1, "{files:?}");
    files.remove(0)
}

#[test]
fn a_mark_stands_in_the_running_recording_with_its_time_and_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let running = recorder(folder, "plant7", &[]);
    until("frames", || status(folder, "plant7").filter(|s| s["buses"][0]["written"] != 0));
    let text = "breaker 3 opened by hand \u{1b}[2J ü";
    mark(folder, &[text, "--name", "plant7"]).expect(0);
    mark(folder, &["again"]).expect(0);
    let ran = mark(folder, &["x", "--name", "plant8"]).expect(1);
    assert!(ran.err.contains("no recorder with the name plant8"), "{}", ran.err);
    running.stop().expect(0);
    let path = only(folder);
    let file = mcap::finished(&path);
    let events = events(&file);
    assert_eq!(events.len(), 2);
    let (time, first) = &events[0];
    assert_eq!(first["event_type"]["name"], "mark");
    assert_eq!(first["event_properties"][0]["value"], text);
    let facts = file.facts("bustape.recording");
    assert_eq!(first["id"], format!("{}/1", facts["session_id"]));
    assert_eq!(first["device_id"], facts["host"]);
    let span = file.messages.iter().map(|message| message.time);
    assert!((span.clone().min().unwrap()..=span.max().unwrap()).contains(time));
    // And people see it.
    let cat = bustape(args(&[&"cat", &path, &"--topics", &"/bustape/event"])).expect(0);
    assert!(
        cat.out.contains("breaker 3 opened by hand") && !cat.out.contains('\u{1b}'),
        "{}",
        cat.out
    );
    assert_eq!(cat.out.lines().count(), 2);
    assert!(bustape(args(&[&"info", &path])).expect(0).out.contains("/bustape/event"));
    // With the recorder its files are gone.
    let ran = mark(folder, &["too late"]).expect(1);
    assert!(ran.err.contains("no recorder is running"), "{}", ran.err);
    let left = std::fs::read_dir(folder).unwrap().count();
    assert_eq!(left, 1, "only the recording is left");
}

#[test]
fn the_status_tells_what_each_recorder_does_and_the_socket_is_private() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (one, two) = (recorder(folder, "one", &[]), recorder(folder, "two", &["--sync", "100ms"]));
    let said = until("a sync", || {
        status(folder, "two").filter(|s| s["synced"].is_string() && s["buses"][0]["rate"] != 0.0)
    });
    assert!(said["file"].as_str().unwrap().contains("two_s0001_0001_"), "{said}");
    assert!(said["free_bytes"].as_u64().unwrap() > 1 << 20, "{said}");
    assert_eq!(said["buses"][0]["bus"], "station");
    assert_eq!(said["buses"][0]["dropped"], 0);
    until("the other", || status(folder, "one"));
    let ran = here(folder, ["status"]).wait().expect(0);
    for part in ["one (process ", "two (process ", "station", "last sync", "free on the disk"] {
        assert!(ran.out.contains(part), "{part}: {}", ran.out);
    }
    let ran = here(folder, ["status", "--name", "three"]).wait().expect(1);
    assert!(ran.err.contains("no recorder with the name three is running"), "{}", ran.err);
    // Which of the two?
    let ran = mark(folder, &["which"]).expect(2);
    assert!(ran.err.contains("choose one with --name"), "{}", ran.err);
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        if entry.path().extension().is_some_and(|end| end == "sock") {
            assert_eq!(entry.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        }
    }
    // One that was killed is not taken for running.
    two.kill();
    assert!(status(folder, "two").is_none());
    one.stop().expect(0);
}

#[test]
fn a_segment_with_a_mark_outlives_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let running = recorder(folder, "plant", &["--split-time", "300ms", "--keep-time", "1s"]);
    until("frames", || status(folder, "plant").filter(|s| s["buses"][0]["written"] != 0));
    mark(folder, &["keep this"]).expect(0);
    until("three more segments", || {
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        (names.filter(|p| p.extension().is_some_and(|end| end == "mcap")).count() > 4).then_some(())
    });
    running.stop().expect(0);
    std::thread::sleep(std::time::Duration::from_millis(1100));
    // Everything has its age now, and the next recorder looks before it begins.
    recorder(folder, "plant", &["--count", "20", "--keep-time", "1s"]).wait().expect(0);
    let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let left: Vec<_> = names.filter(|p| p.extension().is_some_and(|end| end == "mcap")).collect();
    let marked = left.iter().filter(|path| !events(&mcap::finished(path)).is_empty()).count();
    assert_eq!(marked, 1, "{left:?}");
    assert!(left.len() <= 4, "the others are gone: {left:?}");
}
