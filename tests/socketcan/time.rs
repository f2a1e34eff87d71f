//! Steps of the wall clock neither bend nor reverse the recorded times.

use libtest_mimic::{Failed, Trial};

use crate::lab::{Recorder, cat, sh};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![trial("clock_steps_bend_no_interval_and_are_recorded", steps)]
}

fn steps() -> Result<(), Failed> {
    let recorder = Recorder::start(&["vcan0"]);
    // A frame every 20 ms or so; the clock is set an hour forward, two back, one forward.
    sh("cangen vcan0 -g 20 -n 250 & sender=$!; \
        for by in +3600 -7200 +3600; do sleep 1; date -s \"@$(( $(date +%s) + $by ))\" >/dev/null; done; \
        wait $sender");
    let recorded = recorder.stop();
    let times: Vec<f64> = cat(&recorded.file, &["-N", "-t", "z", "--topics", "/vcan0/raw"])
        .iter()
        .filter_map(|line| line.strip_prefix('(')?.split(')').next()?.parse().ok())
        .collect();
    assert_eq!(times.len(), 250);
    let backward = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert_eq!(backward, 0, "{times:?}");
    // 250 frames at 20 ms are five seconds; an hour anywhere would show.
    let longest = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    assert!(longest < 5.0, "two frames are {longest} s apart");
    let steps: Vec<f64> = cat(&recorded.file, &["--json", "--topics", "/bustape/clock"])
        .iter()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter_map(|entry| entry["message"]["step_ns"].as_f64())
        .filter(|step| *step != 0.0)
        .map(|step| (step / 1e9).round())
        .collect();
    assert_eq!(steps.len(), 3, "{steps:?}");
    for (step, expected) in steps.iter().zip([3600.0, -7200.0, 3600.0]) {
        // `date` sets whole seconds.
        assert!((step - expected).abs() <= 1.5, "{steps:?}");
    }
    Ok(())
}
