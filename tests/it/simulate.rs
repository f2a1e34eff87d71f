//! Simulated devices, as programs that know nothing of them find them.

use std::path::Path;

use crate::support::messages;
use crate::support::process::{Ran, Running, args, bustape, spawn, start};
use crate::support::terminal::Device;
use crate::support::{mcap, peers, several, until};

const FAULTS: [&str; 9] = [
    "bad-crc",
    "no-answer",
    "wrong-length",
    "garbage",
    "late",
    "link-error",
    "wrong-sequence",
    "wrong-address",
    "busy",
];

/// A simulated rectifier whose line is at `path`.
fn simulate(path: &Path, options: &[&str]) -> Running {
    let address = format!("pty:{}", path.display());
    let mut line = args(&[&"simulate", &"zhongheng-09", &address]);
    line.extend(options.iter().map(|option| (*option).into()));
    let running = start(line);
    until("the line", || path.exists().then_some(()));
    running
}

/// The master of `rectifier_master.py` at the same line.
#[track_caller]
fn master(path: &Path, what: &str) {
    let mut script = peers::python("rectifier_master.py");
    script.arg(path).arg(what);
    spawn(script).wait().expect(0);
}

#[track_caller]
fn ended(ran: Ran, path: &Path) {
    ran.expect(0);
    assert!(std::fs::symlink_metadata(path).is_err(), "the link is still there");
}

#[test]
fn any_master_can_poll_the_simulated_rectifier_by_the_rules_of_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rectifier");
    let running = simulate(&path, &["--seed", "5"]);
    master(&path, "poll");
    // Another program may come after the first.
    master(&path, "poll");
    ended(running.stop(), &path);
}

#[test]
fn every_fault_of_the_rectifier_is_what_a_master_sees() {
    let folder = tempfile::tempdir().unwrap();
    several(FAULTS.to_vec(), |fault| {
        let path = folder.path().join(fault);
        let running = simulate(&path, &["--faults", &format!("{fault}=1")]);
        master(&path, fault);
        ended(running.stop(), &path);
    });
}

#[test]
fn the_master_can_be_played_too_and_both_can_be_heard() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line");
    let running = simulate(&path, &["--role", "master", "--slave-address", "9"]);
    master(&path, "serve");
    ended(running.stop(), &path);
    let running = simulate(&path, &["--role", "both"]);
    master(&path, "listen");
    ended(running.stop(), &path);
}

#[test]
fn a_simulation_ends_when_its_time_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line");
    let address = format!("pty:{}", path.display());
    let line = ["simulate", "zhongheng-09", &address, "--duration", "50ms"];
    ended(bustape(line), &path);
}

#[test]
fn nothing_is_sent_to_what_may_be_real_unless_it_is_named() {
    for (address, sentence) in [
        ("/dev/null,19200,8N1", "nothing was sent: /dev/null (serial port) may reach real devices"),
        ("/dev/no-such-port,9600", "add --transmit-on /dev/no-such-port"),
    ] {
        let ran = bustape(["simulate", "zhongheng-09", address]).expect(4);
        assert!(ran.err.contains(sentence) && ran.out.is_empty(), "{}", ran.err);
    }
    // Permitted, but no port.
    let line = ["simulate", "zhongheng-09", "/dev/null,19200", "--transmit-on", "/dev/null"];
    bustape(line).expect(1);
}

#[test]
fn the_terminal_of_another_program_hears_nothing_unless_it_is_named() {
    // A bridge to a real line looks no other.
    let device = Device::new();
    let port = device.port().display().to_string();
    let address = format!("{port},19200,8N1");
    let line = ["simulate", "zhongheng-09", &address, "--role", "master", "--duration", "2s"];
    let ran = bustape(line).expect(4);
    assert!(ran.err.contains(&format!("add --transmit-on {port}")), "{}", ran.err);
    let mut heard = [0; 64];
    assert!(device.hear(&mut heard).is_err(), "{heard:02X?}");
    bustape(line.iter().chain(&["--transmit-on", &port])).expect(0);
    assert!(device.hear(&mut heard).is_ok_and(|length| length > 0));
}

#[test]
fn a_simulation_that_makes_no_sense_is_refused() {
    for (line, sentence) in [
        (&["simulate"][..], "Usage: bustape simulate"),
        (&["simulate", "toaster"], "unrecognized subcommand"),
        (&["simulate", "zhongheng-09", "tap:/dev/a+/dev/b,9600"], "speaks at pty:PATH"),
        (&["simulate", "zhongheng-09", "can0"], "speaks at pty:PATH"),
        (&["simulate", "zhongheng-09", "pty:/tmp/x", "--faults", "smoke=1"], "there are bad-crc"),
        (&["simulate", "zhongheng-09", "pty:/tmp/x", "--faults", "late=2"], "from 0 (never) to 1"),
        (
            &["simulate", "zhongheng-09", "pty:/tmp/x", "--slave-address", "0"],
            "is not in 1..=65279",
        ),
        (&["simulate", "hmi-can", "vcan0", "--time-scale", "0"], "from 0.01 to 100000"),
        (
            &["simulate", "zhongheng-09", "pty:/tmp/x", "--role", "master", "--faults", "late=1"],
            "the master has none",
        ),
        (&["record", "sim:hmi-can,late=1", "-o", "x.mcap"], "there are seed, time-scale, missing"),
        (&["record", "sim:hmi-can,seed=a", "-o", "x.mcap"], "seed is \"a\", not a whole number"),
        (&["record", "sim:zhongheng-09,late=7", "-o", "x.mcap"], "no rate for late"),
    ] {
        let ran = bustape(line).expect(2);
        assert!(ran.err.contains(sentence), "{line:?}: {}", ran.err);
    }
    let ran = bustape(["simulate", "hmi-can", "no-such-bus"]).expect(1);
    assert!(ran.err.contains("there is no CAN interface no-such-bus"), "{}", ran.err);
}

#[test]
fn simulated_buses_are_recorded_with_their_seed_and_faults() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let buses = ["a=sim:hmi-can,seed=4,bus-error=0.5", "b=sim:zhongheng-09,time-scale=2,garbage=1"];
    let line = args(&[&"record", &buses[0], &buses[1], &"-o", &path, &"--duration", &"2s"]);
    bustape(line).expect(0);
    let file = mcap::finished(&path);
    assert_eq!(file.facts("bustape.bus.a")["seed"], "4");
    assert_eq!(file.facts("bustape.bus.b")["time_scale"], "2");
    let (rx, _) = messages::streams(&file, "b");
    assert!(!rx.is_empty() && rx[0] != 0x7E, "no garbage in front: {rx:02X?}");
    let lines = bustape(args(&[&"cat", &path, &"-f", &"a"])).expect(0).out;
    // 20000088 is an error frame: CAN_ERR_FLAG, CAN_ERR_BUSERROR, CAN_ERR_PROT.
    let errors = lines.lines().filter(|line| line.contains(" 20000088#")).count();
    let all = lines.lines().count();
    assert!((all / 5..all / 2).contains(&errors), "{errors} of {all}");
}
