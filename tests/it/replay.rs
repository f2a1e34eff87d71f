//! `bustape replay`: onto terminals and text, controlled, answering, refusing. CAN interfaces are
//! in `tests/socketcan`.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Stdio};
use std::time::{Duration, Instant};

use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, SerialBytes, Stamped, Timestamp, Unit,
};
use bustape::recording::writer::Layout;
use serde_json::Value;

use crate::support::bytes::{Random, noise};
use crate::support::make::{START, at, make};
use crate::support::process::{Ran, args, bustape, spawn, start};
use crate::support::terminal::open;
use crate::support::until;

mod again;
mod answers;
mod control;
mod permission;
mod slow;

const MILLI: u64 = 1_000_000;

fn can(id: u32, flags: CanFlags, data: &[u8]) -> Frame {
    Frame::Can(CanFrame::new(id, flags, data))
}

fn serial(direction: Direction, data: &[u8]) -> Frame {
    Frame::Serial(SerialBytes { direction, data: data.to_vec(), errors: Vec::new() })
}

fn gap(nanos: u64) -> Frame {
    let time = Timestamp(START + nanos);
    let (unit, reason) = (Unit::Frames, GapReason::KernelQueue);
    Frame::Gap(Gap { count: 12, unit, reason, from: time, to: time })
}

/// A folder with a recording of two buses in it: `can0` and `line`.
struct Made {
    folder: tempfile::TempDir,
    file: PathBuf,
}

impl Made {
    fn new(layout: Layout, frames: &[(usize, Stamped<Frame>)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.mcap");
        make(&file, layout, &["can0", "line"], frames);
        Self { folder, file }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn replay(&self, more: &[&str]) -> Ran {
        let mut all = args(&[&"replay", &self.file]);
        all.extend(more.iter().map(Into::into));
        bustape(all)
    }
}

/// Frames of every kind, a millisecond apart, with bytes of both directions between them.
fn mixed(count: u64) -> Vec<(usize, Stamped<Frame>)> {
    let mut random = Random::new(7);
    let mut frames = Vec::new();
    for number in 0..count {
        let data = random.next().to_le_bytes();
        let id = random.below(0x700) as u32;
        let frame = match number % 8 {
            0 => can(id, CanFlags::FD | CanFlags::BRS, &[data, data].concat()),
            1 => can(id << 8, CanFlags::EXTENDED | CanFlags::TX, &data),
            2 => Frame::Can(CanFrame::new(id, CanFlags::REMOTE, &[]).with_dlc(4)),
            3 => can(4, CanFlags::ERROR, &data),
            4 => serial(Direction::Rx, &data[..5]),
            5 => serial(Direction::Tx, &data[..3]),
            _ => can(id, CanFlags::default(), &data[..number as usize % 8]),
        };
        frames.push((usize::from(matches!(frame, Frame::Serial(_))), at(number * MILLI, frame)));
    }
    frames
}

fn lines(text: &str) -> Vec<&str> {
    text.lines().collect()
}

#[test]
fn a_trace_shows_what_cat_shows_in_either_layout() {
    for layout in [Layout::Frame, Layout::Batch] {
        let made = Made::new(layout, &mixed(3000));
        let cat = bustape(args(&[&"cat", &made.file])).expect(0).out;
        let ran =
            made.replay(&["--to", "can0=trace:", "--to", "line=trace:", "--rate", "max"]).expect(0);
        assert!(ran.out == cat, "{layout:?}");
        assert_eq!(lines(&cat).len(), 3000);
        assert!(ran.err.contains("2,250") && ran.err.contains("finished"), "{}", ran.err);
    }
}

#[test]
fn only_what_was_chosen_is_played_and_the_rest_is_counted() {
    let made = Made::new(
        Layout::Frame,
        &[
            (0, at(0, can(0x123, CanFlags::default(), &[1]))),
            (0, at(MILLI, can(0x123, CanFlags::TX, &[2]))),
            (0, at(2 * MILLI, can(0x124, CanFlags::default(), &[3]))),
            (0, at(3 * MILLI, can(0x123, CanFlags::EXTENDED, &[4]))),
            (1, at(4 * MILLI, serial(Direction::Rx, b"device"))),
            (1, at(5 * MILLI, serial(Direction::Tx, b"host"))),
            (0, at(6 * MILLI, gap(6 * MILLI))),
            (0, at(9 * MILLI, can(0x123, CanFlags::default(), &[5]))),
        ],
    );
    let trace = |more: &[&str]| {
        let mut all = vec!["--to", "can0=trace:", "--rate", "max", "--json"];
        all.extend(more);
        let ran = made.replay(&all).expect(0);
        let report: Value = serde_json::from_str(ran.err.lines().last().unwrap()).unwrap();
        let frames = ran.out.lines().map(|line| line.rsplit(' ').next().unwrap().to_owned());
        (frames.collect::<Vec<_>>(), report["buses"][0].clone(), ran.err)
    };
    let (frames, report, said) = trace(&[]);
    assert_eq!(frames, ["123#01", "123#02", "124#03", "00000123#04", "123#05"]);
    assert_eq!((&report["sent"], &report["gaps"]), (&5.into(), &1.into()));
    assert!(said.contains("not sent, since there is no --to for it: line"), "{said}");
    assert!(said.contains("can0 lost 12 frames"), "{said}");
    let (frames, report, _) = trace(&["--filter", "can0,123:7FF", "--only", "rx"]);
    assert_eq!(frames, ["123#01", "00000123#04", "123#05"]);
    assert_eq!(report["not_sent"], serde_json::json!({ "filtered": 1, "other_direction": 1 }));
    assert_eq!(trace(&["--count", "2"]).0, ["123#01", "123#02"]);
    assert_eq!(trace(&["--start", "+2ms", "--duration", "1ms"]).0, ["124#03", "00000123#04"]);
    assert_eq!(trace(&["--start", "+9ms", "--loop", "3"]).0, ["123#05"; 3]);
    let (frames, ..) = trace(&["--remap", "can0:123=456", "--remap", "can0:124=1234567F"]);
    assert_eq!(frames, ["456#01", "456#02", "1234567F#03", "00000123#04", "456#05"]);
    let ran = made.replay(&["--to", "line=trace:", "--only", "line:tx", "--remap", "line=rs232"]);
    assert_eq!(ran.expect(0).out.split_whitespace().nth(1), Some("rs232"));
}

#[test]
fn messages_are_chosen_and_renamed_by_their_names() {
    let made = Made::new(
        Layout::Frame,
        &[
            (0, at(0, can(0x0001_0001, CanFlags::EXTENDED, &[7; 5]))),
            (0, at(MILLI, can(0x0013_0003, CanFlags::EXTENDED, &[1; 8]))),
        ],
    );
    let to = ["--to", "can0=trace:", "--rate", "max", "--decode", "can0=hmi-can"];
    let run = |more: &[&str]| made.replay(&[&to[..], more].concat());
    let one = run(&["--message", "CONFIG_3"]).expect(0).out;
    assert!(lines(&one).len() == 1 && one.contains(" 00130003#"), "{one}");
    let renamed = run(&["--remap", "can0:CONFIG_3=00130055"]).expect(0).out;
    assert!(lines(&renamed).len() == 2 && renamed.contains(" 00130055#"), "{renamed}");
    assert!(run(&["--message", "CONFIG_99"]).expect(2).err.contains("no message CONFIG_99"));
    let unnamed = made.replay(&["--to", "can0=trace:", "--message", "CONFIG_3"]).expect(2);
    assert!(unnamed.err.contains("--decode can0=PROTOCOL"), "{}", unnamed.err);
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_sent() {
    let made = Made::new(Layout::Frame, &mixed(16));
    for (more, code, part) in [
        (vec!["--to", "x=trace:"], 2, "no bus x, only can0, line"),
        (vec!["--to", "can0"], 2, "BUS=ADDRESS"),
        (vec!["--to", "can0=pty:/tmp/never"], 2, "is a CAN bus"),
        (vec!["--to", "line=vcan0"], 2, "is a serial line"),
        (vec!["--to", "can0=trace:", "--to", "can0=vcan0"], 2, "has a target already"),
        (vec!["--to", "can0=trace:", "--rate", "0"], 2, "0.1 to 100"),
        (vec!["--to", "can0=trace:", "--start", "+10s"], 2, "nothing is left"),
        (vec!["--to", "can0=trace:", "--start", "10s"], 2, "\"10s\" is not a time"),
        (vec!["--to", "can0=trace:", "--filter", "line,1:2"], 2, "no --to for line"),
        (vec!["--to", "can0=trace:", "--filter", "123:7FF"], 2, "e.g. can0,123:7FF"),
        (vec!["--to", "line=trace:", "--filter", "line,1:2"], 2, "only CAN buses"),
        (vec!["--to", "line=trace:", "--message", "FOO"], 2, "only CAN buses have messages"),
        (vec!["--to", "line=trace:", "--message", "line:FOO"], 2, "only CAN buses have messages"),
        (vec!["--to", "line=trace:", "--message", "can0:FOO"], 2, "no --to for can0"),
        (vec!["--to", "line=trace:", "--remap", "line:123=456"], 2, "has no identifiers"),
        (vec!["--to", "can0=trace:", "--remap", "can0:123=XYZ"], 2, "no identifier"),
        (vec!["--to", "can0=trace:", "--verify"], 2, "does not hand back"),
        (vec!["--to", "can0=trace:", "--answer", "line"], 2, "say where with --to"),
        (vec!["--to", "can0=trace:", "--transmit-on", "can0"], 2, "the targets are trace:"),
        (vec!["--to", "can0=nosuchcan7"], 1, "there is no interface nosuchcan7"),
        (vec!["--to", "can0=lo"], 1, "lo is not a CAN interface"),
    ] {
        let ran = made.replay(&more).expect(code);
        assert!(ran.err.contains(part), "{more:?}: {}", ran.err);
        assert_eq!(ran.out, "", "{more:?}");
    }
}

#[test]
fn a_recording_that_was_cut_off_is_played_as_far_as_it_goes() {
    let made = Made::new(Layout::Frame, &mixed(1000));
    let whole = std::fs::read(&made.file).unwrap();
    std::fs::write(&made.file, &whole[..whole.len() * 2 / 3]).unwrap();
    let cat = bustape(args(&[&"cat", &made.file]));
    let ran = made.replay(&["--to", "can0=trace:", "--to", "line=trace:", "--rate", "max"]);
    let ran = ran.expect(3);
    assert!(ran.out == cat.out && lines(&ran.out).len() > 300);
    assert!(ran.err.contains("was not finished"), "{}", ran.err);
}

#[test]
fn two_buses_of_one_name_and_different_kinds_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [can_file, line_file] = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    let frame = can(1, CanFlags::default(), &[]);
    make(&can_file, Layout::Frame, &["x"], &[(0, at(0, frame))]);
    make(&line_file, Layout::Frame, &["x"], &[(0, at(MILLI, serial(Direction::Rx, b"a")))]);
    for files in [[&can_file, &line_file], [&line_file, &can_file]] {
        let ran = bustape(args(&[&"replay", files[0], files[1], &"--to", &"x=trace:"])).expect(2);
        assert!(ran.err.contains("a serial line in another"), "{}", ran.err);
    }
}

#[test]
fn who_answers_has_a_target_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let piece = |n, direction, data: &[u8]| (n, at(n as u64 * MILLI, serial(direction, data)));
    let pieces = [piece(0, Direction::Tx, b"a"), piece(1, Direction::Tx, b"b")];
    make(&file, Layout::Frame, &["a", "b"], &pieces);
    let tty = folder.path().join("tty");
    let [a, b] = ["a", "b"].map(|bus| format!("{bus}=pty:{}", tty.display()));
    let all = [&"replay" as &dyn AsRef<std::ffi::OsStr>, &file, &"--to", &a, &"--to", &b];
    for answered in [&["--answer", "a", "--answer", "b"][..], &["--answer", "b"]] {
        let mut command = args(&all);
        command.extend(answered.iter().map(Into::into));
        let ran = bustape(command).expect(2);
        assert!(ran.err.contains("--answer b: pty:") && !tty.exists(), "{}", ran.err);
    }
}

/// A reader of a terminal: all that comes until it is hung up, or until there are `count` bytes.
fn read_from(path: &Path, count: usize) -> std::thread::JoinHandle<Vec<u8>> {
    let mut terminal = open(path);
    std::thread::spawn(move || {
        let (mut all, mut buffer) = (Vec::new(), [0; 4096]);
        while all.len() < count {
            match terminal.read(&mut buffer) {
                Ok(length @ 1..) => all.extend_from_slice(&buffer[..length]),
                _ => break,
            }
        }
        all
    })
}

/// A child that does not outlive its test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A replay that takes commands by its stdin.
struct Controlled {
    child: Killed,
    to: Option<ChildStdin>,
    said: BufReader<std::process::ChildStderr>,
}

impl Controlled {
    fn start(file: &Path, more: &[&str]) -> Self {
        let mut child = std::process::Command::new(crate::support::process::BUSTAPE)
            .args(["replay", "--control", "-", "--paused", "--json"])
            .arg(file)
            .args(more)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let to = child.stdin.take();
        let said = BufReader::new(child.stderr.take().unwrap());
        Self { child: Killed(child), to, said }
    }

    fn say(&mut self, line: &str) {
        writeln!(self.to.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Asks and returns the line that has `part`.
    fn ask(&mut self, line: &str, part: &str) -> String {
        self.say(line);
        loop {
            let mut heard = String::new();
            let length = self.said.read_line(&mut heard).unwrap();
            assert!(length > 0, "the replay has ended");
            if heard.contains(part) {
                return heard;
            }
        }
    }

    fn end(mut self) -> (i32, Value, String) {
        drop(self.to.take());
        let mut rest = String::new();
        self.said.read_to_string(&mut rest).unwrap();
        let mut out = String::new();
        self.child.0.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        let code = self.child.0.wait().unwrap().code().unwrap();
        let report = out.lines().last().unwrap_or_default();
        (code, serde_json::from_str(report).unwrap_or_default(), rest)
    }
}

#[test]
fn a_terminal_goes_on_without_readers_and_when_they_come_back() {
    let pieces: Vec<_> =
        (0..100u64).map(|n| (1, at(n * MILLI, serial(Direction::Rx, &[n as u8])))).collect();
    let made = Made::new(Layout::Frame, &pieces);
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let mut replay = Controlled::start(&made.file, &["--to", &to]);
    until("the terminal", || tty.exists().then_some(()));
    replay.ask("step 10", "paused at");
    replay.ask("status", "0 sent");
    let (code, report, _) = {
        replay.say("quit");
        replay.end()
    };
    // Nobody was there, so nobody was sent anything.
    let bus = &report["buses"][0];
    assert_eq!((code, &bus["sent"], &bus["not_sent"]["nobody_there"]), (0, &0.into(), &10.into()));

    let mut replay = Controlled::start(&made.file, &["--to", &to]);
    for from in [0, 20] {
        let reader = read_from(&tty, 10);
        replay.say("step 10");
        let expected: Vec<u8> = (from..from + 10).collect();
        assert_eq!(reader.join().unwrap(), expected);
        replay.ask("step 10", "paused at");
        std::thread::sleep(Duration::from_millis(50));
    }
    replay.say("quit");
    let (code, report, _) = replay.end();
    assert_eq!((code, report["reason"].as_str()), (0, Some("quit")));
}

#[test]
fn a_paced_line_takes_its_time() {
    let made = Made::new(Layout::Frame, &[(1, at(0, serial(Direction::Rx, &noise(1, 960))))]);
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let running =
        start(args(&[&"replay", &made.file, &"--to", &to, &"--pace", &"9600", &"--json"]));
    let reader = read_from(&tty, 960);
    let began = Instant::now();
    let heard = reader.join().unwrap();
    // 960 bytes of 10 bits are one second. Those that came before the reader was there are lost.
    assert!(heard.len() > 100 && noise(1, 960).ends_with(&heard), "{}", heard.len());
    assert!(began.elapsed() >= Duration::from_millis(heard.len() as u64 * 9 / 10));
    let report = running.wait().expect(0).json();
    assert!(report["took_ns"].as_u64().unwrap() >= 999_000_000 - 1_100_000, "{report}");
}

#[test]
fn several_recordings_run_side_by_side_on_one_clock() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let cans: Vec<_> =
        (0..50).map(|n| (0, at(n * 2 * MILLI, can(n as u32, CanFlags::default(), &[])))).collect();
    let lines: Vec<_> =
        (0..50).map(|n| (0, at((n * 2 + 1) * MILLI, serial(Direction::Rx, &[n as u8])))).collect();
    make(&a, Layout::Frame, &["can0"], &cans);
    make(&b, Layout::Frame, &["rect"], &lines);
    let ran = bustape(args(&[
        &"replay",
        &b,
        &a,
        &"--to",
        &"can0=trace:",
        &"--to",
        &"rect=trace:",
        &"--rate",
        &"10",
    ]));
    let out = ran.expect(0).out;
    let buses: Vec<&str> = out.lines().map(|l| l.split(' ').nth(1).unwrap()).collect();
    assert_eq!(buses, ["can0", "rect"].repeat(50));
}

#[test]
fn a_reader_of_a_trace_that_comes_late_gets_everything() {
    let made = Made::new(Layout::Batch, &mixed(40_000));
    let mut command = std::process::Command::new("sh");
    // Longer than it takes to fill the pipe and all that waits for it.
    let replay = format!(
        "{} replay {} --to can0=trace: --rate max | (sleep 1; cat)",
        crate::support::process::BUSTAPE,
        made.file.display()
    );
    command.args(["-c", &replay]);
    let ran = spawn(command).wait().expect(0);
    let cat = bustape(args(&[&"cat", &made.file, &"-f", &"can0"])).expect(0).out;
    assert!(ran.out == cat && lines(&cat).len() == 30_000);
}

#[test]
fn a_reader_of_a_trace_that_goes_away_ends_it_without_a_complaint() {
    let made = Made::new(Layout::Frame, &mixed(2000));
    let mut command = std::process::Command::new("sh");
    let replay = format!(
        "{} replay {} --to can0=trace: --loop forever --rate max | head -n 3",
        crate::support::process::BUSTAPE,
        made.file.display()
    );
    command.args(["-c", &replay]);
    let ran = spawn(command).wait().expect(0);
    assert_eq!(lines(&ran.out).len(), 3);
    assert!(!ran.err.contains("error"), "{}", ran.err);
}
