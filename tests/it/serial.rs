//! Serial lines, and CAN over serial adapters.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Stdio};

use nix::sys::signal::Signal;
use serde_json::{Value, json};

use crate::record::{balanced, in_order};
use crate::support::bytes::noise;
use crate::support::mcap;
use crate::support::messages::{self, LINK_DOWN, Raw};
use crate::support::process::{args, start};
use crate::support::terminal::{Device, open};
use crate::support::{peers, until};

/// A Python script that talks with the test by lines.
struct Script {
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
}

impl Script {
    fn start(name: &str) -> Self {
        let mut command = peers::python(name);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (to, from) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        Self { child, to, from: BufReader::new(from) }
    }

    fn hear(&mut self) -> String {
        let mut line = String::new();
        self.from.read_line(&mut line).unwrap();
        assert!(!line.is_empty(), "the script has ended");
        line.trim_end().to_owned()
    }

    fn say(&mut self, line: &str) {
        writeln!(self.to, "{line}").unwrap();
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Returns when the file, which is still open, has so many bytes from and to the device.
fn until_recorded(part: &Path, bus: &str, rx: usize, tx: usize) {
    until("everything in the file", || {
        let streams = part.exists().then(|| messages::streams(&mcap::cut(part), bus))?;
        ((streams.0.len(), streams.1.len()) == (rx, tx)).then_some(())
    });
}

#[test]
fn a_bridge_passes_everything_on_and_records_both_sides_in_their_order() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let link = folder.path().join("ttyAPP");
    let mut script = Script::start("bridge.py");
    let port = script.hear();
    let bus = format!("rect=bridge:{port},19200,8N1@{}", link.display());
    let running = start(args(&[&"record", &bus, &"-o", &path, &"--json"]));
    until("the application's side", || link.exists().then_some(()));
    script.say(link.to_str().unwrap());
    let rounds: Vec<[String; 2]> = serde_json::from_str(&script.hear()).unwrap();
    let both = |side: usize| rounds.iter().map(|round| round[side].as_str()).collect::<String>();
    let (tx, rx) = (both(0), both(1));
    until_recorded(&part, "rect", rx.len() / 2, tx.len() / 2);
    let ran = running.stop().expect(0);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    in_order(&file, true);
    let streams = messages::streams(&file, "rect");
    assert!(messages::hex(&streams.0) == rx && messages::hex(&streams.1) == tx);
    // A question stands before its answer, and the next question behind that.
    let (mut said, mut heard) = (0, 0);
    let mut ends = rounds[..rounds.len() - 1].iter().scan((0, 0), |ends, [question, answer]| {
        ends.0 += question.len() / 2;
        ends.1 += answer.len() / 2;
        Some(*ends)
    });
    let mut end = ends.next();
    for (_, raw) in messages::raw(&file, "rect") {
        let Some((question, answer)) = end else { break };
        match raw {
            Raw::Tx(data) => said += data.len(),
            Raw::Rx(data) => {
                heard += data.len();
                assert_eq!(said, question, "an answer before the end of its question");
            }
            other => panic!("{other:?}"),
        }
        assert!(heard <= answer && said <= question, "out of turn");
        if heard == answer {
            end = ends.next();
        }
    }
    assert_eq!(end, None);
    let facts = file.facts("bustape.bus.rect");
    assert_eq!((facts["kind"].as_str(), facts["bitrate"].as_str()), ("bridge", "19200"));
    assert!(std::fs::symlink_metadata(&link).is_err(), "the link stays behind");
}

#[test]
fn all_that_the_kernel_holds_at_the_stop_is_in_the_recording() {
    // It holds some more for a pseudo-terminal, of which one read returns 4 KiB at most.
    const BACKLOG: usize = 9_000;
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let (link, pty) = (folder.path().join("ttyAPP"), folder.path().join("ttyPTY"));
    let (mut device, mut port) = (Device::new(), Device::new());
    let buses = [
        format!("rect=bridge:{},115200,8N1@{}", device.port().display(), link.display()),
        format!("port={},115200,8N1", port.port().display()),
        format!("pty=pty:{}", pty.display()),
    ];
    let running = start(args(&[&"record", &buses[0], &buses[1], &buses[2], &"-o", &path]));
    let (mut application, mut writer) = (open(&link), open(&pty));
    application.write_all(b"?").unwrap();
    until_recorded(&part, "rect", 0, 1);
    running.signal(Signal::SIGSTOP);
    let sent = noise(11, BACKLOG);
    device.say(&sent);
    port.say(&sent);
    application.write_all(&sent).unwrap();
    writer.write_all(&sent).unwrap();
    running.signal(Signal::SIGTERM);
    running.signal(Signal::SIGCONT);
    running.wait().expect(0);
    let file = mcap::finished(&path);
    let (rx, tx) = messages::streams(&file, "rect");
    assert!(rx == sent && tx[1..] == sent, "the bridge has {} and {}", rx.len(), tx.len());
    for bus in ["port", "pty"] {
        let (rx, _) = messages::streams(&file, bus);
        assert!(rx == sent, "{bus} has {} of {BACKLOG}", rx.len());
    }
}

#[test]
fn a_flood_through_a_terminal_is_recorded_without_losing_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let terminal = folder.path().join("tty");
    // Room for all of it: what is asked here is not how fast this disk is.
    let running = start(args(&[
        &"record",
        &format!("line=pty:{}", terminal.display()),
        &"-o",
        &path,
        &"--json",
        &"--queue",
        &"64MiB",
    ]));
    let sent = noise(20, 20 << 20);
    open(&terminal).write_all(&sent).unwrap();
    // It cannot be compressed, so the file is no smaller once all of it is there.
    until("the flood in the file", || {
        (std::fs::metadata(&part).ok()?.len() >= sent.len() as u64).then_some(())
    });
    let ran = running.stop().expect(0);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    assert!(messages::streams(&file, "line").0 == sent);
}

#[test]
fn a_port_that_is_unplugged_leaves_a_gap_and_goes_on_when_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    // As udev does it: a name that stays, and leads to wherever the device is.
    let name = folder.path().join("usb-adapter");
    let bus = format!("line={},115200,8N1", name.display());
    let mut device = Device::new();
    symlink(device.port(), &name).unwrap();
    let running = start(args(&[&"record", &bus, &"-o", &path, &"--json"]));
    until("the file", || part.exists().then_some(()));
    let mut sent = Vec::new();
    for round in 0..3 {
        let words = noise(round, 2000);
        device.say(&words);
        sent.extend(words);
        until_recorded(&part, "line", sent.len(), 0);
        std::fs::remove_file(&name).unwrap();
        drop(device);
        // In the log at once, in the gaps when it is back.
        until("the loss in the log", || {
            let log = mcap::cut(&part).on("/bustape/log").count() as u64;
            (log > 2 * round).then_some(())
        });
        device = Device::new();
        symlink(device.port(), &name).unwrap();
        until("the gap", || {
            (messages::gaps(&mcap::cut(&part), "line").len() as u64 == round + 1).then_some(())
        });
    }
    device.say(b"back");
    sent.extend(b"back");
    until_recorded(&part, "line", sent.len(), 0);
    // How much passed meanwhile nobody knows, but it was not nothing for certain.
    let ran = running.stop().expect(3);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    assert!(messages::streams(&file, "line").0 == sent);
    assert_eq!(messages::gaps(&file, "line"), [(0, LINK_DOWN); 3]);
}

#[test]
fn the_gap_of_a_quiet_port_is_as_long_as_it_was_away() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let name = folder.path().join("usb-adapter");
    let mut device = Device::new();
    symlink(device.port(), &name).unwrap();
    let bus = format!("line={},115200,8N1", name.display());
    let running = start(args(&[&"record", &bus, &"-o", &path]));
    until("the file", || part.exists().then_some(()));
    device.say(b"before a long silence");
    until_recorded(&part, "line", 21, 0);
    // Statistics come once a second: so long nothing is said.
    until("some seconds", || (mcap::cut(&part).on("/line/stats").count() >= 5).then_some(()));
    std::fs::remove_file(&name).unwrap();
    drop(device);
    let device = Device::new();
    symlink(device.port(), &name).unwrap();
    until("the gap", || {
        let file = part.exists().then(|| mcap::cut(&part))?;
        file.on("/line/gaps").next().map(drop)
    });
    running.stop().expect(3);
    let file = mcap::finished(&path);
    let last = file.on("/line/raw").last().unwrap().time;
    let (_, gap) = messages::decoded(&file).find(|(m, _)| file.topic(m) == "/line/gaps").unwrap();
    let from = messages::as_python(&gap)["from_ns"].as_u64().unwrap();
    assert!(from > last + 2_000_000_000, "the gap begins with the silence");
}

#[test]
fn a_number_of_reads_ends_the_recording_of_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let (path, tty) = (folder.path().join("a.mcap"), folder.path().join("tty"));
    let line = format!("line=pty:{}", tty.display());
    let running = start(args(&[&"record", &line, &"-o", &path, &"--json", &"--count", &"3"]));
    let mut terminal = open(&tty);
    let part = folder.path().join("a.mcap.part");
    for round in 1..=3 {
        terminal.write_all(b"word").unwrap();
        // The last one ends it, and the file gets its name.
        let file = [&part, &path];
        until("the word", || {
            let file = file.iter().find(|file| file.exists()).map(|file| mcap::cut(file))?;
            (messages::streams(&file, "line").0.len() == 4 * round).then_some(())
        });
    }
    let ran = running.wait().expect(0);
    assert_eq!(ran.json()["reason"], "count");
    assert_eq!(messages::streams(&mcap::finished(&path), "line").0, b"wordwordword");
}

#[test]
fn a_tap_records_who_said_what() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let (mut device, mut host) = (Device::new(), Device::new());
    let bus = format!("link=tap:{}+{},9600,8E1", device.port().display(), host.port().display());
    let running = start(args(&[&"record", &bus, &"-o", &path, &"--json"]));
    until("the file", || part.exists().then_some(()));
    let (mut rx, mut tx) = (Vec::new(), Vec::new());
    for round in 0..10 {
        let (question, answer) = (noise(round, 50), noise(round + 100, 70));
        host.say(&question);
        tx.extend(question);
        until_recorded(&part, "link", rx.len(), tx.len());
        device.say(&answer);
        rx.extend(answer);
        until_recorded(&part, "link", rx.len(), tx.len());
    }
    let ran = running.stop().expect(0);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    assert!(messages::streams(&file, "link") == (rx, tx));
    let mut sides = messages::raw(&file, "link");
    sides.dedup_by_key(|(_, raw)| matches!(raw, Raw::Tx(_)));
    assert_eq!(sides.len(), 20, "questions and answers take turns");
}

#[test]
fn frames_from_a_can_adapter_are_recorded_as_they_were_sent() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let mut script = Script::start("slcan.py");
    let bus = format!("can=slcan:{}@500000", script.hear());
    let running = start(args(&[&"record", &bus, &"-o", &path, &"--json"]));
    let sent: Vec<Value> = serde_json::from_str(&script.hear()).unwrap();
    until("every frame in the file", || {
        let frames = part.exists().then(|| messages::cans(&mcap::cut(&part), "can"))?;
        (frames.len() >= sent.len()).then_some(())
    });
    let ran = running.stop().expect(0);
    let file = mcap::finished(&path);
    balanced(&ran, &file);
    in_order(&file, true);
    let recorded = messages::cans(&file, "can").into_iter().map(|(_, frame)| {
        let dlc = if frame.dlc > 0 { frame.dlc.into() } else { frame.data().len() };
        json!({
            "id": frame.id, "ext": frame.flags.0 & 1 > 0, "rtr": frame.flags.0 & 2 > 0, "dlc": dlc,
            "data": messages::hex(frame.data()),
        })
    });
    assert_eq!(recorded.collect::<Vec<_>>(), sent);
}
