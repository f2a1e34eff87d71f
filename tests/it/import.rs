//! `bustape import`: what it makes of logs that are large, damaged, or many.

use std::fs;
use std::io::Write as _;
use std::path::Path;

use serde_json::json;

use crate::support::bytes::noise;
use crate::support::mcap;
use crate::support::process::{BUSTAPE, Ran, args, bustape, spawn};

fn import(options: &[&str], logs: &[&Path], out: &Path) -> Ran {
    let mut all = args(&[&"import", &"-o", &out]);
    all.extend(options.iter().map(Into::into));
    all.extend(logs.iter().map(|log| log.as_os_str().to_owned()));
    bustape(all)
}

fn cat(path: &Path) -> String {
    bustape(args(&[&"cat", &path])).expect(0).out
}

const LOG: &str = "(1700000000.000001) can0 123#DEADBEEF\n(1700000000.100001) can1 00000123#00\n\
                   (1700000000.200001) can0 123##1DEAD\n";

#[test]
fn several_logs_become_one_recording_on_one_clock() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("a.log"), LOG).unwrap();
    let asc = "date Tue Nov 14 10:13:20.000 pm 2023\nbase hex timestamps absolute\n\
               0.150000 1 7FF Rx d 1 07\n";
    fs::write(path("b.asc"), asc).unwrap();
    for layout in ["frame", "batch"] {
        let out = path(layout);
        let options = ["--layout", layout, "--bus", "1=body", "--json"];
        let ran = import(&options, &[&path("a.log"), &path("b.asc")], &out).expect(0);
        assert_eq!(
            (ran.json()["frames"].clone(), ran.json()["skipped"].clone()),
            (json!(4), json!(0))
        );
        let expected = "(1700000000.000001) can0 123#DEADBEEF\n(1700000000.100001) can1 00000123#00\n\
                        (1700000000.150000) body 7FF#07\n(1700000000.200001) can0 123##5DEAD\n";
        assert_eq!(cat(&out), expected);
        let file = mcap::finished(&out);
        assert_eq!(file.facts("bustape.recording")["imported"], "true");
        assert_eq!(file.facts("bustape.import")["1.file"], "a.log");
        assert_eq!(file.facts("bustape.import")["2.format"], "Vector ASC");
        assert_eq!(file.facts("bustape.summary")["can0.written"], "2");
        assert_eq!(file.facts("bustape.summary")["reason"], "import");
    }
    let ran = import(&[], &[&path("a.log")], &path("frame")).expect(1);
    assert!(ran.err.contains("exists and is not overwritten"), "{}", ran.err);
}

#[test]
fn compressed_logs_are_read_and_damaged_ones_as_far_as_they_go() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let line = |n: usize| format!("(17000{n:05}.000001) can0 123#{n:08X}\n");
    let text: String = (0..20_000).map(line).collect();
    fs::write(path("whole.log.zst"), zstd::encode_all(text.as_bytes(), 3).unwrap()).unwrap();
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gz.write_all(text.as_bytes()).unwrap();
    let gz = gz.finish().unwrap();
    fs::write(path("whole.log.gz"), &gz).unwrap();
    fs::write(path("cut.log.gz"), &gz[..gz.len() / 2]).unwrap();
    for name in ["whole.log.zst", "whole.log.gz"] {
        import(&[], &[&path(name)], &path(&format!("{name}.mcap"))).expect(0);
        assert!(cat(&path(&format!("{name}.mcap"))) == text, "{name}");
    }
    let ran = import(&[], &[&path("cut.log.gz")], &path("cut.mcap")).expect(3);
    assert!(ran.err.contains("the compressed file is cut off"), "{}", ran.err);
    let found = cat(&path("cut.mcap"));
    assert!(text.starts_with(&found) && found.lines().count() > 5_000, "{}", found.len());
}

#[test]
fn binary_logs_are_read_compressed_and_from_a_pipe_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let line = |n: usize| format!("(17000{n:05}.000001) can0 123#{n:08X}\n");
    let text: String = (0..20_000).map(line).collect();
    fs::write(path("a.log"), &text).unwrap();
    for format in ["blf", "mf4"] {
        let log = path(&format!("a.{format}"));
        let export = args(&[&"export", &path("a.log"), &"--format", &format, &"-o", &log]);
        bustape(export).expect(0);
        let whole = fs::read(&log).unwrap();
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        gz.write_all(&whole).unwrap();
        let gz = gz.finish().unwrap();
        let zst = zstd::encode_all(&whole[..], 3).unwrap();
        let numbered = text.replace("can0", "1");
        for (name, content) in [("gz", &gz[..]), ("zst", &zst), ("cut", &gz[..gz.len() / 2])] {
            let (log, out) = (path(name), path(&format!("{format}-{name}.mcap")));
            fs::write(&log, content).unwrap();
            let ran = import(&[], &[&log], &out);
            if name == "cut" {
                let ran = ran.expect(3);
                assert!(ran.err.contains("the compressed file is cut off"), "{}", ran.err);
                assert!(numbered.starts_with(&cat(&out)), "{format}");
            } else {
                ran.expect(0);
                assert!(cat(&out) == numbered, "{format} {name}");
            }
        }
        let mut command = std::process::Command::new("sh");
        let piped = format!("cat a.{format} | {BUSTAPE} import - -o piped-{format}");
        command.arg("-c").arg(piped).current_dir(&folder);
        spawn(command).wait().expect(0);
        assert!(cat(&path(&format!("piped-{format}"))) == numbered, "{format}");
    }
}

#[test]
fn what_cannot_be_taken_is_counted_and_the_first_of_it_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let broken: String = (0..30).map(|n| format!("(1.{n:06}) can0 12G#00\n")).collect();
    fs::write(path("a.log"), format!("{LOG}{broken}")).unwrap();
    let ran = import(&[], &[&path("a.log")], &path("a.mcap")).expect(3);
    assert!(ran.err.contains("a.log: line 4: \"12G\" is no identifier"), "{}", ran.err);
    assert!(ran.err.contains("20 more like these"), "{}", ran.err);
    assert!(
        ran.err.contains("3 frames in = 3 written, 30 lines or objects skipped"),
        "{}",
        ran.err
    );
    for (name, content, why) in [
        ("empty", &b""[..], "it is empty"),
        ("noise", &noise(7, 5000), "of no format that is known"),
        ("prose", b"Dear diary,\ntoday nothing happened.\n", "of no format that is known"),
    ] {
        fs::write(path(name), content).unwrap();
        let ran = import(&[], &[&path(name)], &path("none.mcap")).expect(1);
        assert!(ran.err.contains(why), "{}", ran.err);
        assert!(!path("none.mcap").exists() && !path("none.mcap.part").exists());
    }
}

#[test]
fn a_log_in_no_order_keeps_every_frame_in_both_layouts() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // Two captures of the same minutes, one behind the other: far more than the window.
    let line = |n: usize| format!("(17000{n:05}.000001) can0 123#{n:08X}\n");
    let half: String = (0..90_000).step_by(2).map(line).collect();
    let other: String = (1..90_000).step_by(2).map(line).collect();
    fs::write(path("a.log"), format!("{half}{other}")).unwrap();
    let sorted: String = (0..90_000).map(line).collect();
    for layout in ["frame", "batch"] {
        let ran = import(&["--layout", layout], &[&path("a.log")], &path(layout)).expect(0);
        assert!(ran.err.contains("stood more than 16,384 frames too late"), "{}", ran.err);
        assert!(cat(&path(layout)) == sorted, "{layout}");
    }
}

#[test]
fn logs_without_dates_begin_where_a_person_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("a.log"), "(000.000000) can0 123#00\n(000.500000) can0 123#01\n").unwrap();
    let ran = import(&[], &[&path("a.log")], &path("a.mcap")).expect(0);
    assert!(ran.err.contains("which --start gives"), "{}", ran.err);
    assert!(
        cat(&path("a.mcap")).starts_with("(0000000000.000000) can0 123#00\n(0000000000.500000)")
    );
    let start = ["--start", "2023-11-14T22:13:20Z"];
    import(&start, &[&path("a.log")], &path("b.mcap")).expect(0);
    assert!(cat(&path("b.mcap")).starts_with("(1700000000.000000) can0 123#00\n"));
    // A date without a zone is one of the clock's place.
    fs::write(path("c.log"), "(2023-11-14 23:13:20.5) can0 123#00\n").unwrap();
    import(&["--zone", "Europe/Berlin"], &[&path("c.log")], &path("c.mcap")).expect(0);
    assert_eq!(cat(&path("c.mcap")), "(1700000000.500000) can0 123#00\n");
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.log");
    fs::write(&log, LOG).unwrap();
    for (options, sentence) in [
        (&["--bus", "x"][..], "--bus x names one bus, but the logs have can0 and can1"),
        (&["--bus", "can0=a b"], "cannot be a name"),
        (&["--format", "raw"], "needs --baud"),
        (&["--baud", "9600"], "add --format raw"),
        (&["--format", "raw", "--baud", "9600,9X1"], "write it like 19200 or 19200,8N1"),
        (&["--start", "yesterday"], "is not a time"),
        (&["--zone", "Atlantis"], "no such time zone"),
    ] {
        let out = folder.path().join("out.mcap");
        let ran = import(options, &[&log], &out).expect(2);
        assert!(ran.err.contains(sentence), "{}", ran.err);
        assert!(!out.exists() && !folder.path().join("out.mcap.part").exists(), "{options:?}");
    }
}
