//! Recordings go back onto CAN as they were, and never onto a real bus unasked.

mod again;
mod answers;
mod trouble;

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use libtest_mimic::{Failed, Trial};
use serde_json::Value;

use crate::frames::Candump;
use crate::lab::{BUSTAPE, Recorded, Recorder, sent_on, sh, text};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("a_replayed_recording_is_recorded_again_as_it_was", again::round_trip),
        trial("a_hundred_thousand_frames_are_again_what_candump_saw", again::hundred_thousand),
        trial("only_what_the_kernel_calls_virtual_is_sent_to_unasked", permission),
        trial("a_transmit_queue_that_says_it_is_full_is_waited_for", trouble::full_queue),
        trial("a_slow_adapter_of_the_kernel_gets_everything_in_order", trouble::slow_adapter),
        trial("a_wall_clock_that_is_set_changes_nothing_for_a_replay", trouble::clock_steps),
        trial(
            "frames_that_an_interface_cannot_carry_are_refused_before_any_is_sent",
            trouble::fd_frames,
        ),
        trial("a_recorded_controller_answers_the_request_of_its_settings", answers::answers),
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
fn mixed(count: usize) -> Recorded {
    let recorder = Recorder::start(&["a=vcan0", "b=vcan1"]);
    sh(&traffic(count));
    recorder.stop()
}

/// A shell line that sends so many frames of every kind on two interfaces, and an error frame.
fn traffic(count: usize) -> String {
    let each = count / 4;
    format!(
        "cangen vcan0 -g 0 -p 1 -n {each} & cangen vcan0 -e -m -R -g 0 -p 1 -n {each} & \
         cangen vcan1 -f -g 0 -p 1 -n {each} & cangen vcan1 -m -b -E -g 0 -p 1 -n {each} & \
         cansend vcan0 20000004#0020000000000000; wait"
    )
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
    let peer = Candump::start(&["vx1"]);
    for run in 0..100 {
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
    assert_eq!(peer.lines(0), [""; 0], "the other end has heard something");
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
