//! Nothing real hears a replay without permission.

use bustape::frame::{CanFlags, Direction, Frame};
use bustape::recording::writer::Layout;

use super::answers::spawn_script;
use super::{MILLI, Made, can, mixed};
use crate::support::make::at;
use crate::support::person::Person;
use crate::support::process::args;
use crate::support::terminal::Device;

/// What has arrived at a device whose terminal nobody reads.
fn heard_by(device: &Device) -> Vec<u8> {
    let mut all = Vec::new();
    let mut buffer = [0; 4096];
    while let Ok(length @ 1..) = device.hear(&mut buffer) {
        all.extend_from_slice(&buffer[..length]);
    }
    all
}

#[test]
fn real_ports_and_adapters_hear_nothing_without_permission() {
    let made = Made::new(Layout::Frame, &mixed(16));
    let device = Device::new();
    let port = device.port().display().to_string();
    let (line, can) = (format!("line={port},9600"), format!("can0=slcan:{port}@500000"));
    for _ in 0..50 {
        for to in [&line, &can] {
            let ran = made.replay(&["--to", to, "--yes"]).expect(4);
            assert!(ran.err.contains(&format!("--transmit-on {port}")), "{}", ran.err);
            // Permitted, but nobody is there to confirm it.
            let ran = made.replay(&["--to", to, "--transmit-on", &port]).expect(4);
            assert!(ran.err.contains("--yes"), "{}", ran.err);
        }
    }
    assert_eq!(heard_by(&device), b"");
    made.replay(&["--to", &line, "--transmit-on", &port, "--yes", "--only", "tx"]).expect(0);
    let expected: Vec<u8> = mixed(16)
        .into_iter()
        .filter_map(|(_, frame)| match frame.value {
            Frame::Serial(bytes) if bytes.direction == Direction::Tx => Some(bytes.data),
            _ => None,
        })
        .flatten()
        .collect();
    assert_eq!(heard_by(&device), expected);
}

#[test]
fn a_can_adapter_gets_frames_in_order_and_again_when_it_was_busy() {
    let frames: Vec<_> = (0..50u32)
        .map(|n| (0, at(u64::from(n) * MILLI, can(n, CanFlags::default(), &[n as u8]))))
        .collect();
    let made = Made::new(Layout::Frame, &frames);
    let mut script = spawn_script("busy_adapter.py");
    let port = script.hear();
    let to = format!("can0=slcan:{port}@500000");
    let ran = made.replay(&["--to", &to, "--transmit-on", &port, "--yes", "--json"]).expect(0);
    assert_eq!(ran.json()["buses"][0]["sent"], 50, "{}", ran.out);
    let sent: Vec<String> = serde_json::from_str(&script.hear()).unwrap();
    let expected: Vec<String> = (0..50).map(|n| format!("t{n:03X}1{n:02X}")).collect();
    assert_eq!(sent, expected);
}

#[test]
fn a_dry_run_says_what_would_go_where_and_sends_nothing() {
    let made = Made::new(Layout::Batch, &mixed(80));
    let (device, tty) = (Device::new(), made.path("tty"));
    let can = format!("can0=slcan:{}@500000/2000000", device.port().display());
    let line = format!("line=pty:{}", tty.display());
    let ran = made.replay(&["--to", &can, "--to", &line, "--dry-run", "--json"]).expect(0);
    let report = ran.json();
    assert_eq!(report["permitted"], false);
    let [adapter, terminal] = [0, 1].map(|n| &report["buses"][n]);
    assert_eq!((&adapter["frames"], &adapter["virtual"]), (&50.into(), &false.into()));
    assert_eq!(adapter["not_sent"]["error_frame"], 10);
    assert_eq!((&terminal["frames"], &terminal["virtual"]), (&20.into(), &true.into()));
    assert!(heard_by(&device).is_empty() && !tty.exists());
    // An adapter without a CAN FD rate is refused CAN FD frames, whatever its permission.
    let port = device.port().display().to_string();
    let classic = format!("can0=slcan:{port}@500000");
    let ran = made.replay(&["--to", &classic, "--transmit-on", &port, "--yes"]).expect(1);
    assert_eq!(heard_by(&device), b"");
    assert!(ran.err.contains("can0 has CAN FD frames"), "{}", ran.err);
}

#[test]
fn a_person_is_asked_once_and_only_a_yes_is_one() {
    let made = Made::new(Layout::Frame, &mixed(16));
    let device = Device::new();
    let port = device.port().display().to_string();
    let line = format!("line={port},9600");
    let all = ["--to", &line, "--transmit-on", &port, "--only", "tx"];
    for (answer, code) in [("y\r", 4), ("\r", 4), ("\x04", 4), ("yes\r", 0)] {
        let mut command = args(&[&"replay", &made.file]);
        command.extend(all.iter().map(Into::into));
        let mut person = Person::start(command);
        person.sees(&format!("will transmit on {port} (serial port). Type yes to go on:"));
        assert_eq!(heard_by(&device), b"");
        person.press(answer);
        assert_eq!(person.wait().0, Some(code), "{answer:?}");
        assert!(person.mode() == person.before, "the terminal is another");
    }
    assert!(!heard_by(&device).is_empty());
}
