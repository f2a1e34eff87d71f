//! Recordings go back onto CAN as they were, and never onto a real bus unasked.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use libtest_mimic::{Failed, Trial};
use serde_json::Value;

use crate::lab::{BUSTAPE, Recorded, Recorder, cat, sent_on, sh, text, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("a_replayed_recording_is_recorded_again_as_it_was", round_trip),
        trial("only_what_the_kernel_calls_virtual_is_sent_to_unasked", permission),
        trial("a_full_transmit_queue_waits_and_keeps_the_order", full_queue),
        trial("frames_that_an_interface_cannot_carry_are_refused_before_any_is_sent", fd_frames),
        trial("a_recorded_controller_answers_the_request_of_its_settings", answers),
    ]
}

fn replay(file: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(BUSTAPE);
    command.args(["replay", "--json"]).arg(file).args(more).stdin(Stdio::null());
    command.output().expect("bustape runs")
}

fn report(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
        panic!("{error}: {} {}", text(&output.stdout), text(&output.stderr))
    })
}

/// The lines of `cat` without their times.
fn frames(lines: &[String]) -> Vec<String> {
    lines.iter().map(|line| line.split_once(' ').expect("a time").1.to_owned()).collect()
}

fn of(bus: &str, lines: &[String]) -> Vec<String> {
    frames(lines).into_iter().filter(|line| line.starts_with(bus)).collect()
}

/// A recording of every kind of frame on two interfaces.
fn mixed(count: u32) -> Recorded {
    let recorder = Recorder::start(&["a=vcan0", "b=vcan1"]);
    let each = count / 4;
    sh(&format!(
        "cangen vcan0 -g 0 -p 1 -n {each} & cangen vcan0 -e -m -R -g 0 -p 1 -n {each} & \
         cangen vcan1 -f -g 0 -p 1 -n {each} & cangen vcan1 -m -b -E -g 0 -p 1 -n {each} & \
         cansend vcan0 20000004#0020000000000000; wait"
    ));
    recorder.stop()
}

fn round_trip() -> Result<(), Failed> {
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

/// A recording made of a few frames, without the kernel's help.
fn few(folder: &Path) -> PathBuf {
    let recorder = Recorder::start(&["a=vcan0"]);
    sh("for i in 1 2 3 4 5; do cansend vcan0 12$i#0$i; done");
    let recorded = recorder.stop();
    let file = folder.join("few.mcap");
    std::fs::copy(&recorded.file, &file).expect("a copy");
    file
}

fn permission() -> Result<(), Failed> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = few(folder.path());
    sh("ip link add vx0 type vxcan peer name vx1 && ip link set vx0 up && ip link set vx1 up");
    // What stands behind a name counts, not the name.
    sh("ip link set vcan1 down && ip link set vcan1 name can9 && ip link set can9 up && \
        ip link set vx0 down && ip link set vx0 name vcan1 && ip link set vcan1 up");
    for run in 0..4 {
        let more: &[&str] = match run % 4 {
            0 => &[],
            1 => &["--yes"],
            2 => &["--transmit-on", "vcan1"],
            _ => &["--rate", "max"],
        };
        let output = replay(&file, &[&["--to", "a=vcan1"], more].concat());
        assert_eq!(output.status.code(), Some(4), "{}", text(&output.stderr));
    }
    assert_eq!((sent_on("vcan1"), sent_on("vx1")), (0, 0));
    let before = sent_on("can9");
    let output = replay(&file, &["--to", "a=can9"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(sent_on("can9") - before, 5);
    let permitted = ["--to", "a=vcan1", "--transmit-on", "vcan1", "--yes"];
    let output = replay(&file, &permitted);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(sent_on("vcan1"), 5);
    sh("ip link set can9 down");
    let output = replay(&file, &["--to", "a=can9"]);
    assert!(text(&output.stderr).contains("can9 is down"), "{}", text(&output.stderr));
    sh("ip link del vcan1 && ip link set can9 name vcan1 && ip link set vcan1 up");
    Ok(())
}

fn full_queue() -> Result<(), Failed> {
    let first = mixed(2000);
    let again = Recorder::start(&["a=vcan1", "b=vcan0"]);
    // Every third call finds the queue full; strace is the interface's slow transmitter.
    let output = Command::new("strace")
        .args(["-f", "-o", "/dev/null", "-e", "trace=sendmmsg"])
        .args(["-e", "inject=sendmmsg:error=ENOBUFS:when=2+3"])
        .args([BUSTAPE, "replay", "--json", "--rate", "max", "--to", "a=vcan1", "--to", "b=vcan0"])
        .arg(&first.file)
        .output()
        .expect("strace runs");
    let again = again.stop();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = report(&output);
    let waits = |bus: usize| report["buses"][bus]["waits"].as_u64().expect("a number");
    assert!(waits(0) + waits(1) >= 3, "{report}");
    let (before, after) = (cat(&first.file, &[]), cat(&again.file, &[]));
    for bus in ["a ", "b "] {
        let sent: Vec<_> =
            of(bus, &before).into_iter().filter(|l| !l.contains(" 20000004#")).collect();
        assert!(sent == of(bus, &after), "{bus}");
    }
    // An interface that goes away ends it with a sentence.
    sh("ip link add gone type vcan && ip link set gone up");
    let child = Command::new(BUSTAPE)
        .args(["replay", "--to", "a=gone", "--rate", "0.1", "--loop", "forever"])
        .arg(&first.file)
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("bustape runs");
    wait_until("frames are sent", || sent_on("gone") > 0);
    sh("ip link del gone");
    let output = child.wait_with_output().expect("bustape ends");
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    assert!(
        said.contains("gone went away while it was played to") || said.contains("went down"),
        "{said}"
    );
    Ok(())
}

fn fd_frames() -> Result<(), Failed> {
    let recorder = Recorder::start(&["a=vcan0", "b=vcan1"]);
    sh("cangen vcan0 -g 0 -n 200; cangen vcan1 -f -g 0 -n 20");
    let first = recorder.stop();
    sh("ip link add small type vcan && ip link set small mtu 16 up");
    let output = replay(&first.file, &["--to", "a=small", "--to", "b=small"]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    assert!(said.contains("b has CAN FD frames") && said.contains("mtu 72"), "{said}");
    assert_eq!(sent_on("small"), 0);
    let output = replay(&first.file, &["--to", "a=small", "--rate", "max"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(sent_on("small"), 200);
    sh("ip link del small");
    Ok(())
}

fn answers() -> Result<(), Failed> {
    // A dialogue as it stands in the recording of a power station: request, settings, MODBUS.
    let recorder = Recorder::start(&["plant=vcan0"]);
    sh("cansend vcan0 00130000#R; \
        for i in 1 2 3 4 5 6 7 8 9 A B C D E F; do cansend vcan0 0013000$i#0$i; done; \
        cansend vcan0 00110000#0B00050300100003; cansend vcan0 00120000#0B00050300AABBCC; \
        cansend vcan0 00120001#DDEE; sleep 0.1");
    let recorded = recorder.stop();
    let sockets = || std::fs::read_to_string("/proc/net/can/rcvlist_all").unwrap_or_default();
    let nobody = sockets();
    let child = Command::new(BUSTAPE)
        .args(["replay", "--json", "--to", "plant=vcan1", "--answer", "plant"])
        .args(["--decode", "plant=hmi-can", "--delay", "none"])
        .arg(&recorded.file)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("bustape runs");
    wait_until("it listens", || sockets() != nobody);
    let before = sent_on("vcan1");
    sh("cansend vcan1 00130000#R");
    wait_until("all settings are there", || sent_on("vcan1") == before + 16);
    sh("cansend vcan1 00130000#R; cansend vcan1 00130000#01");
    wait_until("all settings are there again", || sent_on("vcan1") == before + 16 + 17);
    sh("cansend vcan1 00110000#0B00050300100003");
    wait_until("the registers are there", || sent_on("vcan1") == before + 16 + 17 + 3);
    sh("cansend vcan1 00110000#0B00050300100004; sleep 0.2");
    sh(&format!("kill -INT {}", child.id()));
    let output = child.wait_with_output().expect("bustape ends");
    let answers = report(&output)["buses"][0]["answers"].clone();
    assert_eq!((&answers["requests"], &answers["answered"]), (&4.into(), &3.into()), "{answers}");
    assert_eq!(answers["never_recorded"], 1, "{answers}");
    let said = text(&output.stderr);
    assert!(said.contains("never recorded: MODBUS_REQ [00110000#0B00050300100004]"), "{said}");
    Ok(())
}
