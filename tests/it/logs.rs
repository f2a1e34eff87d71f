//! `bustape import` and the frame formats of `bustape export`: what goes in comes out, and the
//! programs that people use read it.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use bustape::frame::FD_LENGTHS;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::support::bytes::Random;
use crate::support::peers::python;
use crate::support::process::{Ran, args, bustape, spawn};

/// 2023-11-14T22:13:20.123Z in microseconds.
const START: u64 = 1_700_000_000_123_000;

/// Formats that keep all that python-can's kinds of frames are, at microseconds.
const FORMATS: [(&str, &str); 7] = [
    ("candump", "log"),
    ("asc", "asc"),
    ("trc", "trc"),
    ("blf", "blf"),
    ("mf4", "mf4"),
    ("pcapng", "pcapng"),
    ("frames-csv", "csv"),
];

/// Lines of candump with every kind of frame on two buses, the same for each seed.
fn frames(seed: u64, count: usize) -> String {
    let mut random = Random::new(seed);
    let lengths = [0, 1, 2, 3, 5, 8, 12, 16, 20, 24, 32, 48, 64];
    let mut time = START;
    let line = |_| {
        time += 1 + random.below(5_000) as u64;
        let bus = random.below(2);
        let id = match random.below(2) {
            0 => format!("{:03X}", random.below(0x800)),
            _ => format!("{:08X}", random.below(0x2000_0000)),
        };
        let hex = |random: &mut Random, count: usize| -> String {
            (0..count).map(|_| format!("{:02X}", random.below(256))).collect()
        };
        let frame = match random.below(10) {
            0 => format!("{id}#R{}", 1 + random.below(8)),
            1 => "20000080#0000000000000000".to_owned(),
            2 | 3 => {
                // python-can takes an empty CAN FD frame of an ASC log for a remote one.
                let length = lengths[1 + random.below(lengths.len() - 1)];
                format!("{id}##{}{}", 4 + random.below(4), hex(&mut random, length))
            }
            _ => {
                let length = random.below(9);
                format!("{id}#{}", hex(&mut random, length))
            }
        };
        let way = if random.below(4) == 0 { "T" } else { "R" };
        format!("({}.{:06}) can{bus} {frame} {way}\n", time / 1_000_000, time % 1_000_000)
    };
    (0..count).map(line).collect()
}

struct Logs(TempDir);

impl Logs {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        fs::write(self.path(name), content).unwrap();
        self.path(name)
    }

    fn import(&self, logs: &[&Path], name: &str) -> Ran {
        let path = self.path(name);
        let mut all = args(&[&"import", &"-o", &path]);
        all.extend(logs.iter().map(|log| log.as_os_str().to_owned()));
        bustape(all)
    }

    fn export(&self, from: &Path, format: &str, name: &str) -> Ran {
        bustape(args(&[&"export", &from, &"--format", &format, &"-o", &self.path(name)]))
    }
}

fn cat(path: &Path) -> String {
    bustape(args(&[&"cat", &"-x", &path])).expect(0).out
}

/// The frames of a log as an independent reader has them.
fn peer_reads(path: &Path) -> Vec<Value> {
    let mut command = python("logs.py");
    command.arg("read").arg(path);
    let ran = spawn(command).wait().expect(0);
    ran.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A line of [`frames`] as `support/logs.py` prints it.
fn of_line(line: &str) -> Value {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let (id, rest) = words[2].split_once('#').unwrap();
    let word = u32::from_str_radix(id, 16).unwrap();
    let error = id.len() == 8 && word & 0x2000_0000 != 0;
    let (fd, rest) = match rest.strip_prefix('#') {
        Some(rest) => (u8::from_str_radix(&rest[..1], 16).unwrap() | 8, &rest[1..]),
        None => (0, rest),
    };
    let remote = rest.strip_prefix('R');
    let data = if remote.is_some() { "" } else { rest };
    let dlc = remote.map_or(data.len() / 2, |dlc| dlc.parse().unwrap());
    let time: u64 = words[0][1..words[0].len() - 1].replace('.', "").parse().unwrap();
    json!({
        "time": time, "bus": words[1], "id": word & 0x1FFF_FFFF, "ext": id.len() == 8 && !error,
        "rtr": remote.is_some(), "error": error, "fd": fd != 0, "brs": fd & 1 != 0, "esi": fd & 2 != 0,
        "tx": words[3] == "T", "dlc": dlc, "data": data.to_lowercase(),
    })
}

/// Without what a format or its reader does not have.
fn reduced(frame: &Value, format: &str) -> Value {
    let mut frame = frame.clone();
    frame["bus"] = Value::Null;
    match format {
        "pcapng" => frame["tx"] = Value::Null,
        // Its reader takes the DLC of CAN FD frames for their length.
        "trc" if frame["fd"] == true => frame["dlc"] = Value::Null,
        _ => {}
    }
    if frame["error"] == true {
        // Of error frames, readers agree on nothing but the time.
        for key in ["id", "ext", "dlc", "data", "tx"] {
            frame[key] = Value::Null;
        }
    }
    frame
}

#[test]
fn every_pair_of_formats_gives_the_same_frames() {
    let logs = Logs::new();
    // Every DLC of classic frames, of which none but these programs show the upper half, and of CAN FD.
    let mut text = frames(1, 330);
    for number in 0..70_u64 {
        let (time, dlc) = (START + 10_000_000 + number, number % 16);
        let frame = match number / 16 {
            0 => format!("7F{:X}#1122334455667788_{:X}", number % 16, 9 + dlc % 7),
            1 if dlc > 8 => format!("000000{number:02X}#R8_{dlc:X}"),
            1 if dlc > 0 => format!("000000{number:02X}#R{dlc}"),
            1 => format!("000000{number:02X}#R"),
            2 => format!("000##5{}", "5A".repeat(FD_LENGTHS[dlc as usize].into())),
            _ => format!("1FFFFFFF#{}", "A5".repeat(dlc.min(8) as usize)),
        };
        let way = if number % 3 == 0 { "T" } else { "R" };
        let (seconds, micros) = (time / 1_000_000, time % 1_000_000);
        writeln!(text, "({seconds}.{micros:06}) can{} {frame} {way}", number % 2).unwrap();
    }
    let first = logs.put("first.log", &text);
    logs.import(&[&first], "first.mcap").expect(0);
    assert_eq!(cat(&logs.path("first.mcap")), text);
    for (from, end) in FORMATS {
        // From the recording, and straight from the log, the same bytes.
        let one = format!("one-{from}.{end}");
        logs.export(&logs.path("first.mcap"), from, &one).expect(0);
        let direct = format!("direct-{from}.{end}");
        logs.export(&first, from, &direct).expect(0);
        if from != "blf" {
            assert!(
                fs::read(logs.path(&one)).unwrap() == fs::read(logs.path(&direct)).unwrap(),
                "{from}"
            );
        }
        for (to, end) in FORMATS {
            let two = format!("two-{from}-{to}.{end}");
            logs.export(&logs.path(&one), to, &two).expect(0);
            let back = format!("{from}-{to}.log");
            logs.export(&logs.path(&two), "candump", &back).expect(0);
            let back = fs::read_to_string(logs.path(&back)).unwrap();
            let (named, numbered) = (&text, text.replace("can0", "1").replace("can1", "2"));
            let errors = |text: &str| -> String {
                // BLF has other details of errors, TRC other classes, ASC none.
                text.lines()
                    .map(|line| {
                        if line.contains(" 200000") {
                            format!("{} error\n", &line[..20])
                        } else {
                            format!("{line}\n")
                        }
                    })
                    .collect()
            };
            let names_lost = [from, to].iter().any(|format| matches!(*format, "blf" | "mf4"));
            let expected = if names_lost { errors(&numbered) } else { errors(named) };
            assert_eq!(errors(&back).lines().count(), 400, "{from} {to}");
            assert!(
                errors(&back) == expected,
                "{from} to {to}:\n{}",
                difference(&errors(&back), &expected)
            );
        }
    }
}

fn difference(found: &str, expected: &str) -> String {
    let differ = found.lines().zip(expected.lines()).find(|(a, b)| a != b);
    format!("{differ:?}")
}

#[test]
fn python_can_and_scapy_read_every_output() {
    let logs = Logs::new();
    let text = frames(2, 300);
    let first = logs.put("first.log", &text);
    let expected: Vec<Value> = text.lines().map(of_line).collect();
    for (format, end) in [("candump", "log"), ("asc", "asc"), ("trc", "trc"), ("pcapng", "pcapng")]
    {
        let name = format!("out.{end}");
        logs.export(&first, format, &name).expect(0);
        let found: Vec<Value> =
            peer_reads(&logs.path(&name)).iter().map(|f| reduced(f, format)).collect();
        // Its reader of traces passes over error frames.
        let wanted = expected.iter().filter(|frame| format != "trc" || frame["error"] == false);
        let wanted: Vec<Value> = wanted.map(|frame| reduced(frame, format)).collect();
        assert_eq!(found.len(), wanted.len(), "{format}");
        for (found, wanted) in found.iter().zip(&wanted) {
            let (mut found, mut wanted) = (found.clone(), wanted.clone());
            if found["rtr"] == true && format != "asc" {
                // Only some readers tell how long the frame asked for is.
                (found["dlc"], wanted["dlc"]) = (Value::Null, Value::Null);
            }
            let late = found["time"].as_i64().unwrap() - wanted["time"].as_i64().unwrap();
            assert!(late.abs() <= 2, "{format}: {found} {wanted}");
            (found["time"], wanted["time"]) = (Value::Null, Value::Null);
            assert_eq!(found, wanted, "{format}");
        }
    }
}

#[test]
fn the_csv_of_python_can_is_read_by_it_and_what_it_has_no_column_for_is_said() {
    let logs = Logs::new();
    let text = "(1700000000.000001) can0 123#DEADBEEF R\n(1700000000.000002) can0 0012D687#R3 R\n\
                (1700000000.000003) can0 123#00 T\n";
    let first = logs.put("first.log", text);
    let ran = logs.export(&first, "python-can-csv", "out.csv").expect(0);
    assert!(ran.err.contains("does not keep direction (1 of"), "{}", ran.err);
    let found = peer_reads(&logs.path("out.csv"));
    assert_eq!((&found[0]["id"], &found[0]["data"]), (&json!(0x123), &json!("deadbeef")));
    assert_eq!(
        (&found[1]["ext"], &found[1]["rtr"], &found[1]["dlc"]),
        (&json!(true), &json!(true), &json!(3))
    );
    logs.import(&[&logs.path("out.csv")], "out.mcap").expect(0);
    assert_eq!(cat(&logs.path("out.mcap")), text.replace(" T\n", " R\n"));
}

#[test]
fn what_python_can_writes_is_read() {
    let logs = Logs::new();
    let text = frames(3, 200);
    // Its writers have no remote, error or CAN FD frames in traces and tables.
    let simple: String = text
        .lines()
        .filter(|line| !line.contains("##") && !line.contains("#R") && !line.contains(" 200000"))
        .map(|line| format!("{}\n", line.replace("can1", "can0")))
        .collect();
    for end in ["log", "asc", "trc", "csv"] {
        let path = logs.path(&format!("theirs.{end}"));
        let mut command = std::process::Command::new("sh");
        let python = python("logs.py");
        let lines: String = simple.lines().map(|line| format!("{}\n", of_line(line))).collect();
        let input = logs.put("frames.json", lines);
        command.arg("-c").arg("exec \"$0\" \"$@\" < \"$IN\"").arg(python.get_program());
        command.args(python.get_args()).arg("write").arg(&path).env("IN", input).env("TZ", "UTC");
        spawn(command).wait().expect(0);
        let name = format!("{end}.mcap");
        logs.import(&[&path], &name).expect(0);
        let found = cat(&logs.path(&name));
        let wanted = match end {
            "log" => simple.clone(),
            // Channel can0 becomes 1; direction is in no table.
            "csv" => simple.replace(" T\n", " R\n"),
            _ => simple.replace("can0", "1"),
        };
        let shift = |text: &str| -> Vec<(i64, String)> {
            text.lines()
                .map(|line| {
                    let (time, rest) = line.split_once(") ").unwrap();
                    (time[1..].replace('.', "").parse().unwrap(), rest.to_owned())
                })
                .collect()
        };
        let (found, wanted) = (shift(&found), shift(&wanted));
        assert_eq!(found.len(), wanted.len(), "{end}");
        let offset = found[0].0 - wanted[0].0;
        // Its head has milliseconds, from which its times do not count.
        assert!(offset.abs() < 1000, "{end}: {offset}");
        for (found, wanted) in found.iter().zip(&wanted) {
            assert_eq!(found.1, wanted.1, "{end}");
            assert!((found.0 - wanted.0 - offset).abs() <= 1, "{end}: {found:?} {wanted:?}");
        }
    }
}

#[test]
fn can_utils_reads_the_asc_log() {
    let logs = Logs::new();
    let text = frames(4, 100);
    // asc2log of 2020 knows no CAN FD frames without a name, and no lengths of remote frames.
    let simple: String = text
        .lines()
        .filter(|line| !line.contains("##") && !line.contains("#R") && !line.contains(" 200000"))
        .map(|line| format!("{line}\n"))
        .collect();
    let first = logs.put("first.log", &simple);
    logs.export(&first, "asc", "out.asc").expect(0);
    crate::support::peers::peers();
    let mut command = std::process::Command::new("asc2log");
    command.arg("-I").arg(logs.path("out.asc")).env("TZ", "UTC");
    let found = spawn(command).wait().expect(0).out;
    let frames = |text: &str| -> Vec<String> {
        text.lines()
            .map(|line| line.split(' ').skip(1).take(2).collect::<Vec<_>>().join(" "))
            .collect()
    };
    assert_eq!(frames(&found), frames(&simple));
}

#[test]
fn serial_bytes_go_out_as_text_as_bytes_and_as_packets_and_come_back() {
    let logs = Logs::new();
    let (rx, tx) =
        (logs.put("rx.bin", [0x7E, 1, 2, 0x7E].repeat(20)), logs.put("tx.bin", b"hello"));
    let out = logs.path("line.mcap");
    let ran = bustape(args(&[
        &"import",
        &rx,
        &tx,
        &"--format",
        &"raw",
        &"--baud",
        &"9600,8N1",
        &"--bus",
        &"rect:rx",
        &"--bus",
        &"rect:tx",
        &"--start",
        &"2026-11-22T03:15:00Z",
        &"-o",
        &out,
    ]));
    ran.expect(0);
    let text = cat(&out);
    // 5 characters of 10 bits at 9600 baud end after 5.2 ms, 25 after 26 ms.
    assert!(text.starts_with("(1795317300.005208) rect tx  68 65 6C 6C 6F"), "{text}");
    assert!(text.contains("(1795317300.026041) rect rx  7E 01 02 7E"), "{text}");
    for (format, name) in [("hex", "line.txt"), ("pcapng", "line.pcapng")] {
        logs.export(&out, format, name).expect(0);
        logs.import(&[&logs.path(name)], &format!("{format}.mcap")).expect(0);
        assert_eq!(cat(&logs.path(&format!("{format}.mcap"))), text, "{format}");
    }
    logs.export(&out, "raw", "line.bin").expect(0);
    assert_eq!(fs::read(logs.path("line.rect.rx.bin")).unwrap(), fs::read(&rx).unwrap());
    assert_eq!(fs::read(logs.path("line.rect.tx.bin")).unwrap(), fs::read(&tx).unwrap());
    // A format of CAN frames has no place for them, and says so.
    let ran = logs.export(&out, "asc", "line.asc").expect(3);
    assert!(ran.err.contains("serial frames are not in the output"), "{}", ran.err);
}

#[test]
fn selections_are_those_of_cat() {
    let logs = Logs::new();
    let text = frames(5, 200);
    let first = logs.put("first.log", &text);
    logs.import(&[&first], "first.mcap").expect(0);
    for options in [
        &["-f", "can1"][..],
        &["-f", "can0,000:400", "-f", "can1,~400:400"],
        &["--start", "+100ms", "--end", "+300ms"],
    ] {
        let mut all = args(&[&"cat", &"-x", &logs.path("first.mcap")]);
        all.extend(options.iter().map(Into::into));
        let wanted = bustape(all).expect(0).out;
        assert!(wanted.lines().count() > 10);
        for from in ["first.log", "first.mcap"] {
            let mut all =
                args(&[&"export", &logs.path(from), &"--format", &"candump", &"-o", &"-"]);
            all.extend(options.iter().map(Into::into));
            assert_eq!(bustape(all).expect(0).out, wanted, "{from} {options:?}");
        }
    }
    let ran = bustape(args(&[&"export", &first, &"--format", &"asc", &"-f", &"can9", &"-o", &"-"]));
    assert!(ran.expect(2).err.contains("no bus can9"));
}
