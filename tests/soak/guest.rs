//! What needs CAN interfaces, a clock that may be set, or a disk of its own: in the emulated machine.

use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::item::{Found, Item, Job, spread};
use super::power;
use crate::lab::{Recorded, Recorder, cat, sent_on, sh, wait_until};
use crate::support::bytes::Random;

/// Tells this program that it is in the machine.
pub const GUEST: &str = "--in-guest";

pub const DROPS: Item = Item {
    name: "drops",
    promise: "a recorder stopped (SIGSTOP) while an interface is flooded: sent = written + gaps, every time, also when \
              it is ended right after the drop",
    count: 100,
    unit: "floods",
    side_by_side: 1,
    run: |job| in_lab(job, "drops"),
};

pub const LINKS: Item = Item {
    name: "links",
    promise: "an interface goes down and up, or is deleted and added: one gap each, frames again within 1 s, at most \
              5 % of a core meanwhile",
    count: 100,
    unit: "cycles",
    side_by_side: 1,
    run: |job| in_lab(job, "links"),
};

pub const STEPS: Item = Item {
    name: "steps",
    promise: "the wall clock is set by an hour, by 10 ms, forward and back, while recording: no time goes back, no \
              interval bends, every step is recorded",
    count: 20,
    unit: "steps",
    side_by_side: 1,
    run: |job| in_lab(job, "steps"),
};

pub const REPLAY_STEPS: Item = Item {
    name: "replay-steps",
    promise: "the same while a recording is replayed: every frame, in its order, at its time",
    count: 20,
    unit: "steps",
    side_by_side: 1,
    run: |job| in_lab(job, "replay-steps"),
};

/// This program again, where there are CAN interfaces.
fn in_lab(job: &Job, what: &str) -> Found {
    let lab = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/lab/vcan-run");
    let own = std::env::current_exe().expect("this program has a path");
    let mut command = Command::new(lab);
    command.args(["--timeout", "7200", "--"]).arg(own).args([GUEST, what]);
    command.args([job.seed.to_string(), job.count.to_string()]);
    let output = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output().expect("it starts");
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.lines().last().unwrap_or_default();
    let result: Value =
        serde_json::from_str(last).unwrap_or_else(|e| panic!("{}: {e}: {text}", output.status));
    let texts = |key: &str| -> Vec<String> {
        let list = result[key].as_array().into_iter().flatten();
        list.filter_map(|text| text.as_str().map(str::to_owned)).collect()
    };
    let numbers = result["numbers"].as_array().into_iter().flatten();
    let numbers = numbers
        .filter_map(|pair| Some((pair[0].as_str()?.to_owned(), pair[1].as_str()?.to_owned())));
    Found {
        done: result["done"].as_u64().unwrap_or(0),
        all: None,
        numbers: numbers.collect(),
        violations: texts("violations"),
    }
}

/// Does the work in the machine, if this is there.
pub fn child() -> Option<ExitCode> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.first().is_none_or(|first| first != GUEST) {
        return None;
    }
    if args[1] == "power" {
        power::in_guest(&args[2], Path::new(&args[3]));
        return Some(ExitCode::SUCCESS);
    }
    let (seed, count) = (args[2].parse().expect("a seed"), args[3].parse().expect("a number"));
    super::runs::catch_panics();
    let mut found = Found::default();
    let work: fn(u64, u64, &mut Found) = match args[1].as_str() {
        "drops" => drops,
        "links" => links,
        "steps" => steps,
        "replay-steps" => replay_steps,
        other => panic!("{other}?"),
    };
    let done =
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(seed, count, &mut found)));
    if done.is_err() {
        found.violations.push(super::runs::said());
    }
    println!("{}", json!(found.json()));
    Some(ExitCode::SUCCESS)
}

/// Sum of the gaps with a reason.
fn lost(recorded: &Recorded, reason: &str) -> u64 {
    recorded.gaps(reason).iter().filter_map(|gap| gap["count"].as_u64()).sum()
}

fn drops(seed: u64, count: u64, found: &mut Found) {
    let (mut sent_all, mut lost_all) = (0, 0);
    for run in 0..count {
        let mut random = Random::new(seed << 32 | run);
        let before = sent_on("vcan0");
        let recorder = Recorder::start(&["vcan0", "--receive-buffer", "32KiB"]);
        let pid = recorder.pid();
        let frames = 2000 + random.below(2000);
        let pause = format!("0.{}", 1 + random.below(4));
        let at_once = random.below(3) == 0;
        sh(&format!(
            "kill -STOP {pid}; cangen vcan0 -i -g 0 -n {frames}; sleep {pause}; {} kill -CONT {pid}",
            if at_once { format!("kill -INT {pid};") } else { String::new() }
        ));
        let recorded = if at_once {
            recorder.wait()
        } else {
            sh("cangen vcan0 -i -g 1 -n 20");
            recorder.stop()
        };
        let sent = sent_on("vcan0") - before;
        recorded.assert_balanced(0);
        let dropped = lost(&recorded, "kernel_queue");
        assert!(dropped > 0, "run {run}: nothing was dropped, so nothing was tested");
        assert_eq!(recorded.count(0, "written") + dropped, sent, "run {run}: {}", recorded.report);
        assert_eq!(recorded.code, Some(3), "run {run}");
        (sent_all, lost_all) = (sent_all + sent, lost_all + dropped);
        found.done += 1;
        if run % 10 == 9 {
            eprintln!("  {} of {count}", run + 1);
        }
    }
    found.number("frames sent / of these in gaps", format!("{sent_all} / {lost_all}"));
}

fn links(seed: u64, count: u64, found: &mut Found) {
    sh("ip link add vflap type vcan && ip link set vflap mtu 72 up");
    let recorder = Recorder::start(&["vflap", "vcan0"]);
    let part = recorder.file.with_extension("mcap.part");
    let mut back = Vec::new();
    let mut most_ticks = 0.0_f64;
    for cycle in 0..count {
        let mut random = Random::new(seed << 32 | cycle);
        let away = 200 + random.below(1200) as u64;
        let (gone, again) = match cycle % 2 {
            0 => ("ip link set vflap down", "ip link set vflap up"),
            _ => {
                ("ip link del vflap", "ip link add vflap type vcan && ip link set vflap mtu 72 up")
            }
        };
        sh(gone);
        std::thread::sleep(Duration::from_millis(200));
        let ticks = recorder.cpu_ticks();
        std::thread::sleep(Duration::from_millis(away));
        if away >= 1000 {
            let share = (recorder.cpu_ticks() - ticks) as f64 * 10.0 / away as f64;
            most_ticks = most_ticks.max(share);
        }
        let length = part.metadata().map_or(0, |about| about.len());
        sh(again);
        let up = Instant::now();
        // A frame every 10 ms until one is recorded: the first that is tells how long it took.
        sh(&format!("cangen vflap -I {cycle:03x} -L 0 -g 10 -n 100 >/dev/null 2>&1 & sleep 0.1"));
        wait_until("the recorder is back", || {
            part.metadata().is_ok_and(|about| about.len() > length + 200)
        });
        wait_until("frames are recorded again", || {
            cat(&part, &["-f", "vflap"]).iter().any(|line| line.contains(&format!(" {cycle:03X}#")))
        });
        sh("wait; sleep 1");
        let first = cat(&part, &["-f", "vflap"])
            .into_iter()
            .find(|line| line.contains(&format!(" {cycle:03X}#")));
        let first: f64 =
            first.and_then(|line| line.strip_prefix('(')?.split(')').next()?.parse().ok()).unwrap();
        let now =
            std::time::SystemTime::now().duration_since(std::time::SystemTime::UNIX_EPOCH).unwrap();
        back.push((first - (now.as_secs_f64() - up.elapsed().as_secs_f64())).max(0.0) * 1e3);
        found.done += 1;
        if cycle % 10 == 9 {
            eprintln!("  {} of {count}", cycle + 1);
        }
    }
    let recorded = recorder.stop();
    sh("ip link del vflap");
    let gaps = recorded.gaps("link_down");
    recorded.assert_balanced(0);
    found.require(gaps.len() as u64 == count, || format!("{} gaps for {count} cycles", gaps.len()));
    let (p50, max) = spread(&mut back, 0.5);
    found.number(
        "first frame recorded after the link was up, p50 / max",
        format!("{p50:.0} / {max:.0} ms"),
    );
    found.number("most of an emulated core while down", format!("{:.1} %", most_ticks * 100.0));
    found.require(max <= 1000.0, || format!("frames again only after {max:.0} ms"));
    found.require(most_ticks <= 0.05, || {
        format!("{:.1} % of a core while down", most_ticks * 100.0)
    });
}

fn steps(seed: u64, count: u64, found: &mut Found) {
    let recorder = Recorder::start(&["vcan0"]);
    let mut random = Random::new(seed);
    let mut expected = Vec::new();
    let frames = count * 50;
    sh(&format!("cangen vcan0 -g 20 -n {frames} >/dev/null 2>&1 & echo"));
    let begun = Instant::now();
    for _ in 0..count {
        std::thread::sleep(Duration::from_millis(600 + random.below(600) as u64));
        expected.push(step_clock(&mut random));
    }
    std::thread::sleep(Duration::from_secs(2));
    let lasted = begun.elapsed().as_secs_f64();
    let recorded = recorder.stop();
    let times: Vec<f64> = cat(&recorded.file, &["-N", "-t", "z", "--topics", "/vcan0/raw"])
        .iter()
        .filter_map(|line| line.strip_prefix('(')?.split(')').next()?.parse().ok())
        .collect();
    let backward = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
    let longest = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    let told: Vec<f64> = cat(&recorded.file, &["--json", "--topics", "/bustape/clock"])
        .iter()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter_map(|entry| entry["message"]["step_ns"].as_f64())
        .filter(|step| *step != 0.0)
        .map(|step| step / 1e9)
        .collect();
    found.done = count;
    found.number("frames", times.len());
    found.number("times that go back", backward);
    found.number("longest interval of frames sent every 20 ms", format!("{:.0} ms", longest * 1e3));
    found.number("steps recorded", told.len());
    found.require(backward == 0, || format!("{backward} times go back"));
    found.require(longest < 2.0, || format!("two frames are {longest} s apart"));
    let span = times.last().unwrap_or(&0.0) - times.first().unwrap_or(&0.0);
    found.require(span <= lasted + 1.0, || format!("{span} s in {lasted} s"));
    let off: Vec<f64> =
        expected.iter().zip(&told).map(|(step, told)| (step - told).abs()).collect();
    let worst = off.iter().copied().fold(0.0, f64::max);
    found.number("recorded steps off by at most", format!("{:.1} ms", worst * 1e3));
    found.require(told.len() == expected.len(), || format!("{told:?} for {expected:?}"));
    found.require(worst < 0.005, || format!("{told:?} for {expected:?}"));
}

/// Sets the wall clock; returns by how much, in seconds.
fn step_clock(random: &mut Random) -> f64 {
    let kinds = [3600.0, -3600.0, 0.01, -0.01, 86_400.0, -86_400.0];
    let step = kinds[random.below(kinds.len())];
    let now = nix::time::ClockId::CLOCK_REALTIME.now().expect("a clock");
    let new = Duration::from(now).as_nanos() as i128 + (step * 1e9) as i128;
    let new = libc::timespec {
        tv_sec: (new / 1_000_000_000) as i64,
        tv_nsec: (new % 1_000_000_000) as i64,
    };
    // SAFETY: a plain system call with a structure of ours; the clock is the machine's own.
    let set = unsafe { libc::clock_settime(libc::CLOCK_REALTIME, &raw const new) };
    assert_eq!(set, 0, "the clock cannot be set");
    step
}

fn replay_steps(seed: u64, count: u64, found: &mut Found) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("played.mcap");
    let path = file.to_str().expect("a name in letters");
    let seconds = count + 2;
    let made = crate::lab::bustape(&[
        "record",
        "a=sim:hmi-can",
        "--duration",
        &format!("{seconds}s"),
        "-o",
        path,
    ]);
    assert!(made.status.success(), "{}", crate::lab::text(&made.stderr));
    let mut random = Random::new(seed);
    let playing = Command::new(crate::lab::BUSTAPE)
        .args(["replay", path, "--to", "a=vcan0", "--verify", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("bustape runs");
    std::thread::sleep(Duration::from_secs(1));
    let begun = Instant::now();
    for _ in 0..count {
        std::thread::sleep(Duration::from_millis(600 + random.below(300) as u64));
        step_clock(&mut random);
        found.done += 1;
    }
    let stepped = begun.elapsed();
    let played = playing.wait_with_output().expect("it ends");
    let said = crate::lab::text(&played.stderr);
    found.require(played.status.success(), || format!("{}: {said}", played.status));
    let report: Value = serde_json::from_slice(&played.stdout).expect("replay prints JSON");
    let took = report["took_ns"].as_f64().unwrap_or(0.0) / 1e9;
    let bus = &report["buses"][0];
    let late = |which: &str| bus["lateness_ns"][which].as_f64().unwrap_or(f64::MAX) / 1e6;
    found.number("frames sent", bus["sent"].to_string());
    found.number(
        "lateness, p50 / p99 / max",
        format!("{:.2} / {:.1} / {:.1} ms", late("p50"), late("p99"), late("max")),
    );
    found.number(
        "seconds played / with steps in them",
        format!("{took:.1} / {:.1}", stepped.as_secs_f64()),
    );
    found.number("compared by --verify", bus["verify"].to_string());
    found.require(took > stepped.as_secs_f64(), || "the last steps came after the end".to_owned());
    found.require((took - seconds as f64).abs() < 1.0, || format!("{took} s for {seconds} s"));
    found.require(late("p50") < 10.0, || format!("late by {} ms", late("p50")));
}
