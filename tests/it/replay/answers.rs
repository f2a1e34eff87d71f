//! A replay that answers like the recorded device.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Stdio};
use std::time::Duration;

use bustape::frame::Direction;
use bustape::recording::writer::Layout;
use serde_json::Value;

use super::{MILLI, Made, serial};
use crate::support::make::at;
use crate::support::process::{args, bustape, spawn, start};
use crate::support::terminal::open;
use crate::support::{peers, until};

/// A Python script that talks with the test by lines.
pub struct Script {
    child: Child,
    to: ChildStdin,
    from: BufReader<std::process::ChildStdout>,
}

pub fn spawn_script(name: &str) -> Script {
    let mut command = peers::python(name);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let (to, from) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
    Script { child, to, from: BufReader::new(from) }
}

impl Script {
    pub fn hear(&mut self) -> String {
        let mut line = String::new();
        self.from.read_line(&mut line).unwrap();
        assert!(!line.is_empty(), "the script has ended");
        line.trim_end().to_owned()
    }

    pub fn say(&mut self, line: &str) {
        writeln!(self.to, "{line}").unwrap();
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// A recording of the simulated rectifier with its master, and its frames by `explain`.
fn dialogue() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("dialogue.mcap");
    bustape(args(&[&"record", &"rect=sim:zhongheng-09", &"-o", &file, &"--duration", &"4s"]))
        .expect(0);
    (folder, file)
}

/// A recording of a supervision computer that polls and sets up the simulated rectifier.
fn session() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let [rectifier, line, file] =
        ["rectifier", "line", "session.mcap"].map(|name| folder.path().join(name));
    let address = format!("pty:{}", rectifier.display());
    let device = start(["simulate", "zhongheng-09", &address, "--seed", "5"]);
    until("the rectifier", || rectifier.exists().then_some(()));
    let bridge = format!("rect=bridge:{},19200,8N1@{}", rectifier.display(), line.display());
    let recorder = start(args(&[&"record", &bridge, &"-o", &file]));
    until("the bridge", || line.exists().then_some(()));
    let mut master = peers::python("rectifier_master.py");
    master.arg(&line).arg("poll");
    spawn(master).wait().expect(0);
    recorder.stop().expect(0);
    device.stop().expect(0);
    (folder, file)
}

/// What a master says that asks a replay of `file` for everything; and the replay's report.
fn asked(folder: &Path, file: &Path, master: &str, options: &[&str]) -> (Value, Value, String) {
    let tty = folder.join("tty");
    let to = format!("rect=pty:{}", tty.display());
    let mut all = args(&[&"replay", &file, &"--to", &to, &"--answer", &"rect", &"--json"]);
    all.extend(["--decode", "rect=zhongheng-09"].iter().chain(options).map(Into::into));
    let running = start(all);
    until("the terminal", || tty.exists().then_some(()));
    // The script knows the protocol by itself, and the recording by its text.
    let mut script = spawn_script("master.py");
    let text = bustape(args(&[&"cat", &file])).expect(0).out;
    let dump = folder.join("dump.txt");
    std::fs::write(&dump, text).unwrap();
    script.say(&format!("{} {} {master}", tty.display(), dump.display()));
    let report: Value = serde_json::from_str(&script.hear()).unwrap();
    assert_eq!(report["problems"], serde_json::json!([]), "{report}");
    let ran = running.stop().expect(0);
    let answers = ran.json()["buses"][0]["answers"].clone();
    assert_eq!(answers["requests"], report["asked"], "{answers}");
    assert_eq!((&answers["never_recorded"], &answers["damaged"]), (&1.into(), &1.into()));
    assert!(ran.err.contains("never recorded: read 0x3abc"), "{}", ran.err);
    (report, answers, ran.err)
}

#[test]
fn a_master_of_somebody_else_understands_every_answer() {
    let (folder, file) = dialogue();
    let options = ["--delay", "none", "--unknown", "error"];
    let (report, ..) = asked(folder.path(), &file, "cycle error 12", &options);
    assert!(report["kinds"].as_u64().unwrap() >= 5, "{report}");
    assert!(report["repeats"].as_u64().unwrap() > 10, "{report}");
}

#[test]
fn set_commands_are_acknowledged_as_recorded_and_the_last_answer_stays() {
    let (folder, file) = session();
    let (report, ..) = asked(folder.path(), &file, "last silent 3", &["--repeat", "last"]);
    assert!(report["kinds"].as_u64().unwrap() >= 35, "{report}");
    assert!(report["sets"].as_u64().unwrap() >= 3, "{report}");
    assert!(report["repeats"].as_u64().unwrap() > 10, "{report}");
}

#[test]
fn without_a_definition_requests_are_known_by_their_bytes() {
    let (rx, tx) = (Direction::Rx, Direction::Tx);
    let made = Made::new(
        Layout::Frame,
        &[
            (1, at(0, serial(tx, b"AT+"))),
            (1, at(MILLI, serial(tx, b"V\r"))),
            (1, at(5 * MILLI, serial(rx, b"1.0\r"))),
            (1, at(500 * MILLI, serial(tx, b"AT+V\r"))),
            (1, at(505 * MILLI, serial(rx, b"2.0"))),
            (1, at(507 * MILLI, serial(rx, b"\r"))),
        ],
    );
    for (repeat, expected) in [("cycle", "1.0\r2.0\r1.0\r2.0\r"), ("last", "1.0\r2.0\r2.0\r2.0\r")]
    {
        let tty = made.path(repeat);
        let to = format!("line=pty:{}", tty.display());
        let running = start(args(&[
            &"replay",
            &made.file,
            &"--to",
            &to,
            &"--answer",
            &"line",
            &"--repeat",
            &repeat,
            &"--json",
        ]));
        let mut terminal = open(&tty);
        let mut heard = String::new();
        for _ in 0..4 {
            terminal.write_all(b"AT+V\r").unwrap();
            let mut answer = [0; 4];
            terminal.read_exact(&mut answer).unwrap();
            heard.push_str(std::str::from_utf8(&answer).unwrap());
        }
        assert_eq!(heard, expected);
        terminal.write_all(b"AT+X\r").unwrap();
        std::thread::sleep(Duration::from_millis(200));
        let ran = running.stop().expect(0);
        let answers = ran.json()["buses"][0]["answers"].clone();
        assert_eq!((&answers["answered"], &answers["never_recorded"]), (&4.into(), &1.into()));
        assert!(ran.err.contains("never recorded: [41 54 2B 58 0D]"), "{}", ran.err);
    }
}

#[test]
fn a_count_of_answers_counts_requests_and_not_the_pieces_of_an_answer() {
    let (rx, tx) = (Direction::Rx, Direction::Tx);
    let made = Made::new(
        Layout::Frame,
        &[
            (1, at(0, serial(tx, b"?"))),
            (1, at(MILLI, serial(rx, b"1"))),
            (1, at(2 * MILLI, serial(rx, b"2"))),
            (1, at(3 * MILLI, serial(rx, b"3"))),
            (1, at(500 * MILLI, serial(tx, b"!"))),
        ],
    );
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let mut all = args(&[&"replay", &made.file, &"--to", &to]);
    all.extend(["--answer", "line", "--count", "2", "--json"].iter().map(Into::into));
    let running = start(all);
    let mut terminal = open(&tty);
    for _ in 0..2 {
        // What has no answer does not count.
        terminal.write_all(b"!?").unwrap();
        let mut answer = [0; 3];
        terminal.read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"123");
    }
    let report = running.wait().expect(0).json();
    assert_eq!(report["reason"], "count");
    assert_eq!(report["buses"][0]["answers"]["answered"], 2, "{report}");
}
