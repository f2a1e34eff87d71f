//! `bustape retime`: recordings of machines whose clock was set late.

use std::path::{Path, PathBuf};

use bustape::frame::{
    CanFlags, CanFrame, Frame, Gap, GapReason, Level, Notice, Stamped, Timestamp, Unit,
};
use bustape::recording::definition::Facts;
use bustape::recording::schema::bustape::ClockSync;
use bustape::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};

use crate::record::in_order;
use crate::support::make::{SECOND, head};
use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{args, bustape};

/// What time it really was when the steady clock stood at 0.
const TRUTH: u64 = 1_790_000_000 * SECOND;

/// A segment of ten seconds that began `steady` seconds after the boot, on a machine that thought it
/// had booted in 1970. `steps` are by how much the clock was set, and after how many seconds.
fn segment(path: &Path, layout: Layout, session: &str, steady: u64, steps: &[(u64, i64)]) {
    let base = 3 * SECOND;
    let mut head: Head = head(&["can0"]);
    head.recording.insert("boot_id".to_owned(), "the boot".to_owned());
    head.recording.insert("session_id".to_owned(), session.to_owned());
    let time = |after: u64| Timestamp(base + (steady + after) * SECOND);
    head.time = time(0);
    head.clock = Facts::from([
        ("log_time_ns".to_owned(), time(0).nanos().to_string()),
        ("steady_ns".to_owned(), (steady * SECOND).to_string()),
        ("wall_ns".to_owned(), time(0).nanos().to_string()),
    ]);
    let file = std::fs::File::create_new(path).unwrap();
    let options = WriterOptions { layout, batch_frames: 40, ..WriterOptions::default() };
    let mut writer = SegmentWriter::create(Box::new(file), options, &head).unwrap();
    let mut set = 0;
    for second in 0..10 {
        let now = time(second);
        for n in 0..20 {
            let frame = CanFrame::new(n, CanFlags::default(), &[second as u8; 8]);
            let time = now.plus(u64::from(n) * 7_000_000);
            writer.add(0, &Stamped { time, value: Frame::Can(frame) }).unwrap();
        }
        let step = steps.iter().find(|(at, _)| *at == second).map_or(0, |(_, step)| *step);
        set += step;
        let sync = ClockSync {
            steady_ns: (steady + second) * SECOND + 1,
            wall_ns: now.nanos().saturating_add_signed(set) + 1,
            step_ns: step,
        };
        writer.add_clock(now.plus(1), &sync).unwrap();
        let notice = Notice { level: Level::Info, text: "something".to_owned() };
        writer.add_notice(now, "can0", &notice).unwrap();
        writer.cut().unwrap();
    }
    let (count, unit, reason) = (7, Unit::Frames, GapReason::KernelQueue);
    let gap = Gap { count, unit, reason, from: time(3), to: time(4) };
    writer.add(0, &Stamped { time: time(9), value: Frame::Gap(gap) }).unwrap();
    writer.finish(Facts::from([("reason".to_owned(), "made".to_owned())])).unwrap();
}

/// By how much the clock is wrong at first.
fn wrong() -> i64 {
    (TRUTH - 3 * SECOND) as i64
}

fn name(folder: &Path, session: u32) -> PathBuf {
    folder.join(format!("plant_s{session:04}_0001_19700101T000003Z.mcap"))
}

/// Two recordings of one boot: the first ended before the clock was set.
fn boot(folder: &Path, layout: Layout) {
    segment(&name(folder, 1), layout, "first", 5, &[]);
    // A hand that missed by an hour, then NTP.
    let steps = [(3, wrong() + 3_600_000_000_000), (6, -3_600_000_000_000)];
    segment(&name(folder, 2), layout, "second", 100, &steps);
}

/// All times in a file, moved back, must be those of the original, and all else the same.
fn is_moved(new: &Mcap, old: &Mcap, by: i64) {
    let back = |nanos: u64| nanos.saturating_add_signed(-by);
    assert_eq!(new.messages.len(), old.messages.len());
    for ((new_message, new_text), (old_message, old_text)) in
        messages::decoded(new).zip(messages::decoded(old))
    {
        assert_eq!(back(new_message.time), old_message.time);
        assert_eq!(new.topic(new_message), old.topic(old_message));
        let (mut new_json, old_json) =
            (messages::as_python(&new_text), messages::as_python(&old_text));
        for key in ["from_ns", "to_ns"] {
            if let Some(value) = new_json.get_mut(key) {
                *value = back(value.as_u64().unwrap()).into();
            }
        }
        if let Some(stamp) = new_json.get_mut("timestamp") {
            let number = |key: &str| stamp.get(key).map_or(0, |v| v.as_u64().unwrap());
            let nanos = back(number("seconds") * SECOND + number("nanos"));
            let old = &old_json["timestamp"];
            let number = |key: &str| old.get(key).map_or(0, |v| v.as_u64().unwrap());
            assert_eq!(nanos, number("seconds") * SECOND + number("nanos"));
            *stamp = old.clone();
        }
        assert_eq!(new_json, old_json);
    }
    assert_eq!(new.attachments, old.attachments);
    let facts = new.facts("bustape.clock");
    assert_eq!(facts["wall_ns"], old.facts("bustape.clock")["wall_ns"]);
    let time = |file: &Mcap| file.facts("bustape.clock")["log_time_ns"].parse::<u64>().unwrap();
    assert_eq!(back(time(new)), time(old));
    assert_eq!(new.facts("bustape.retime")["offset_ns"], by.to_string());
}

#[test]
fn a_boot_without_a_clock_gets_the_time_that_was_known_later() {
    for layout in [Layout::Frame, Layout::Batch] {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("from"), folder.path().join("to"));
        for folder in [&from, &to] {
            std::fs::create_dir(folder).unwrap();
        }
        boot(&from, layout);
        let ran = bustape(args(&[&"retime", &from, &"-d", &to, &"--json"])).expect(0).json();
        let stretches = ran["boots"][0]["stretches"].as_array().unwrap();
        let off: Vec<i64> =
            stretches.iter().map(|s| s["wall_clock_off_ns"].as_i64().unwrap()).collect();
        assert_eq!(off, [-wrong(), 3_600_000_000_000, 0], "{ran}");
        for session in [1, 2] {
            let output = ran["files"][session as usize - 1]["output"].as_str().unwrap();
            // 1,790,000,005 and 1,790,000,100 seconds after 1970.
            let stamp = ["20260921T141320Z", "20260921T141320Z"][session as usize - 1];
            assert!(
                output.ends_with(&format!("plant_s{session:04}_0001_{stamp}.mcap")),
                "{output}"
            );
            let (new, old) =
                (mcap::finished(Path::new(output)), mcap::finished(&name(&from, session)));
            in_order(&new, true);
            is_moved(&new, &old, wrong());
            let first = messages::cans(&new, "can0")[0].0;
            let steady = [5, 100][session as usize - 1];
            assert_eq!(first, TRUTH + steady * SECOND);
        }
        // Once right, they stay as they are.
        let again = folder.path().join("again");
        std::fs::create_dir(&again).unwrap();
        let ran = bustape(args(&[&"retime", &to, &"-d", &again, &"--json"])).expect(0).json();
        assert!(ran["files"].as_array().unwrap().iter().all(|f| f["offset_ns"] == 0), "{ran}");
    }
}

#[test]
fn by_file_each_gets_the_time_that_was_known_at_its_own_end() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("to");
    std::fs::create_dir(&to).unwrap();
    let file = |session: u32, tail: &str| {
        folder.path().join(format!("plant_s{session:04}_0001_19700101T000003Z{tail}.mcap"))
    };
    // Never set; set an hour wrong; by then right. The last one is a window around a trigger.
    let hour = 3_600_000_000_000;
    segment(&file(1, ""), Layout::Frame, "first", 5, &[]);
    segment(&file(2, ""), Layout::Batch, "second", 100, &[(3, wrong() + hour)]);
    segment(&file(3, "_battery-low"), Layout::Frame, "third", 200, &[(0, wrong())]);
    let run = |more: &[&str]| {
        let mut all = args(&[&"retime", &folder.path(), &"--json"]);
        all.extend(more.iter().map(Into::into));
        let files = bustape(all).expect(0).json()["files"].as_array().unwrap().clone();
        let number = |file: &serde_json::Value| file["offset_ns"].as_i64().unwrap();
        (files.iter().map(number).collect::<Vec<_>>(), files)
    };
    assert_eq!(run(&["--dry-run"]).0, [wrong(); 3]);
    let to = to.to_str().unwrap();
    let (offsets, files) = run(&["--per-file", "-d", to]);
    assert_eq!(offsets, [wrong() + hour, wrong() + hour, wrong()]);
    let last = files[2]["output"].as_str().unwrap();
    assert!(last.ends_with("plant_s0003_0001_20260921T141320Z_battery-low.mcap"), "{last}");
    is_moved(&mcap::finished(Path::new(last)), &mcap::finished(&file(3, "_battery-low")), wrong());
}

#[test]
fn it_says_what_it_would_do_and_does_it_by_hand_too() {
    let folder = tempfile::tempdir().unwrap();
    boot(folder.path(), Layout::Frame);
    let ran = bustape(args(&[&"retime", &folder.path(), &"--dry-run"])).expect(0);
    assert!(
        ran.out.contains("boot the boot") && ran.out.contains("wall clock right"),
        "{}",
        ran.out
    );
    assert!(ran.out.contains("off by +1h 00m 00s"), "{}", ran.out);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    let (old, new) = (name(folder.path(), 1), folder.path().join("new.mcap"));
    bustape(args(&[&"retime", &old, &"-o", &new, &"--offset=+1h0m0.5s"])).expect(0);
    is_moved(&mcap::finished(&new), &mcap::finished(&old), 3_600_500_000_000);
    // Nothing is overwritten.
    bustape(args(&[&"retime", &old, &"-o", &new, &"--offset", &"-1s"])).expect(1);
    // The second in a name is not another one because of some nanoseconds.
    let nanos = args(&[&"retime", &old, &"--dry-run"]);
    let ran = bustape(nanos.into_iter().chain(args(&[&"--offset=-0.000000009s"]))).expect(0);
    assert!(ran.out.contains("_19700101T000003Z.mcap: times moved by -9 ns"), "{}", ran.out);
}

#[test]
fn a_clock_that_was_never_set_is_said_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (path, new) = (name(folder.path(), 1), folder.path().join("new.mcap"));
    segment(&path, Layout::Frame, "first", 5, &[]);
    let ran = bustape(args(&[&"retime", &path, &"-o", &new])).expect(1);
    assert!(ran.err.contains("was never set") && ran.err.contains("--offset"), "{}", ran.err);
    assert!(!new.exists());
    bustape(args(&[&"retime", &path, &"-o", &new, &"--offset", &"soon"])).expect(2);
}
