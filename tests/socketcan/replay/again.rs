//! Recorded, replayed and recorded again.

use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::process::{Child, Command, Stdio};

use libtest_mimic::Failed;

use super::{mixed, of, replay, report, traffic};
use crate::frames::Candump;
use crate::lab::{BUSTAPE, Recorder, cat, sh, text, wait_until};

pub fn round_trip() -> Result<(), Failed> {
    let first = mixed(2000);
    assert_eq!(first.code, Some(0), "{}", first.stderr);
    let before = cat(&first.file, &[]);
    assert_eq!(before.len(), 2001);
    let again = Recorder::start(&["a=vcan1", "b=vcan0"]);
    let to = ["--to", "a=vcan1", "--to", "b=vcan0", "--rate", "max"];
    let output = replay(&first.file, &to);
    let again = again.stop();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(report(&output)["buses"][0]["not_sent"]["error_frame"], 1);
    let after = cat(&again.file, &[]);
    for bus in ["a ", "b "] {
        let sent: Vec<_> =
            of(bus, &before).into_iter().filter(|l| !l.contains(" 20000004#")).collect();
        assert!(sent == of(bus, &after), "{bus}");
    }
    // In time, at half the speed, watched by a second listener.
    let to = ["--to", "a=vcan1", "--to", "b=vcan0", "--count", "400", "--rate", "0.5", "--verify"];
    let output = replay(&first.file, &to);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = report(&output);
    let same = |bus: usize| report["buses"][bus]["verify"]["same"].as_u64().expect("a number");
    assert_eq!(same(0) + same(1), 400, "{report}");
    // Somebody else's frame is a difference.
    let mut noise = Command::new("cangen").args(["vcan1", "-g", "1"]).spawn().expect("cangen");
    let output =
        replay(&first.file, &["--to", "a=vcan1", "--count", "300", "--rate", "0.1", "--verify"]);
    noise.kill().expect("ours");
    noise.wait().expect("ours");
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("is not what was sent: vcan1, frame"));
    Ok(())
}

/// Frames on two buses, and pieces on a serial line.
const FRAMES: usize = 80_000;
const PIECES: usize = 20_000;

/// Piece `number` of the line.
fn piece(number: usize) -> Vec<u8> {
    (0..=number % 7).map(|byte| (number * 31 + byte * 101).to_le_bytes()[0]).collect()
}

/// The bytes of the serial line that `cat` shows, in hexadecimal. Long pieces take several lines, of
/// which only the first has a time and a name.
fn bytes_of(lines: &[String]) -> String {
    let (mut ours, mut all) = (false, String::new());
    for line in lines {
        let dump = match line.split_once(" line rx ") {
            Some((_, dump)) => dump,
            None => line,
        };
        ours = dump.len() < line.len() || ours && !line.starts_with('(');
        if ours {
            let hex = dump.split_whitespace().take_while(|word| !word.starts_with('|'));
            all.extend(hex);
        }
    }
    all
}

/// The same frames and bytes twice, by two programs: by candump, and by ourselves.
pub fn hundred_thousand() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let (tty, back) = (folder.path().join("tty"), folder.path().join("back"));
    let bytes: Vec<u8> = (0..PIECES).flat_map(piece).collect();

    let candump = Candump::start(&["vcan0", "vcan1"]);
    let recorder = Recorder::start(&["a=vcan0", "b=vcan1", &format!("line=pty:{}", tty.display())]);
    let writer = std::thread::spawn(move || {
        let flags = libc::O_NOCTTY;
        let line = std::fs::OpenOptions::new().write(true).custom_flags(flags).open(tty);
        let mut line = line.expect("the terminal opens");
        (0..PIECES).for_each(|number| line.write_all(&piece(number)).expect("it is written"));
    });
    sh(&traffic(FRAMES));
    writer.join().expect("all bytes are written");
    let first = recorder.stop();
    let seen = candump.lines(FRAMES + 1);
    assert_eq!(first.code, Some(0), "{}", first.stderr);

    let candump = Candump::start(&["vcan0", "vcan1"]);
    let mut player = Player::start(&first.file, &back.display().to_string());
    wait_until("the terminal", || back.exists());
    let line = format!("line={},115200,8N1", back.display());
    let again = Recorder::start(&["a=vcan0", "b=vcan1", &line]);
    player.resume();
    let sent = player.finish();
    let again = again.stop();
    let seen_again = candump.lines(FRAMES);
    // The line has gone with its replay, which is a gap; nothing else is missing.
    assert_eq!((again.count(0, "dropped"), again.count(1, "dropped")), (0, 0), "{}", again.stderr);
    assert_eq!(sent["buses"][0]["not_sent"]["error_frame"], 1, "{sent}");

    let without_error = |lines: &[String]| -> Vec<String> {
        lines.iter().filter(|line| !line.contains(" 20000004#")).cloned().collect()
    };
    let (seen, before) = (without_error(&seen), cat(&first.file, &[]));
    let after = cat(&again.file, &[]);
    assert_eq!((seen.len(), seen_again.len()), (FRAMES, FRAMES));
    for (interface, bus) in [("vcan0 ", "a "), ("vcan1 ", "b ")] {
        assert!(of(interface, &seen) == of(interface, &seen_again), "{interface} by candump");
        assert!(of(bus, &without_error(&before)) == of(bus, &after), "{bus} by cat");
    }
    let expected = bytes.iter().fold(String::new(), |text, byte| text + &format!("{byte:02X}"));
    assert!(bytes_of(&before) == expected && bytes_of(&after) == expected);
    Ok(())
}

/// A replay that waits until it is told to begin.
struct Player(Child);

impl Player {
    fn start(file: &std::path::Path, back: &str) -> Self {
        let child = Command::new(BUSTAPE)
            .args(["replay", "--json", "--rate", "max", "--paused", "--control", "-"])
            .args(["--to", "a=vcan0", "--to", "b=vcan1", "--to", &format!("line=pty:{back}")])
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        Self(child.expect("bustape runs"))
    }

    fn resume(&mut self) {
        let script = self.0.stdin.take();
        script.expect("piped").write_all(b"resume\n").expect("it listens");
    }

    fn finish(self) -> serde_json::Value {
        let output = self.0.wait_with_output().expect("bustape ends");
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        report(&output)
    }
}
