//! Names that come from files: they lead nowhere, and drive no terminal.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use bustape::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes};
use bustape::recording::writer::Layout;

use crate::support::make::{at, make};
use crate::support::process::{args, bustape};

/// What somebody may call a bus.
const NAMES: [&str; 12] = [
    "../../evil",
    "/etc/evil",
    "a/../../../b",
    "..\\evil",
    "..",
    ".",
    "a\0b",
    "con:\u{202e}fdp",
    "\u{1b}]0;owned\u{7}\u{1b}[2J",
    "line\r\nbreak",
    "=cmd|' /C calc'!A1",
    "{300}",
];

fn name(text: &str) -> String {
    if text == "{300}" { "x".repeat(300) } else { text.to_owned() }
}

/// Everything below a folder.
fn below(folder: &Path) -> BTreeSet<PathBuf> {
    let mut all = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if entry.file_type().unwrap().is_dir() {
                folders.push(path.clone());
            }
            all.insert(path);
        }
    }
    all
}

/// A recording of a CAN bus and a serial line with one name each.
fn recording(path: &Path, text: &str) {
    let can = |n: u64| Frame::Can(CanFrame::new(n as u32, CanFlags::default(), &[n as u8; 8]));
    let serial = |direction| {
        Frame::Serial(SerialBytes { direction, data: b"abc".to_vec(), errors: Vec::new() })
    };
    let mut frames: Vec<_> = (0..20).map(|n| (0, at(n, can(n)))).collect();
    frames.push((1, at(30, serial(Direction::Rx))));
    frames.push((1, at(31, serial(Direction::Tx))));
    make(path, Layout::Frame, &[&name(text), &format!("{} 2", name(text))], &frames);
}

#[test]
fn no_name_in_a_file_leads_out_of_the_folder_or_over_a_link() {
    for text in NAMES {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("a/b/c");
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("in.mcap");
        recording(&file, text);
        let out = folder.join("out");
        std::fs::create_dir(&out).unwrap();
        // What a link leads to must not be written, whatever the name.
        let target = root.path().join("target");
        std::fs::write(&target, "mine").unwrap();
        for planted in ["out.csv", "in.mcap"] {
            std::os::unix::fs::symlink(&target, out.join(planted)).unwrap();
        }
        let before = below(root.path());
        let to = |name: &str| out.join(name);
        let lines = [
            args(&[&"export", &"--format", &"raw", &"-o", &to("raw.bin"), &file]),
            args(&[
                &"export",
                &"--format",
                &"csv",
                &"--decode",
                &"hmi-can",
                &"-o",
                &to("csv"),
                &file,
            ]),
            args(&[
                &"export",
                &"--format",
                &"csv",
                &"--shape",
                &"frames",
                &"-o",
                &to("out.csv"),
                &file,
            ]),
            args(&[
                &"export",
                &"--format",
                &"parquet",
                &"--decode",
                &"hmi-can",
                &"-o",
                &to("p"),
                &file,
            ]),
            args(&[&"export", &"--format", &"candump", &"-o", &to("can.log"), &file]),
            args(&[&"export", &"--format", &"asc", &"-o", &to("can.asc"), &file]),
            args(&[&"recover", &"-d", &out, &file]),
            args(&[&"retime", &"--offset=1h", &"-d", &out, &file]),
            args(&[&"convert", &"-o", &to("new.mcap"), &file]),
        ];
        for line in lines {
            let ran = bustape(&line);
            assert!(matches!(ran.status.code(), Some(0..=3)), "{text:?} {line:?}: {ran:?}");
        }
        let after = below(root.path());
        let new: Vec<_> =
            after.difference(&before).filter(|path| !path.starts_with(&out)).collect();
        assert!(new.is_empty(), "{text:?}: {new:?}");
        assert!(after.is_superset(&before), "{text:?}: something is gone");
        assert_eq!(std::fs::read(&target).unwrap(), b"mine", "{text:?} was written through a link");
    }
}

#[test]
fn no_name_in_a_file_drives_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    for (number, text) in NAMES.iter().enumerate() {
        let file = folder.path().join(format!("{number}.mcap"));
        recording(&file, text);
        let bus = format!("{}=trace:", name(text));
        let mut lines = vec![
            args(&[&"info", &file]),
            args(&[&"info", &"--json", &file]),
            args(&[&"cat", &file]),
            args(&[&"cat", &"--json", &"--topics", &"*", &file]),
            args(&[&"recover", &"-o", &folder.path().join(format!("{number}.new")), &file]),
            args(&[&"export", &"--format", &"csv", &"--shape", &"frames", &"-o", &"-", &file]),
        ];
        if !text.contains('\0') {
            lines.push(args(&[&"replay", &"--rate", &"max", &"--to", &bus, &file]));
        }
        for line in lines {
            let ran = bustape(&line);
            for said in [&ran.out, &ran.err] {
                let control = said.chars().find(|c| c.is_control() && *c != '\n' && *c != '\r');
                assert_eq!(control, None, "{text:?} {line:?}: {said}");
                let bidi = said
                    .chars()
                    .find(|c| matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'));
                assert!(bidi.is_none() || line[0] == "export", "{text:?} {line:?}: {said:?}");
            }
        }
    }
}

#[test]
fn no_label_of_a_database_drives_a_terminal_as_json_either() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.dbc");
    let text = "VERSION \"\"\nBU_: N\nBO_ 291 M: 8 N\n SG_ S : 0|8@1+ (1,0) [0|255] \"u\u{9b}\" N\n\
                VAL_ 291 S 222 \"on\u{8d}\u{9b}2J\u{7f}\" ;\nSIG_VALTYPE_ 9\u{85} S : 7;\n";
    std::fs::write(&file, text).unwrap();
    let decode = file.display().to_string();
    for line in [
        args(&[&"explain", &"--json", &"--decode", &decode, &"123#DE"]),
        args(&[&"explain", &"--decode", &decode, &"123#DE"]),
        args(&[&"protocols", &"check", &"--json", &decode]),
        args(&[&"protocols", &"check", &decode]),
        args(&[&"protocols", &"show", &decode]),
    ] {
        let ran = bustape(&line);
        let said = [ran.out.as_str(), ran.err.as_str()].concat();
        let control = said.chars().find(|c| c.is_control() && *c != '\n');
        assert_eq!(control, None, "{line:?}: {said}");
    }
    let json = bustape(args(&[&"explain", &"--json", &"--decode", &decode, &"123#DE"])).json();
    assert_eq!(json["labels"]["S"], "on\u{8d}\u{9b}2J\u{7f}", "it says the same as before");
}
