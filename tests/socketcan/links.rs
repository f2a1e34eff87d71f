//! Interfaces that are missing, go down, vanish and come back.

use libtest_mimic::{Failed, Trial};

use crate::lab::{Recorder, bustape, cat, sh, text, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("what_cannot_be_recorded_is_refused_in_one_sentence", refused),
        trial("an_interface_that_goes_down_leaves_a_gap_and_comes_back", down_and_up),
        trial("an_interface_that_is_removed_leaves_a_gap_and_comes_back", removed_and_back),
        trial("stopping_while_an_interface_is_down_still_writes_the_gap", stop_while_down),
        trial("the_demo_uses_a_virtual_interface_and_removes_it", demo),
    ]
}

fn refused() -> Result<(), Failed> {
    sh("ip link add vdown type vcan");
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("x.mcap");
    let cases = [
        ("vnone", "there is no interface vnone"),
        ("vdown", "ip link set vdown up"),
        ("lo", "not a CAN interface"),
    ];
    for (bus, expected) in cases {
        let output = bustape(&["record", bus, "-o", &file.display().to_string()]);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{bus}: {stderr}");
        assert!(stderr.contains(expected), "{bus}: {stderr}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        assert_eq!(std::fs::read_dir(folder.path())?.count(), 0, "a file was left behind");
    }
    sh("ip link del vdown");
    Ok(())
}

fn add(name: &str) {
    sh(&format!("ip link add {name} type vcan && ip link set {name} mtu 72 up"));
}

/// Sends until the recorder has something new, since it needs a moment to come back.
fn send_until_recorded(recorder: &Recorder, interface: &str, id: &str) {
    let part = recorder.file.with_extension("mcap.part");
    wait_until("frames are recorded again", || {
        sh(&format!("cansend {interface} {id}#"));
        std::thread::sleep(std::time::Duration::from_millis(300));
        cat(&part, &["-f", interface]).iter().any(|line| line.ends_with(&format!("{id}#")))
    });
}

fn down_and_up() -> Result<(), Failed> {
    add("vflap");
    let recorder = Recorder::start(&["vflap", "vcan0"]);
    for round in 0..5 {
        send_until_recorded(&recorder, "vflap", &format!("10{round}"));
        sh("ip link set vflap down; sleep 0.5");
        let ticks = recorder.cpu_ticks();
        sh("sleep 1; cansend vcan0 200#");
        assert!(recorder.cpu_ticks() - ticks <= 20, "waiting for the link takes a fifth of a core");
        sh("ip link set vflap up");
    }
    send_until_recorded(&recorder, "vflap", "105");
    let recorded = recorder.stop();
    sh("ip link del vflap");
    let gaps = recorded.gaps("link_down");
    assert_eq!(gaps.len(), 5, "{gaps:?}");
    let others = cat(&recorded.file, &["-f", "vcan0"]);
    assert_eq!(others.len(), 5, "the other interface goes on");
    recorded.assert_balanced(0);
    Ok(())
}

fn removed_and_back() -> Result<(), Failed> {
    add("vgone");
    let recorder = Recorder::start(&["vgone"]);
    for round in 0..3 {
        send_until_recorded(&recorder, "vgone", &format!("10{round}"));
        sh("ip link del vgone; sleep 0.5");
        add("vgone");
    }
    send_until_recorded(&recorder, "vgone", "103");
    let recorded = recorder.stop();
    sh("ip link del vgone");
    let gaps = recorded.gaps("link_down");
    assert_eq!(gaps.len(), 3, "{gaps:?}");
    assert!(gaps.iter().all(|gap| gap["from"].as_str() < gap["to"].as_str()), "{gaps:?}");
    Ok(())
}

fn stop_while_down() -> Result<(), Failed> {
    add("vstop");
    let recorder = Recorder::start(&["vstop"]);
    send_until_recorded(&recorder, "vstop", "100");
    sh("ip link set vstop down; sleep 0.5");
    let recorded = recorder.stop();
    sh("ip link del vstop");
    assert_eq!(recorded.gaps("link_down").len(), 1);
    Ok(())
}

fn demo() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let output = bustape(&["demo", "-d", &folder.path().display().to_string(), "--duration", "3s"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("virtual interface"), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("/station/raw"));
    assert!(!sh("ip -br link").contains("bustape"), "the demo's interface is still there");
    Ok(())
}
