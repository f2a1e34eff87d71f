//! `bustape cat` and `bustape info`: what they print.

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, LineError, LineErrorKind, SerialBytes,
    Stamped, Timestamp, Unit,
};
use bustape::recording::definition::Attachment;
use bustape::recording::writer::Layout;
use serde_json::{Value, json};

use crate::support::make::{SECOND, START, at, head, make, make_with};
use crate::support::mcap;
use crate::support::process::{BUSTAPE, args, bustape};

/// One of each kind, a quarter of a second apart.
fn frames() -> Vec<(usize, Stamped<Frame>)> {
    let can = |id, flags, data: &[u8]| Frame::Can(CanFrame::new(id, flags, data));
    let serial = |direction, data: Vec<u8>| {
        let errors = vec![LineError { offset: 1, kind: LineErrorKind::Parity }];
        Frame::Serial(SerialBytes { direction, data, errors })
    };
    let (from, to) = (Timestamp(START), Timestamp(START + SECOND));
    let gap = Gap { count: 12, unit: Unit::Frames, reason: GapReason::KernelQueue, from, to };
    let all = [
        (0, can(0x123, CanFlags::default(), &[0xDE, 0xAD, 0xBE, 0xEF])),
        (0, can(0x123, CanFlags::EXTENDED | CanFlags::TX, &[])),
        (0, Frame::Can(CanFrame::new(0x7FF, CanFlags::REMOTE, &[]).with_dlc(4))),
        (0, can(0x456, CanFlags::FD | CanFlags::BRS | CanFlags::ESI, &[0x11; 12])),
        (0, can(0x4, CanFlags::ERROR, &[0, 1, 2, 3, 4, 5, 6, 7])),
        (0, Frame::Can(CanFrame::new(0x123, CanFlags::default(), &[9; 8]).with_dlc(15))),
        (0, Frame::Gap(gap)),
        (1, serial(Direction::Rx, (0x3A..0x4C).collect())),
        (1, serial(Direction::Tx, b"\x7E\x00".to_vec())),
    ];
    let quarter = SECOND / 4 + 1_001;
    (0..).zip(all).map(|(n, (bus, frame))| (bus, at(n * quarter, frame))).collect()
}

fn both_layouts(check: impl Fn(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let path = folder.path().join(layout.name());
        make(&path, layout, &["can0", "rect"], &frames());
        check(&path);
    }
}

fn cat(path: &Path, options: &[&str]) -> String {
    let mut all = args(&[&"cat", &path]);
    all.extend(options.iter().map(Into::into));
    let ran = bustape(all).expect(0);
    assert_eq!(ran.err, "");
    ran.out
}

/// The first word of each line that has a time.
fn times(text: &str) -> Vec<&str> {
    let lines = text.lines().filter(|line| line.starts_with('('));
    lines.map(|line| line.split_once(')').unwrap().0.trim_start_matches('(')).collect()
}

#[test]
fn frames_are_printed_as_candump_logs_them() {
    both_layouts(|path| {
        let expected = "\
(1700000000.000000) can0 123#DEADBEEF R
(1700000000.250001) can0 00000123# T
(1700000000.500002) can0 7FF#R4 R
(1700000000.750003) can0 456##7111111111111111111111111 R
(1700000001.000004) can0 20000004#0001020304050607 R
(1700000001.250005) can0 123#0909090909090909_F R
# gap: can0 lost 12 frames (kernel_queue) from 2023-11-14T22:13:20.000Z to 2023-11-14T22:13:21.000Z
(1700000001.750007) rect rx  3A 3B 3C 3D 3E 3F 40 41 42 43 44 45 46 47 48 49  |:;<=>?@ABCDEFGHI|
                             4A 4B                                            |JK|
# rect: parity error at byte 1
(1700000002.000008) rect tx  7E 00                                            |~.|
# rect: parity error at byte 1
";
        assert_eq!(cat(path, &["-x"]), expected);
        assert_eq!(cat(path, &[]), expected.replace(" R\n", "\n").replace(" T\n", "\n"));
    });
}

#[test]
fn times_are_printed_in_four_styles_and_to_the_nanosecond() {
    both_layouts(|path| {
        let style = |options: &[&str]| {
            let text = cat(path, options);
            times(&text)[..3].iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(
            style(&["-t", "a"]),
            ["1700000000.000000", "1700000000.250001", "1700000000.500002"]
        );
        assert_eq!(style(&["-t", "d"]), ["000.000000", "000.250001", "000.250001"]);
        assert_eq!(style(&["-t", "z"]), ["000.000000", "000.250001", "000.500002"]);
        let date = "2023-11-14 22:13:20";
        assert_eq!(
            style(&["-t", "A"]),
            [".000000", ".250001", ".500002"].map(|f| format!("{date}{f}"))
        );
        assert_eq!(style(&["-N", "-t", "z"]), ["000.000000000", "000.250001001", "000.500002002"]);
        // A delta is to the line before, and a gap is a line without a time.
        let all = cat(path, &["-t", "d"]);
        assert_eq!(times(&all)[6], "000.500002");
    });
}

#[test]
fn each_line_of_json_is_an_object_with_everything_in_it() {
    both_layouts(|path| {
        let text = cat(path, &["--json"]);
        let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!(lines.len(), frames().len());
        assert_eq!(
            lines[3],
            json!({
                "type": "can", "bus": "can0", "time": "2023-11-14T22:13:20.750003003Z",
                "time_ns": START + 750_003_003, "id": 0x456, "ext": false, "rtr": false,
                "error": false, "fd": true, "brs": true, "esi": true, "dir": "rx",
                "data": "11".repeat(12),
            })
        );
        assert_eq!((&lines[1]["dir"], &lines[2]["dlc"]), (&json!("tx"), &json!(4)));
        assert_eq!(lines[6]["reason"], "kernel_queue");
        let errors = json!([{ "offset": 1, "kind": "parity error" }]);
        assert_eq!((&lines[8]["data"], &lines[8]["errors"]), (&json!("7e00"), &errors));
    });
}

#[test]
fn topics_times_and_filters_select_what_is_printed() {
    both_layouts(|path| {
        let lines = |options: &[&str]| cat(path, options).lines().count();
        let has_time = |options: &[&str]| times(&cat(path, options)).len();
        assert_eq!(lines(&["--json"]), 9);
        assert_eq!(lines(&["--topics", "/rect/raw", "--json"]), 2);
        assert_eq!(lines(&["--topics", "/can0/*,/rect/raw", "--json"]), 9);
        assert_eq!(lines(&["--topics", "*/gaps"]), 1);
        assert_eq!(lines(&["--topics", "/none"]), 0);
        // The start of the recording is its first frame's time; both ends belong to the range.
        assert_eq!(has_time(&["--end", "+0s"]), 1);
        assert_eq!(has_time(&["--start", "+1s"]), 4);
        assert_eq!(has_time(&["--start", "+250ms", "--end", "+1.1s"]), 4);
        assert_eq!(has_time(&["--start", "2023-11-14T22:13:21Z"]), 4);
        assert_eq!(has_time(&["--start", "1700000001", "--end", "1700000001.9"]), 3);
        assert_eq!(
            has_time(&["--start", "1700000000.250001001", "--end", "1700000000.250001001"]),
            1
        );
        assert_eq!(lines(&["-f", "rect", "--json"]), 2);
        // As in the kernel: 11 bits of an identifier may be those of a long one, and error frames
        // have a mask of their own.
        assert_eq!(has_time(&["-f", "can0,123:7FF"]), 4);
        assert_eq!(has_time(&["-f", "can0,123:C00007FF"]), 3);
        assert_eq!(has_time(&["-f", "can0,123:C00007FF,#0"]), 2);
        assert_eq!(has_time(&["-f", "can0,~123:7FF,400:400,j,#0", "-f", "rect"]), 4);
        // Given again for the same bus they add up, as the parts of one do.
        assert_eq!(has_time(&["-f", "can0,123:C00007FF", "-f", "can0,#0"]), 2);
        assert_eq!(has_time(&["-f", "can0,123:C00007FF", "-f", "can0"]), 3);
    });
}

#[test]
fn messages_of_any_topic_are_printed_by_their_schema() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let many: Vec<_> = frames().into_iter().cycle().take(30).map(|(bus, _)| bus).collect();
    let frame = |n: u64| at(n, Frame::Can(CanFrame::new(1, CanFlags::default(), &[])));
    let many: Vec<_> = (0..).zip(many).map(|(n, _)| (0, frame(n))).collect();
    make(&path, Layout::Frame, &["can0"], &many);
    let text = cat(&path, &["--topics", "/bustape/clock"]);
    assert!(text.contains("/bustape/clock {"), "{text}");
    let line = cat(&path, &["--topics", "/bustape/clock", "--json"]);
    let line: Value = serde_json::from_str(&line).unwrap();
    assert_eq!(line["topic"], "/bustape/clock");
    assert_eq!(line["message"]["step_ns"], -3);
    assert_eq!(line["message"]["wall_ns"], START + 20 + 7);
}

#[test]
fn a_selection_that_makes_no_sense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    make(&path, Layout::Frame, &["can0", "rect"], &frames());
    for (options, sentence) in [
        (["--start", "yesterday"], "\"yesterday\" is not a time; write it like"),
        (["-f", "can7"], "has no bus can7, only can0, rect"),
        (["-f", "can0,xyz"], "--filter can0,xyz: "),
        (["-t", "q"], "possible values: a, d, z, A"),
    ] {
        let ran = bustape(args(&[&"cat", &path, &options[0], &options[1]])).expect(2);
        assert!(ran.err.contains(sentence), "{}", ran.err);
    }
    let ran = bustape(args(&[&"cat", &path, &"--start", &"+2s", &"--end", &"+1s"])).expect(2);
    assert!(ran.err.contains("--start is later than --end"), "{}", ran.err);
}

#[test]
fn a_reader_that_has_seen_enough_may_leave() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let frame = |n: u64| at(n, Frame::Can(CanFrame::new(1, CanFlags::default(), &[0; 8])));
    let many: Vec<_> = (0..20_000).map(|n| (0, frame(n))).collect();
    make(&path, Layout::Batch, &["can0"], &many);
    for command in [&["cat"][..], &["cat", "--json"], &["cat", "--topics", "*"]] {
        let mut child = Command::new(BUSTAPE)
            .args(command)
            .arg(&path)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut first = String::new();
        BufReader::with_capacity(64, child.stdout.take().unwrap()).read_line(&mut first).unwrap();
        assert!(!first.is_empty());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert_eq!(said, "");
        assert_eq!(child.wait().unwrap().code(), Some(0));
    }
}

#[test]
fn nothing_in_a_file_can_drive_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let evil = "e\x1b[2Jv\u{9b}31m\u{202e}il\r\u{7f}";
    let path = folder.path().join("a.mcap");
    let mut head = head(&[evil, "rect"]);
    for facts in [&mut head.recording, &mut head.clock, &mut head.buses[0].1] {
        facts.extend(["host", "kind", "address", evil].map(|k| (k.to_owned(), evil.to_owned())));
    }
    let (name, media_type) = (evil.to_owned(), evil.to_owned());
    head.attachments.push(Attachment { name, media_type, data: Vec::new() });
    let mut frames = frames();
    frames.extend(
        (0..40).map(|n| {
            (0, at(3 * SECOND + n, Frame::Can(CanFrame::new(1, CanFlags::default(), &[]))))
        }),
    );
    make_with(&path, Layout::Frame, &head, &frames, &[]);
    let mut part = std::fs::read(&path).unwrap();
    part.truncate(part.len() - 30);
    let cut = folder.path().join("cut\x1b[2J.mcap.part");
    std::fs::write(&cut, part).unwrap();
    let new = |name: &str| folder.path().join(name);
    let runs: Vec<(Vec<&str>, Option<PathBuf>)> = vec![
        (vec!["info"], None),
        (vec!["info", "--json"], None),
        (vec!["cat"], None),
        (vec!["cat", "--json"], None),
        (vec!["cat", "--topics", "*"], None),
        (vec!["cat", "--topics", "*", "--json"], None),
        (vec!["cat", "-f", "nosuch\x1b[2J"], None),
        (vec!["convert", "-o"], Some(new("new\x1b[2J"))),
    ];
    for (command, output) in runs {
        for file in [&path, &cut, &new("missing\x1b[2J")] {
            let mut all: Vec<std::ffi::OsString> = command.iter().map(Into::into).collect();
            all.extend(output.as_ref().map(|output| {
                let mut name = output.clone().into_os_string();
                name.push(file.extension().unwrap_or_default());
                name
            }));
            all.push(file.into());
            let ran = bustape(&all);
            let said = format!("{}{}", ran.out, ran.err);
            let drives =
                |c: char| (c.is_control() && c != '\n') || ('\u{202a}'..='\u{202e}').contains(&c);
            assert!(!said.is_empty() && !said.contains(drives), "{all:?}: {said:?}");
            for line in ran.out.lines().filter(|_| command.contains(&"--json")) {
                // Escaped for the eye, the same for a program.
                let value: Value = serde_json::from_str(line).unwrap();
                if value["bus"] != "rect" && value["type"] == "can" {
                    assert_eq!(value["bus"], evil);
                }
            }
        }
    }
}

#[test]
fn the_half_record_of_a_file_that_is_being_written_is_no_loss() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    make(&path, Layout::Frame, &["can0", "rect"], &frames());
    let whole = mcap::finished(&path);
    let (_, chunk) = *whole.records.iter().find(|(opcode, _)| *opcode == 6).unwrap();
    // A write of another chunk, of which a half has reached the file.
    let mut bytes = std::fs::read(&path).unwrap();
    let again = bytes[chunk..chunk + 100].to_vec();
    bytes.truncate(whole.records.iter().find(|(opcode, _)| *opcode == 0x0F).unwrap().1);
    bytes.extend(again);
    let part = folder.path().join("b.mcap.part");
    std::fs::write(&part, bytes).unwrap();
    let writer = std::fs::File::open(&part).unwrap();
    writer.lock().unwrap();
    let growing = bustape(args(&[&"cat", &part])).expect(0);
    let by = format!("its recorder (process {}) is still running", std::process::id());
    assert!(growing.err.contains(&by), "{}", growing.err);
    writer.unlock().unwrap();
    let cut = bustape(args(&[&"cat", &part])).expect(3);
    assert!(cut.err.contains("100 bytes behind that cannot be read"), "{}", cut.err);
    assert!(!cut.out.is_empty() && cut.out == growing.out);
}
