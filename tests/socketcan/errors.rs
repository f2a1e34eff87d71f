//! Error frames and the state of the controller, on interfaces that carry what they are given.

use libtest_mimic::{Failed, Trial};
use serde_json::Value;

use crate::lab::{Recorder, bustape, cat, info, sent_on, sh, text, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("every_class_of_error_frames_is_stored_and_named", every_class),
        trial("bus_off_is_a_gap_until_the_controller_is_back", bus_off),
        trial("ten_thousand_errors_a_second_are_all_accounted_for", flood),
        trial("an_interface_under_another_name_is_waited_for_under_its_own", renamed),
        trial("an_interface_that_is_missing_at_the_start_is_waited_for", missing),
        trial("a_bit_rate_for_a_virtual_interface_is_said_to_count_for_nothing", virtual_rate),
    ]
}

/// Identifier and data of an error frame, and what its sentence has to be.
const CLASSES: [(&str, &str); 12] = [
    ("20000001#0000000000000000", "tx-timeout"),
    ("20000002#0500000000000000", "lost-arbitration (at bit 5)"),
    ("20000004#0001000000000000", "controller (rx-overflow)"),
    ("20000204#0008000000006007", "controller (tx-warning); error counters tx 96, rx 7"),
    ("20000004#0010000000000000", "controller (rx-passive)"),
    ("20000004#0040000000000000", "controller (active)"),
    ("20000088#000082190000AABB", "protocol (form, on-transmission in ACK slot); bus-error"),
    ("20000010#0000000070000000", "transceiver (CANL is shorted to ground)"),
    ("20000020#0000000000000000", "no-ack"),
    ("20000080#0000000000000000", "bus-error"),
    ("20000040#0000000000000000", "bus-off"),
    ("20000100#0000000000000000", "restarted"),
];

fn json_lines(file: &std::path::Path, topic: &str) -> Vec<Value> {
    let lines = cat(file, &["--json", "--topics", topic]);
    lines.iter().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

fn every_class() -> Result<(), Failed> {
    for layout in ["frame", "batch"] {
        let recorder = Recorder::start(&["vcan0", "--layout", layout]);
        for (frame, _) in CLASSES {
            sh(&format!("cansend vcan0 {frame}"));
        }
        let recorded = recorder.stop();
        let said = cat(&recorded.file, &["--topics", "/vcan0/errors"]);
        assert_eq!(said.len(), CLASSES.len(), "{said:?}");
        for (line, (_, expected)) in said.iter().zip(CLASSES) {
            assert!(line.contains(expected), "{line}: {expected}");
        }
        // The frames themselves are what they were.
        let raw = cat(&recorded.file, &["--topics", "/vcan0/raw"]);
        for (line, (frame, _)) in raw.iter().zip(CLASSES) {
            assert!(line.ends_with(frame), "{line}");
        }
        let errors = &info(&recorded.file)["errors"]["vcan0"];
        assert_eq!((&errors["controller"], &errors["no-ack"]), (&4.into(), &1.into()), "{errors}");
        recorded.assert_balanced(0);
    }
    Ok(())
}

fn bus_off() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let config = folder.path().join("c.toml");
    let file = folder.path().join("a.mcap");
    let fired = folder.path().join("fired");
    std::fs::write(
        &config,
        format!(
            "bus = [\"vcan0\"]\noutput = \"{}\"\n[[trigger]]\nwhen = \"bus-off\"\n\
             run = [\"touch\", \"{}\"]\n[[trigger]]\nwhen = \"error frame tx-passive\"\n",
            file.display(),
            fired.display()
        ),
    )?;
    let child = std::process::Command::new(crate::lab::BUSTAPE)
        .args(["record", "--config"])
        .arg(&config)
        .stderr(std::process::Stdio::piped())
        .spawn()?;
    let part = file.with_extension("mcap.part");
    wait_until("the recording begins", || part.exists());
    sh("cansend vcan0 100#01; cansend vcan0 20000004#0020000000000000; sleep 1.3; \
        cansend vcan0 20000040#0000000000000000; sleep 1.5; \
        cansend vcan0 20000020#0000000000000000; sleep 0.2; \
        cansend vcan0 20000100#0000000000000000; sleep 1.3; cansend vcan0 100#02");
    wait_until("the command of the trigger", || fired.exists());
    sh(&format!("kill -INT {}", child.id()));
    let output = child.wait_with_output()?;
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "an outage: {stderr}");
    let gaps = info(&file)["gaps"].as_array().cloned().unwrap_or_default();
    assert_eq!(gaps.len(), 1, "{gaps:?}");
    // From the error frame that says so to the one that says that it is over.
    let errors = json_lines(&file, "/vcan0/errors");
    assert_eq!(errors.len(), 4, "{errors:?}");
    let gap = json_lines(&file, "/vcan0/gaps");
    let time = |value: &Value| value["time"].as_f64().or(value["log_time"].as_f64());
    assert_eq!(time(&gap[0]), time(&errors[3]), "{gap:?} {errors:?}");
    assert!(stderr.contains("error passive now") && stderr.contains("bus-off now"), "{stderr}");
    let states = cat(&file, &["--topics", "/vcan0/stats"]).join("\n");
    for state in ["ERROR_PASSIVE", "BUS_OFF", "ERROR_ACTIVE"] {
        assert!(states.contains(state), "{state}: {states}");
    }
    assert_eq!(cat(&file, &["--topics", "/bustape/event"]).len(), 2);
    Ok(())
}

fn flood() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let log = folder.path().join("log");
    let lines = (0..30_000).map(|n| {
        let frame = ["20000088#0000040A00000000", "20000204#0008000000006007"][n % 2];
        format!("(1700000000.{:06}) vcan0 {frame}\n", n * 33)
    });
    std::fs::write(&log, lines.collect::<String>())?;
    let before = sent_on("vcan0");
    let recorder = Recorder::start(&["vcan0"]);
    // As fast as the file says: 30,000 a second, faster than any bus.
    sh(&format!("canplayer -I {} vcan0=vcan0", log.display()));
    let sent = sent_on("vcan0") - before;
    let recorded = recorder.stop();
    recorded.assert_balanced(0);
    assert_eq!((sent, recorded.count(0, "received")), (30_000, 30_000));
    let written = recorded.count(0, "written");
    assert_eq!(cat(&recorded.file, &["--topics", "/vcan0/errors"]).len() as u64, written);
    assert!(recorded.stderr.lines().count() < 20, "{}", recorded.stderr);
    Ok(())
}

fn renamed() -> Result<(), Failed> {
    sh("ip link add vname type vcan && ip link set vname up");
    let recorder = Recorder::start(&["vname"]);
    sh(
        "cansend vname 100#; sleep 0.3; ip link set vname down && ip link set vname name vother && \
        ip link set vother up; sleep 0.5; cansend vother 1FF#",
    );
    let ticks = recorder.cpu_ticks();
    sh("sleep 1");
    assert!(recorder.cpu_ticks() - ticks <= 20, "waiting takes a fifth of a core");
    sh("ip link set vother down && ip link set vother name vname && ip link set vname up");
    let part = recorder.file.with_extension("mcap.part");
    wait_until("frames are recorded again", || {
        sh("cansend vname 101#; sleep 0.3");
        cat(&part, &[]).iter().any(|line| line.ends_with("101#"))
    });
    let recorded = recorder.stop();
    sh("ip link del vname");
    assert!(recorded.stderr.contains("called vother now"), "{}", recorded.stderr);
    assert_eq!(recorded.gaps("link_down").len(), 1);
    assert!(!cat(&recorded.file, &[]).iter().any(|line| line.ends_with("1FF#")));
    Ok(())
}

fn missing() -> Result<(), Failed> {
    let recorder = Recorder::start(&["vlate", "vcan1", "--missing", "wait"]);
    sh("cansend vcan1 100#; sleep 1; ip link add vlate type vcan && ip link set vlate up");
    let part = recorder.file.with_extension("mcap.part");
    wait_until("frames are recorded", || {
        sh("cansend vlate 101#; sleep 0.3");
        cat(&part, &["-f", "vlate"]).iter().any(|line| line.ends_with("101#"))
    });
    let recorded = recorder.stop();
    sh("ip link del vlate");
    assert_eq!(recorded.gaps("link_down").len(), 1);
    assert!(recorded.stderr.contains("there it is"), "{}", recorded.stderr);
    assert_eq!(recorded.count(1, "written"), 1, "the other was recorded meanwhile");
    recorded.assert_balanced(0);
    Ok(())
}

fn virtual_rate() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("a.mcap").display().to_string();
    let output = bustape(&["record", "vcan0@500000", "-o", &file, "--duration", "1s"]);
    let stderr = text(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let expected = "vcan0 is virtual (vcan) and has no bit rate: 500000 bit/s is ignored";
    assert!(stderr.contains(expected), "{stderr}");
    Ok(())
}
