//! Targets that are full, cannot carry a frame, or go away; clocks that are set.

use std::process::{Command, Stdio};
use std::time::Duration;

use libtest_mimic::Failed;
use nix::fcntl::OFlag;
use nix::pty::{grantpt, posix_openpt, ptsname_r, unlockpt};

use super::{mixed, of, replay, report};
use crate::lab::{BUSTAPE, Recorder, cat, sent_on, sh, text, wait_until};

pub fn full_queue() -> Result<(), Failed> {
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

pub fn fd_frames() -> Result<(), Failed> {
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

/// An adapter behind the kernel's slcan driver, whose line is as slow as we read it: its queue is
/// really full.
pub fn slow_adapter() -> Result<(), Failed> {
    let recorder = Recorder::start(&["a=vcan0"]);
    sh("cangen vcan0 -g 0 -p 1 -n 2000");
    let recorded = recorder.stop();
    let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let line = ptsname_r(&master)?;
    let mut slcand = Command::new("slcand")
        .args(["-F", line.trim_start_matches("/dev/"), "adapter1"])
        .stderr(Stdio::null())
        .spawn()
        .expect("slcand runs");
    let here = || std::fs::exists("/sys/class/net/adapter1").unwrap_or(false);
    wait_until("the interface", here);
    sh("ip link set adapter1 txqueuelen 5 up");
    let heard = std::thread::spawn(move || {
        let (mut all, mut buffer) = (Vec::new(), [0; 64]);
        while text(&all).matches('\r').count() < 2000 {
            let length = nix::unistd::read(&master, &mut buffer).expect("a line");
            all.extend_from_slice(&buffer[..length]);
            if all.len() < 4000 {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        text(&all)
    });
    let to = ["--to", "a=adapter1", "--transmit-on", "adapter1", "--yes", "--rate", "max"];
    let output = replay(&recorded.file, &to);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = report(&output);
    let bus = &report["buses"][0];
    assert!(bus["sent"] == 2000 && bus["waits"].as_u64() > Some(0), "{report}");
    // `t12320A0B`: the adapter's word for 123#0A0B.
    let heard = heard.join().expect("a line");
    let frame = |line: &str| format!("{}#{}", &line[1..4], &line[5..]);
    let heard: Vec<String> = heard.split_terminator('\r').map(frame).collect();
    let sent = of("a ", &cat(&recorded.file, &[]));
    let sent: Vec<&str> = sent.iter().map(|line| line.trim_start_matches("a ")).collect();
    assert!(heard == sent);
    let killed = slcand.kill();
    slcand.wait()?;
    killed?;
    Ok(())
}

/// By the wall clock, a step of an hour ahead would let everything out at once, and one of two
/// hours back would hold it up for as long.
pub fn clock_steps() -> Result<(), Failed> {
    let recorder = Recorder::start(&["a=vcan0"]);
    sh("cangen vcan0 -g 10 -n 300");
    let recorded = recorder.stop();
    let times: Vec<f64> = cat(&recorded.file, &["-t", "z", "--topics", "/a/raw"])
        .iter()
        .filter_map(|line| line.strip_prefix('(')?.split(')').next()?.parse().ok())
        .collect();
    let length = times.last().copied().unwrap_or(0.0);
    let child = Command::new(BUSTAPE)
        .args(["replay", "--json", "--verify", "--to", "a=vcan1"])
        .arg(&recorded.file)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("bustape runs");
    sh("for by in +3600 -7200 +3600; do sleep 0.7; \
        date -s \"@$(( $(date +%s) + $by ))\" >/dev/null; done");
    let output = child.wait_with_output().expect("bustape ends");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let report = report(&output);
    assert_eq!(report["buses"][0]["verify"]["same"], 300, "{report}");
    assert!(report["took_ns"].as_f64() >= Some((length - 0.001) * 1e9), "{length}: {report}");
    Ok(())
}
