//! What is lost is counted, exactly.

use libtest_mimic::{Failed, Trial};

use crate::lab::{Recorder, cat, sent_on, sh, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("a_flood_of_200000_frames_with_a_stop_in_the_middle_adds_up", flood_with_stop),
        trial("drops_at_the_very_end_are_counted_too", drops_at_the_end),
        trial("a_queue_that_is_too_small_is_a_gap_of_the_right_size", small_queue),
    ]
}

fn flood_with_stop() -> Result<(), Failed> {
    let before = sent_on("vcan0");
    let recorder = Recorder::start(&["vcan0", "--receive-buffer", "512KiB"]);
    let pid = recorder.pid();
    sh(&format!(
        "cangen vcan0 -i -g 0 -n 200000 & sender=$!; sleep 1; kill -STOP {pid}; sleep 2; \
         kill -CONT {pid}; wait $sender"
    ));
    let sent = sent_on("vcan0") - before;
    let recorded = recorder.stop();
    recorded.assert_balanced(0);
    assert_eq!(recorded.count(0, "received"), sent);
    assert_eq!(
        cat(&recorded.file, &["--topics", "/vcan0/raw"]).len() as u64,
        recorded.count(0, "written")
    );
    let lost: u64 = recorded.gaps("kernel_queue").iter().filter_map(|g| g["count"].as_u64()).sum();
    assert_eq!(lost, recorded.count(0, "dropped"));
    assert!(lost > 0, "two seconds of full speed fit into 512 KiB: nothing was tested");
    assert_eq!(recorded.code, Some(3), "something was lost, so the exit status says so");
    Ok(())
}

fn drops_at_the_end() -> Result<(), Failed> {
    let before = sent_on("vcan1");
    let recorder = Recorder::start(&["vcan1", "--receive-buffer", "64KiB"]);
    recorder.signal("STOP");
    // The kernel tells a socket of its drops with the next frame, and there is none.
    sh("cangen vcan1 -i -g 0 -n 5000");
    recorder.signal("INT");
    recorder.signal("CONT");
    let recorded = recorder.wait();
    assert_eq!(recorded.count(0, "received"), sent_on("vcan1") - before);
    assert!(recorded.count(0, "dropped") > 0);
    recorded.assert_balanced(0);
    Ok(())
}

fn small_queue() -> Result<(), Failed> {
    let before = sent_on("vcan0");
    let recorder = Recorder::start(&["vcan0", "--queue", "8KiB", "--chunk-time", "2s"]);
    sh("cangen vcan0 -i -g 0 -n 20000");
    wait_until("the recorder has read it all", || {
        let drops = std::fs::read_to_string("/proc/net/can/stats");
        drops.is_ok() && std::path::Path::new(&recorder.file.with_extension("mcap.part")).exists()
    });
    let recorded = recorder.stop();
    assert_eq!(recorded.count(0, "received"), sent_on("vcan0") - before);
    recorded.assert_balanced(0);
    let gaps = recorded.gaps("recorder_queue");
    let lost: u64 = gaps.iter().filter_map(|gap| gap["count"].as_u64()).sum();
    assert!(lost > 0, "8 KiB held it all: nothing was tested");
    assert_eq!(lost, recorded.count(0, "dropped"));
    assert_eq!(recorded.code, Some(3));
    Ok(())
}
