//! A replay that answers like the recorded controller.

use std::process::{Command, Stdio};

use libtest_mimic::Failed;

use super::report;
use crate::lab::{BUSTAPE, Recorder, sent_on, sh, text, wait_until};

pub fn answers() -> Result<(), Failed> {
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
    // A setting is set: nobody answers that, and what is read back is what was recorded.
    sh("cansend vcan1 00132600#09; cansend vcan1 00130000#R");
    wait_until("all settings are there once more", || {
        sent_on("vcan1") == before + 16 + 17 + 3 + 17
    });
    sh("cansend vcan1 00110000#0B00050300100004; sleep 0.2");
    sh(&format!("kill -INT {}", child.id()));
    let output = child.wait_with_output().expect("bustape ends");
    let answers = report(&output)["buses"][0]["answers"].clone();
    assert_eq!((&answers["requests"], &answers["answered"]), (&5.into(), &4.into()), "{answers}");
    assert_eq!(answers["never_recorded"], 1, "{answers}");
    let said = text(&output.stderr);
    assert!(said.contains("never recorded: MODBUS_REQ [00110000#0B00050300100004]"), "{said}");
    Ok(())
}
