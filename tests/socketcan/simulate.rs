//! The simulated station on real interfaces.

use std::process::{Child, Command, Stdio};

use libtest_mimic::{Failed, Trial};

use crate::frames::Candump;
use crate::lab::{BUSTAPE, bustape, sent_on, sh, text, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("what_the_simulated_station_sends_is_known_to_its_protocol", both),
        trial("the_simulated_controller_answers_an_hmi_on_the_bus", controller),
        trial("a_simulation_refuses_an_interface_that_is_not_virtual", refuses),
    ]
}

/// bustape in the background; ends by its own `--duration`.
fn start(args: &[&str]) -> Child {
    Command::new(BUSTAPE).args(args).stderr(Stdio::null()).spawn().expect("bustape runs")
}

fn both() -> Result<(), Failed> {
    let candump = Candump::start(&["vcan0"]);
    let before = sent_on("vcan0");
    let faults = ["--faults", "bus-error=0.05,unknown-id=0.05"];
    let output = bustape(&["simulate", "hmi-can", "vcan0", "--duration", "3s"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let count = usize::try_from(sent_on("vcan0") - before)?;
    let lines = candump.lines(count);
    assert!(count > 150 && lines.len() == count, "{count} sent, {} seen", lines.len());
    let folder = tempfile::tempdir()?;
    let log = folder.path().join("log");
    std::fs::write(&log, lines.join("\n"))?;
    let log = log.display().to_string();
    let explained = bustape(&["explain", "--decode", "hmi-can", "--json", "--input", &log]);
    assert_eq!(explained.status.code(), Some(0), "{}", text(&explained.stderr));
    let lines = text(&explained.stdout);
    // What the end of the simulation has cut off stands behind the last frame.
    let last = lines.lines().rfind(|line| line.contains("\"id\":"));
    let cut_off = lines.lines().skip_while(|line| Some(*line) != last).skip(1).count();
    for line in lines.lines().take(lines.lines().count() - cut_off) {
        let frame: serde_json::Value = serde_json::from_str(line)?;
        if frame["assembly"].is_string() {
            assert_eq!(frame["complete"], true, "{line}");
            continue;
        }
        // The request of the settings is a remote frame.
        let modbus = frame["id"]
            .as_str()
            .is_some_and(|id| id.starts_with("0x0011") || id.starts_with("0x0012"));
        assert!(frame["rtr"] == true || modbus || frame["check"] == "exact", "{line}");
    }
    // Error frames are carried by a virtual interface.
    let candump = Candump::start(&["vcan0"]);
    let before = sent_on("vcan0");
    let mut args = vec!["simulate", "hmi-can", "vcan0", "--duration", "2s"];
    args.extend(faults);
    assert_eq!(bustape(&args).status.code(), Some(0));
    let lines = candump.lines(usize::try_from(sent_on("vcan0") - before)?);
    assert!(lines.iter().any(|line| line.contains(" 20000088#0000")), "no error frame");
    Ok(())
}

fn controller() -> Result<(), Failed> {
    let candump = Candump::start(&["vcan1"]);
    let mut simulation =
        start(&["simulate", "hmi-can", "vcan1", "--role", "controller", "--duration", "4s"]);
    let before = sent_on("vcan1");
    wait_until("the controller sends", || sent_on("vcan1") > before);
    // Another limit of the charging current, and the request of all settings.
    sh("cansend vcan1 00132600#09; cansend vcan1 00130000#R");
    simulation.wait()?;
    let lines = candump.lines(100);
    let settings: Vec<&String> = lines.iter().filter(|line| line.contains(" 001300")).collect();
    // The request, and fifteen packets; nobody plays an HMI here.
    assert_eq!(settings.len(), 16, "{settings:?}");
    assert!(settings[7].contains(" 00130007#") && settings[7].contains('#'), "{}", settings[7]);
    let data = settings[7].rsplit('#').next().unwrap_or_default();
    assert_eq!(&data[4..6], "09", "{}", settings[7]);
    assert!(!lines.iter().any(|line| line.contains(" 0011")), "a MODBUS request");
    Ok(())
}

/// A CAN adapter on a serial line is an interface of the kind `can`. Its line here is that of the
/// simulated rectifier, which takes no notice.
fn refuses() -> Result<(), Failed> {
    // slcand takes names below /dev only.
    let path = "/dev/bustape-slcan";
    let mut adapter = start(&["simulate", "zhongheng-09", &format!("pty:{path}")]);
    wait_until("the line", || std::fs::exists(path).unwrap_or(false));
    let mut slcand = Command::new("slcand")
        .args(["-F", "-o", "-s4", "bustape-slcan", "adapter0"])
        .stderr(Stdio::null())
        .spawn()
        .expect("slcand runs");
    let here = || std::fs::exists("/sys/class/net/adapter0").unwrap_or(false);
    wait_until("the interface", here);
    sh("ip link set adapter0 up");
    let refused = bustape(&["simulate", "hmi-can", "adapter0", "--duration", "1s"]);
    let stderr = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(4), "{stderr}");
    assert!(stderr.contains("nothing was sent: adapter0 (CAN controller) may reach"), "{stderr}");
    assert_eq!(sent_on("adapter0"), 0);
    let named =
        ["simulate", "hmi-can", "adapter0", "--duration", "1s", "--transmit-on", "adapter0"];
    let with_errors = [&named[..], &["--faults", "bus-error=0.1"]].concat();
    assert_eq!(bustape(&with_errors).status.code(), Some(2));
    assert_eq!(bustape(&named).status.code(), Some(0));
    assert!(sent_on("adapter0") > 0);
    for child in [&mut slcand, &mut adapter] {
        child.kill().expect("it is ours");
        child.wait().expect("it is ours");
    }
    Ok(())
}
