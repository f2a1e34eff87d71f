//! What was recorded, replayed and recorded again is the same.

use std::io::{Read as _, Write as _};
use std::path::Path;

use bustape::capture::slcan::codec::encode;
use bustape::frame::{CanFlags, CanFrame, Direction};
use bustape::recording::writer::Layout;
use nix::sys::termios::{InputFlags, SetArg, cfmakeraw, tcgetattr, tcsetattr};

use super::{Controlled, MILLI, Made, serial};
use crate::support::adapter::Adapters;
use crate::support::bytes::{Random, noise};
use crate::support::make::at;
use crate::support::process::{args, start};
use crate::support::terminal::open;
use crate::support::{mcap, messages, until};

#[test]
fn bytes_are_recorded_again_as_they_were_and_compare_as_the_same() {
    let pieces: Vec<_> = (0..400u64)
        .map(|n| (1, at(n * MILLI, serial(Direction::Rx, &noise(n, 1 + n as usize % 300)))))
        .collect();
    let all: Vec<u8> = (0..400u64).flat_map(|n| noise(n, 1 + n as usize % 300)).collect();
    let made = Made::new(Layout::Frame, &pieces);
    let (tty, again) = (made.path("tty"), made.path("again.mcap"));
    let to = format!("line=pty:{}", tty.display());
    let mut replay = Controlled::start(&made.file, &["--to", &to, "--rate", "max"]);
    until("the terminal", || tty.exists().then_some(()));
    let bus = format!("line={},115200,8N1", tty.display());
    let recorder = start(args(&[&"record", &bus, &"-o", &again]));
    let part = made.path("again.mcap.part");
    until("the recording", || part.exists().then_some(()));
    replay.say("resume");
    until("all bytes", || {
        (messages::streams(&mcap::cut(&part), "line").0.len() == all.len()).then_some(())
    });
    let (code, report, _) = replay.end();
    assert_eq!((code, &report["buses"][0]["bytes"]), (0, &all.len().into()), "{report}");
    assert!(std::fs::symlink_metadata(&tty).is_err(), "the link stays behind");
    // Who made a terminal takes no share of it.
    let said = recorder.stop().err;
    assert!(!said.contains("also open in process"), "{said}");
    assert!(messages::streams(&mcap::finished(&again), "line").0 == all);

    let verified = made.replay(&["--to", &to, "--verify", "--rate", "20", "--json"]).expect(0);
    let report = verified.json()["buses"][0]["verify"].clone();
    assert_eq!(report["same"], all.len(), "{report}");
}

#[test]
fn a_byte_that_arrives_as_another_is_the_first_difference() {
    let made = Made::new(
        Layout::Frame,
        &[
            (1, at(0, serial(Direction::Rx, b"good"))),
            (1, at(MILLI, serial(Direction::Rx, b"bad\r"))),
        ],
    );
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let mut replay = Controlled::start(&made.file, &["--to", &to, "--verify"]);
    let terminal = open(&tty);
    replay.ask("status", "paused at");
    // Another program makes line feeds of carriage returns.
    let mut mode = tcgetattr(&terminal).unwrap();
    mode.input_flags.insert(InputFlags::ICRNL);
    tcsetattr(&terminal, SetArg::TCSANOW, &mode).unwrap();
    replay.say("resume");
    let (code, report, said) = replay.end();
    assert_eq!(code, 1, "{said}");
    assert_eq!(report["buses"][0]["verify"]["same"], 4, "{report}");
    assert!(said.contains("byte 8: 0D was sent, 0A arrived"), "{said}");
}

/// What a program has an adapter send: frames of every kind, with and without CAN FD.
fn lines_of_all_kinds(seed: u64, count: usize) -> Vec<String> {
    let mut random = Random::new(seed);
    let (extended, remote) = (CanFlags::EXTENDED, CanFlags::REMOTE);
    let (fd, fast) = (CanFlags::FD, CanFlags::FD | CanFlags::BRS);
    let kinds = [CanFlags::default(), extended, remote, extended | remote, fd, fast | extended];
    let line = |number| {
        let flags = kinds[random.below(kinds.len())];
        let most = if flags.has(extended) { 0x2000_0000 } else { 0x800 };
        let length = match flags {
            _ if flags.has(remote) => 0,
            _ if flags.has(fd) => [0, 7, 8, 12, 32, 64][random.below(6)],
            _ => random.below(9),
        };
        let data = noise(number, length);
        encode(&CanFrame::new(random.below(most) as u32, flags, &data)).unwrap()
    };
    (0..count as u64).map(line).collect()
}

/// A program that has an adapter send these lines, as fast as the adapter takes them.
fn send(port: &Path, lines: &[String]) {
    let mut terminal = open(port);
    let mut mode = tcgetattr(&terminal).unwrap();
    cfmakeraw(&mut mode);
    tcsetattr(&terminal, SetArg::TCSANOW, &mode).unwrap();
    for some in lines.chunks(50) {
        terminal.write_all(some.concat().as_bytes()).unwrap();
        let mut acknowledged = vec![0; 2 * some.len()];
        terminal.read_exact(&mut acknowledged).unwrap();
    }
}

/// The frames of a bus in a recording, as the lines of an adapter.
fn lines_in(file: &mcap::Mcap, bus: &str) -> Vec<String> {
    messages::cans(file, bus).iter().map(|(_, can)| encode(can).unwrap()).collect()
}

#[test]
fn a_hundred_thousand_frames_of_all_kinds_are_recorded_replayed_and_recorded_again() {
    let folder = tempfile::tempdir().unwrap();
    let [first, again] = ["first.mcap", "again.mcap"].map(|name| folder.path().join(name));
    let (tty, back) = (folder.path().join("tty"), folder.path().join("back"));
    let buses = [Adapters::new(), Adapters::new()];
    let sent = [1, 2].map(|seed| lines_of_all_kinds(seed, 40_000));
    let pieces: Vec<Vec<u8>> = (0..20_000).map(|n| noise(n, 1 + n as usize % 30)).collect();
    let bytes = pieces.concat();
    let hears = |number: usize| {
        let port = buses[number].receiver().display();
        format!("can{number}=slcan:{port}@500000/2000000")
    };
    let record = |layout: &str, line: &str, file: &Path| {
        let recorder = start(args(&[
            &"record",
            &hears(0),
            &hears(1),
            &line,
            &"--layout",
            &layout,
            &"-o",
            &file,
        ]));
        let part = file.with_extension("mcap.part");
        let listens = || part.exists() && buses.iter().all(Adapters::is_open);
        until("the recording", || listens().then_some(()));
        recorder
    };

    let recorder = record("batch", &format!("line=pty:{}", tty.display()), &first);
    std::thread::scope(|scope| {
        for (bus, lines) in buses.iter().zip(&sent) {
            scope.spawn(|| send(bus.sender(), lines));
        }
        let mut line = open(&tty);
        for piece in &pieces {
            line.write_all(piece).unwrap();
        }
    });
    // What has arrived by now is still recorded.
    recorder.stop().expect(0);

    let line = format!("line={},115200,8N1", back.display());
    let to = |number: usize| {
        let port = buses[number].sender().display();
        format!("can{number}=slcan:{port}@500000/2000000")
    };
    let ports = [0, 1].map(|number| buses[number].sender().display().to_string());
    let (can0, can1, terminal) = (to(0), to(1), format!("line=pty:{}", back.display()));
    let mut replay = Controlled::start(
        &first,
        &[
            "--to",
            &can0,
            "--to",
            &can1,
            "--to",
            &terminal,
            "--rate",
            "max",
            "--yes",
            "--transmit-on",
            &ports[0],
            "--transmit-on",
            &ports[1],
        ],
    );
    until("the terminal", || back.exists().then_some(()));
    let recorder = record("frame", &line, &again);
    replay.say("resume");
    let (code, report, said) = replay.end();
    assert_eq!(code, 0, "{said}");
    // Its line has gone with the replay, which is a gap.
    recorder.stop();
    assert_eq!(report["buses"][0]["sent"], 40_000, "{report}");
    for file in [mcap::finished(&first), mcap::finished(&again)] {
        assert!(lines_in(&file, "can0") == sent[0] && lines_in(&file, "can1") == sent[1]);
        assert!(messages::streams(&file, "line").0 == bytes);
    }
}
