//! `bustape export` of frames, and what becomes of outputs: nothing is lost without a word, and
//! nothing is replaced that no export made.

use std::fs;
use std::path::PathBuf;

use crate::support::capture::{CAN, Capture, SERIAL, can, serial};
use crate::support::mcap;
use crate::support::process::{Ran, args, bustape, start_injected};

const LOG: &str = "(1700000000.000000) can0 123#11\n(1700000000.100000) can1 123#22\n";
const DBC: &str = "BO_ 291 Eng: 8 X\n SG_ v : 0|8@1+ (1,0) [0|0] \"\" Y\n";

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::write(folder.path("a.log"), LOG).unwrap();
        fs::write(folder.path("a.dbc"), DBC).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// `bustape export FROM --format FORMAT -o OUT ...`.
    fn export(&self, from: &str, format: &str, out: &str, more: &[&str]) -> Ran {
        let out = if out == "-" { out.into() } else { self.path(out) };
        let mut all = args(&[&"export", &self.path(from), &"--format", &format, &"-o", &out]);
        all.extend(more.iter().map(Into::into));
        bustape(all)
    }

    fn tables(&self, format: &str, out: &str, more: &[&str]) -> Ran {
        let dbc = self.path("a.dbc");
        let more = [&["--decode", dbc.to_str().unwrap()], more].concat();
        self.export("a.log", format, out, &more)
    }

    fn import(&self, log: &str) -> Ran {
        fs::remove_file(self.path("back.mcap")).ok();
        bustape(args(&[&"import", &self.path(log), &"-o", &self.path("back.mcap")]))
    }

    fn text(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap()
    }
}

#[test]
fn force_removes_no_unfinished_recording_and_nothing_that_is_not_named_as_exports_are() {
    let folder = Folder::new();
    for file in ["x.mcap.part", "notes.csv", "can0/x.mcap.part", "part-0000.parquet"] {
        let path = folder.path("rec").join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "mine").unwrap();
        for format in ["parquet", "csv"] {
            let ran = folder.tables(format, "rec", &["--force"]).expect(1);
            assert!(ran.err.contains("is not the work of an export"), "{}", ran.err);
            assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
        }
        fs::remove_dir_all(folder.path("rec")).unwrap();
    }
}

#[test]
fn what_every_format_put_into_a_folder_can_be_replaced() {
    let folder = Folder::new();
    for (format, more) in [
        ("jsonl", &["--split", "day"][..]),
        ("influx", &["--split", "hour"]),
        ("csv", &["--split", "hour"]),
        ("csv", &["--split", "day", "--shape", "long"]),
        ("parquet", &["--split", "day", "--shape", "long"]),
        ("parquet", &["--split", "hour"]),
    ] {
        let out = format!("{format}{}", more.len());
        folder.tables(format, &out, more).expect(0);
        folder.tables(format, &out, &[more, &["--force"]].concat()).expect(0);
        // And what a kill has left of one.
        fs::rename(folder.path(&out), folder.path(&format!("{out}.part"))).unwrap();
        folder.tables(format, &out, &[more, &["--force"]].concat()).expect(0);
        fs::remove_dir_all(folder.path(&out)).unwrap();
    }
}

#[test]
fn a_folder_that_the_disk_does_not_take_has_no_name() {
    let folder = Folder::new();
    for format in ["parquet", "csv"] {
        let (log, dbc, out) = (folder.path("a.log"), folder.path("a.dbc"), folder.path("out"));
        let all = args(&[&"export", &log, &"--decode", &dbc, &"--format", &format, &"-o", &out]);
        let ran = start_injected(&["inject=fsync:error=EIO"], &[], all).wait().expect(1);
        assert!(ran.err.contains("cannot write to the disk"), "{}", ran.err);
        assert!(!out.exists() && !folder.path("out.part").exists());
    }
}

#[test]
fn names_of_buses_never_make_other_lines_and_are_read_again() {
    let folder = Folder::new();
    let names = ["Powertrain CAN", "Powertrain_CAN", "b\n(1700000009.000000) can9 7FF#00"];
    let mut log = Capture::new();
    for (number, name) in (0..).zip(names) {
        log = log.interface(CAN, name, &[]).packet(
            number,
            1_700_000_000_000_000_000 + u64::from(number),
            &can(0x123, &[number as u8]),
            9,
        );
    }
    fs::write(folder.path("a.pcapng"), log.0).unwrap();
    for format in ["candump", "frames-csv", "asc", "trc"] {
        let ran = folder.export("a.pcapng", format, format, &[]).expect(0);
        let kept = !["candump", "frames-csv"].contains(&format);
        let said = ran.err.contains("does not keep names of buses with blanks");
        assert_eq!(said, !kept, "{format}: {}", ran.err);
        folder.import(format).expect(0);
        let back = bustape(args(&[&"cat", &folder.path("back.mcap")])).expect(0).out;
        assert_eq!(back.lines().count(), 3, "{format}: {back}");
        let mut buses: Vec<&str> =
            back.lines().map(|line| line.split(' ').nth(1).unwrap()).collect();
        buses.dedup();
        assert_eq!(buses.len(), 3, "{format}: {back}");
    }
    assert!(
        folder.text("candump").contains(") Powertrain_CAN 123#01"),
        "{}",
        folder.text("candump")
    );
    assert!(folder.text("candump").contains(") Powertrain_CAN_2 123#00"));
}

#[test]
fn names_of_serial_lines_stand_in_one_word() {
    let folder = Folder::new();
    let log = Capture::new().interface(SERIAL, "COM 1", &[]).packet(
        0,
        1_700_000_000_000_000_000,
        &serial(b"hi"),
        14,
    );
    fs::write(folder.path("a.pcapng"), log.0).unwrap();
    let ran = folder.export("a.pcapng", "hex", "a.txt", &[]).expect(0);
    assert!(ran.err.contains("does not keep names of buses with blanks"), "{}", ran.err);
    assert!(folder.text("a.txt").starts_with("(1700000000.000000000) COM_1 rx  68 69"));
}

#[test]
fn a_read_of_an_error_alone_is_counted_where_text_has_no_row_for_it() {
    let folder = Folder::new();
    let mut parity = serial(&[]);
    parity[8] = 8;
    let log = Capture::new()
        .interface(SERIAL, "rect", &[])
        .packet(0, 1_700_000_000_000_000_000, &serial(b"hi"), 14)
        .packet(0, 1_700_000_001_000_000_000, &parity, 12);
    fs::write(folder.path("a.pcapng"), log.0).unwrap();
    let ran = folder.export("a.pcapng", "hex", "a.txt", &[]).expect(3);
    assert!(ran.err.contains("1 empty serial frames are not in the output"), "{}", ran.err);
    assert_eq!(folder.text("a.txt").lines().count(), 1);
}

#[test]
fn a_serial_line_that_begins_late_is_in_the_capture() {
    let folder = Folder::new();
    let frame = |number: u64| {
        let (seconds, micros) = (1_700_000_000 + number / 1000, number % 1000 * 1000);
        format!("({seconds}.{micros:06}) can0 123#{number:04X}\n")
    };
    let mut log: String = (0..9000).map(frame).collect();
    log += "(1700000100.000000) rect rx  00 11 22   |...|\n";
    fs::write(folder.path("mix.log"), log).unwrap();
    let ran = folder.export("mix.log", "pcapng", "mix.pcapng", &[]).expect(0);
    assert!(ran.err.contains("9,001 frames in = 9,001 written"), "{}", ran.err);
    folder.import("mix.pcapng").expect(0);
    let back = bustape(args(&[&"cat", &"-f", &"rect", &folder.path("back.mcap")])).expect(0).out;
    assert!(back.contains("rect rx  00 11 22"), "{back}");
}

#[test]
fn a_frame_that_loses_its_time_is_a_loss() {
    let folder = Folder::new();
    let frame = |number: u64| format!("({}.000000) can0 123#11\n", 1_700_000_000 + number);
    // The last one stands further behind than frames are put in their place.
    let mut log: String = (1000..50_000).map(frame).collect();
    log += &frame(1);
    fs::write(folder.path("late.log"), log).unwrap();
    for format in ["asc", "trc", "blf", "mf4"] {
        let ran = folder.export("late.log", format, format, &[]).expect(3);
        assert!(ran.err.contains("1 frames have the time of the first one"), "{}", ran.err);
    }
    folder.export("late.log", "candump", "candump", &[]).expect(0);
}

#[test]
fn a_bus_that_is_not_there_leaves_no_output() {
    let folder = Folder::new();
    folder.export("a.log", "candump", "out.log", &["-f", "nosuch"]).expect(2);
    assert!(!folder.path("out.log").exists() && !folder.path("out.log.part").exists());
    let ran = folder.export("a.log", "candump", "out.log", &["--bus", "nope"]).expect(3);
    assert!(ran.err.contains("nothing was exported: no frame of the input is selected by --bus"));
}

#[test]
fn totals_go_to_stdout_unless_the_frames_do() {
    let folder = Folder::new();
    let ran = folder.export("a.log", "candump", "out.log", &["--json"]).expect(0);
    assert_eq!(ran.json()["written"], 2);
    let ran = folder.export("a.log", "candump", "-", &["--json"]).expect(0);
    assert_eq!(ran.out.lines().count(), 2);
    let totals: serde_json::Value = serde_json::from_str(&ran.err).unwrap();
    assert_eq!(totals["written"], 2);
}

#[test]
fn options_of_tables_are_refused_where_there_are_none() {
    let folder = Folder::new();
    for more in [
        &["--message", "Eng"][..],
        &["--signal", "v"],
        &["--shape", "wide"],
        &["--split", "day"],
        &["--units"],
        &["--separator", ";"],
        &["--time", "epoch"],
    ] {
        let ran = folder.export("a.log", "asc", "out.asc", more).expect(2);
        assert!(ran.err.contains(&format!("{}: of tables", more[0])), "{}", ran.err);
        assert!(!folder.path("out.asc").exists());
    }
}

#[test]
fn a_mark_that_times_have_parts_no_columns() {
    let folder = Folder::new();
    let ran = folder.tables("csv", "out", &["--separator", ":"]).expect(2);
    assert!(ran.err.contains("have colons"), "{}", ran.err);
    folder.tables("csv", "out", &["--separator", ":", "--time", "epoch"]).expect(0);
    assert!(folder.text("out/can0/Eng.csv").contains("1700000000.000000000:17"));
}

/// Three tables: two schemas of one name, and one that has the name which the second would get.
#[test]
fn tables_of_two_schemas_never_share_a_file() {
    let folder = Folder::new();
    let dbc = |names: &[(&str, &str)]| -> String {
        let message = |(number, (name, signal)): (usize, &(&str, &str))| {
            format!("BO_ {} {name}: 8 X\n SG_ {signal} : 0|8@1+ (1,0) [0|0] \"\" Y\n", 291 + number)
        };
        names.iter().enumerate().map(message).collect()
    };
    let log =
        |second: u32| format!("({second}.000000) can0 123#11\n({second}.100000) can0 124#22\n");
    for (name, second, messages) in [
        ("one", 1_700_000_000, &[("X", "a"), ("X_2", "b")][..]),
        ("two", 1_700_000_100, &[("X", "c")]),
    ] {
        let path = |end: &str| folder.path(&format!("{name}{end}"));
        fs::write(path(".log"), log(second)).unwrap();
        fs::write(path(".dbc"), dbc(messages)).unwrap();
        bustape(args(&[&"import", &path(".log"), &"-o", &path(".raw")])).expect(0);
        let protocol = format!("can0={}", path(".dbc").display());
        let decode =
            args(&[&"decode", &path(".raw"), &"--decode", &protocol, &"-o", &path(".mcap")]);
        bustape(decode).expect(0);
    }
    let (one, two, out) = (folder.path("one.mcap"), folder.path("two.mcap"), folder.path("out"));
    bustape(args(&[&"export", &one, &two, &"--format", &"csv", &"-o", &out])).expect(0);
    let file = |name: &str| folder.text(&format!("out/can0/{name}.csv"));
    assert!(file("X").starts_with("time,a\r\n"), "{}", file("X"));
    assert!(file("X_2").starts_with("time,b\r\n"), "{}", file("X_2"));
    assert!(file("X_3").starts_with("time,c\r\n"), "{}", file("X_3"));
    for name in ["X", "X_2", "X_3"] {
        assert_eq!(file(name).lines().count(), 2, "{name}: {}", file(name));
    }
}

#[test]
fn a_message_with_a_slash_in_its_name_has_a_topic_and_a_table() {
    let folder = Folder::new();
    fs::write(folder.path("a.dbc"), DBC.replace("Eng", "Eng/ine")).unwrap();
    folder.import("a.log").expect(0);
    let (raw, decoded, out) =
        (folder.path("back.mcap"), folder.path("decoded.mcap"), folder.path("out"));
    let protocol = format!("can0={}", folder.path("a.dbc").display());
    bustape(args(&[&"decode", &raw, &"--decode", &protocol, &"-o", &decoded])).expect(0);
    let topics = mcap::finished(&decoded);
    assert!(topics.channels.values().any(|channel| channel.topic == "/can0/Eng_ine"));
    bustape(args(&[&"export", &decoded, &"--format", &"csv", &"-o", &out])).expect(0);
    assert_eq!(folder.text("out/can0/Eng_ine.csv").lines().count(), 2);
}

/// An element that was left out would give its index to the next one.
#[test]
fn texts_that_repeat_keep_their_places_whatever_is_in_them() {
    let folder = Folder::new();
    let rules = "dbc = \"a.dbc\"\nbyte_order = \"little\"\nname = \"texts\"\n\
                 [[assembly]]\nname = \"A\"\nkind = \"a\"\nfirst = \"Eng\"\nnumber = 0x0F\n\
                 length = { field = \"n\" }\nfields = [{ name = \"n\", type = \"u8\" }, \
                 { name = \"name\", type = \"text[]\", size = 2 }]\n";
    fs::write(folder.path("a.toml"), rules).unwrap();
    fs::write(folder.path("a.dbc"), DBC.replace("291", "288").replace("8 X", "7 X")).unwrap();
    fs::write(folder.path("a.log"), "(1700000000.000000) can0 120#076162C3A96364\n").unwrap();
    let rules = folder.path("a.toml");
    let more = ["--decode", rules.to_str().unwrap()];
    folder.export("a.log", "csv", "out", &more).expect(0);
    let text = folder.text("out/can0/A.name.csv");
    let rows: Vec<&str> = text.lines().map(|line| line.split_once(',').unwrap().1).collect();
    assert_eq!(rows, ["index,name", "0,ab", "1,é", "2,cd"]);
}
