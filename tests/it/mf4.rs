//! MDF 4 as python-can, asammdf and data loggers write it, and as bustape does.

use std::fs::File;
use std::path::Path;

use bustape::import::LogReader;

use super::blf::{all, many, peer, printed, written};

fn open(path: &Path) -> impl LogReader {
    bustape::import::mf4::open(File::open(path).unwrap()).unwrap()
}

#[test]
fn what_python_can_writes_is_read_frame_for_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("theirs.mf4");
    peer(&["write"], &path);
    assert_eq!(printed(&all(open(&path))), peer(&["read"], &path));
}

#[test]
fn python_can_and_asammdf_read_what_bustape_writes() {
    let dir = tempfile::tempdir().unwrap();
    let (theirs, ours) = (dir.path().join("theirs.blf"), dir.path().join("ours.mf4"));
    peer(&["write"], &theirs);
    let blf = bustape::import::blf::open(File::open(&theirs).unwrap()).unwrap();
    let log = all(blf);
    written(&log, |buses| {
        bustape::export::frames::mf4::create(File::create(&ours).unwrap(), buses)
    });
    assert_eq!(peer(&["read"], &ours), printed(&log));
    assert_eq!(all(open(&ours)), log);
    let about: serde_json::Value = serde_json::from_str(&peer(&["mdf"], &ours)).unwrap();
    assert_eq!(about["version"], "4.11");
    assert_eq!(about["start"].as_f64(), Some(1_795_317_300.25));
    // asammdf finds the buses and their identifiers, as it does for extract_bus_logging.
    let ids = about["ids"].as_object().unwrap();
    let mut buses: Vec<&String> = ids.keys().collect();
    buses.sort();
    assert_eq!(buses, ["1", "2"]);
    // Several blocks a group.
    let log = many(&log);
    written(&log, |buses| {
        bustape::export::frames::mf4::create(File::create(&ours).unwrap(), buses)
    });
    assert_eq!(all(open(&ours)), log);
}

/// Forms that loggers write, made by the script: each with the frames it should give.
#[test]
fn files_of_loggers_are_read_in_all_their_forms() {
    let dir = tempfile::tempdir().unwrap();
    for form in [
        "sorted",
        "unsorted",
        "vlsd",
        "vlsd-list",
        "unfinished",
        "packed",
        "motorola",
        "plain-names",
        "columns",
        "deflate",
        "zstd",
        "lz4",
    ] {
        let path = dir.path().join(format!("{form}.mf4"));
        let frames = peer(&["variant", form], &path);
        assert!(frames.lines().count() > 50, "{form}");
        assert_eq!(printed(&all(open(&path))), frames, "{form}");
    }
}
