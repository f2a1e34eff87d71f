//! Disks that are slow, stand still, or are full.

use std::io::Write as _;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use super::calls::injected;
use super::feed::{Log, Until, talk};
use super::item::{Found, Item, Job};
use super::kills::{files, terminal};
use super::runs::{Run, runs};
use crate::record::{balanced, in_order, weight};
use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, RECORDER_QUEUE};
use crate::support::process::{Running, args, spawn};
use crate::support::{peers, until};

/// Records a second while the disk stands still.
const RATE: u64 = 8_000;

pub const STALLS: Item = Item {
    name: "stalls",
    promise: "a disk on which every sync takes 500 ms costs nothing at 8,000 records/s, nor does a sync that stands \
              still for 10 s, with a queue of 256 KiB; a write that stands still for 10 s costs nothing with the \
              queue as it is; with one of 256 KiB what it costs is counted to the byte, memory grows by less than \
              64 MiB, and nothing more is lost 1 s after its end",
    count: 12,
    unit: "recordings",
    side_by_side: 3,
    run: stalls,
};

pub const FULL: Item = Item {
    name: "full",
    promise: "a disk of 64 MiB that gets full under --when-full stop: finished files, exit status 3, every byte \
              that is called written readable, received = written + dropped",
    count: 100,
    unit: "disks",
    side_by_side: 2,
    run: full,
};

pub const RING: Item = Item {
    name: "ring",
    promise: "a disk of 64 MiB under --when-full ring: goes on for ever, never below --min-free at the end, the \
              marked segment and the one before it stay, books balance (default: 1 h)",
    count: 1,
    unit: "recordings",
    side_by_side: 1,
    run: ring,
};

/// What is slow, and how much may wait for it.
struct Stall {
    name: &'static str,
    call: &'static str,
    inject: &'static str,
    queue: &'static str,
    costs: bool,
}

const KINDS: [Stall; 4] = [
    Stall {
        name: "syncs of 500 ms, queue 256 KiB",
        call: "fdatasync",
        inject: "delay_enter=500000:when=2+",
        queue: "256KiB",
        costs: false,
    },
    Stall {
        name: "a sync of 10 s, queue 256 KiB",
        call: "fdatasync",
        inject: "delay_enter=10000000:when=6",
        queue: "256KiB",
        costs: false,
    },
    Stall {
        name: "a write of 10 s, queue 16 MiB",
        call: "write",
        inject: "delay_enter=10000000:when=40",
        queue: "16MiB",
        costs: false,
    },
    Stall {
        name: "a write of 10 s, queue 256 KiB",
        call: "write",
        inject: "delay_enter=10000000:when=40",
        queue: "256KiB",
        costs: true,
    },
];

fn stalls(job: &Job) -> Found {
    peers::peers();
    let (mut found, results) =
        runs(job, |run| slow(&run, &KINDS[run.number as usize % KINDS.len()]));
    for (kind, Stall { name, .. }) in KINDS.iter().enumerate() {
        let of = || results.iter().filter(|(number, ..)| *number as usize % KINDS.len() == kind);
        let dropped: u64 = of().map(|(_, dropped, ..)| dropped).sum();
        let grown = of().map(|(_, _, grown)| grown).max().unwrap_or(&0);
        found.number(
            name,
            format!("{dropped} bytes dropped, memory grew by at most {} MiB", grown >> 10),
        );
    }
    found
}

/// A field of `/proc/PID/status` in KiB.
pub fn memory(pid: u32, field: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field)?.strip_prefix(':'));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Number of the run, bytes dropped, and by how much memory grew in KiB.
fn slow(run: &Run<'_>, stall: &Stall) -> (u64, u64, u64) {
    let (tty, path) = (run.folder.join("tty"), run.folder.join("a.mcap"));
    let part = run.folder.join("a.mcap.part");
    let line = format!("line=pty:{}", tty.display());
    let options = args(&[&"record", &line, &"-o", &path, &"--json", &"--queue", &stall.queue]);
    let (trace, inject) =
        (format!("trace={}", stall.call), format!("inject={}:{}", stall.call, stall.inject));
    let running = injected(run.bustape, &[&trace, &inject], &[&part], options);
    let stop = AtomicBool::new(false);
    let mut line = terminal(&tty, &stop).expect("a terminal");
    let (log, grown) = std::thread::scope(|scope| {
        let _until = Until(&stop);
        std::thread::sleep(Duration::from_millis(300));
        let base = memory(running.pid(), "VmRSS");
        let talking = scope.spawn(|| talk(&mut line, RATE, &stop));
        std::thread::sleep(Duration::from_secs(20));
        stop.store(true, Relaxed);
        let log = talking.join().expect("the sender goes on");
        (log, memory(running.pid(), "VmHWM").saturating_sub(base))
    });
    let ran = running.stop();
    let file = mcap::finished(&path);
    in_order(&file, true);
    balanced(&ran, &file);
    let books = &ran.json()["buses"][0];
    let sent = log.bytes();
    assert_eq!(books["received"], sent.len(), "received is what was sent");
    let dropped = books["dropped"].as_u64().unwrap();
    assert!(grown < 64 << 10, "memory grew by {grown} KiB");
    if stall.costs {
        assert!(dropped > 0, "the queue never ran over: nothing was tested");
        placed(&file, &log);
    } else {
        assert_eq!(dropped, 0, "bytes were dropped");
        assert!(messages::streams(&file, "line").0 == sent);
    }
    (run.number, dropped, grown)
}

/// The longest gap is the stall, and is over a second after it. (A busy disk may have made others.)
fn placed(file: &Mcap, log: &Log) {
    let mut gaps = Vec::new();
    for (message, gap) in messages::decoded(file) {
        if file.topic(message) == "/line/gaps" {
            let gap = messages::as_python(&gap);
            assert_eq!(gap["reason"], RECORDER_QUEUE, "{gap}");
            let [from, to] = ["from_ns", "to_ns"].map(|key| gap[key].as_u64().unwrap());
            gaps.push(Duration::from_nanos(to - from));
        }
    }
    let longest = gaps.iter().max().copied().unwrap_or_default();
    let stalled = Duration::from_secs(5)..=Duration::from_secs(11);
    assert!(stalled.contains(&longest), "{gaps:?} in {} writes", log.writes.len());
}

/// 64 MiB in a mount namespace of its own. `OPTIONS` are further options.
const DISK: &str = r#"
set -eu
trap : TERM
mount -t tmpfs -o size=64m none "$1/disk"
MARK
status=0
"$2" record "line=pty:$1/tty" sim:hmi-can -d "$1/disk" --json OPTIONS || status=$?
df --output=avail -k "$1/disk" | tail -1 > "$1/avail"
mkdir "$1/found"
mv "$1"/disk/* "$1/found/"
exit $status
"#;

fn on_small_disk(run: &Run<'_>, mark: &str, options: &str) -> Running {
    std::fs::create_dir(run.folder.join("disk")).unwrap();
    let script = DISK.replace("OPTIONS", options).replace("MARK", mark);
    let own = if nix::unistd::geteuid().is_root() { "-m" } else { "-rm" };
    let mut command = Command::new("unshare");
    command.args([own, "sh", "-c", &script, "sh"]).arg(run.folder).arg(run.bustape);
    spawn(command)
}

fn full(job: &Job) -> Found {
    let (mut found, shares) = runs(job, |mut run| {
        // Every other time somebody else eats the room, too.
        let eater = "( sleep 0.3; head -c 20M /dev/zero >\"$1/disk/other\" ) &";
        let mark = if run.number.is_multiple_of(2) { "" } else { eater };
        let split =
            ["--split-size 8MiB", "--split-size 1GiB", "--split-time 500ms"][run.random.below(3)];
        let running = on_small_disk(&run, mark, split);
        let mut line =
            terminal(&run.folder.join("tty"), &AtomicBool::new(false)).expect("a terminal");
        // Nothing that compresses: a disk is to be filled.
        let bytes = crate::support::bytes::noise(run.number, 1 << 20);
        while line.write_all(&bytes).is_ok() {}
        let ran = running.wait().expect(3);
        assert_eq!(ran.json()["reason"], "disk full", "{}", ran.err);
        let found = run.folder.join("found");
        std::fs::remove_file(found.join("other")).ok();
        let files: Vec<Mcap> = files(&found)
            .into_iter()
            .map(|(path, file)| {
                assert!(
                    path.extension().is_some_and(|e| e == "mcap"),
                    "{} is not finished",
                    path.display()
                );
                file
            })
            .collect();
        let json = ran.json();
        for bus in json["buses"].as_array().unwrap() {
            let number = |key: &str| bus[key].as_u64().unwrap();
            assert_eq!(number("received"), number("written") + number("dropped"), "{bus}");
            let name = bus["bus"].as_str().unwrap();
            let readable: u64 = files.iter().map(|file| weight(file, name)).sum();
            assert_eq!(readable, number("written"), "{bus}");
        }
        let written = json["buses"][0]["written"].as_u64().unwrap();
        assert!(written > 20 << 20, "{json}");
        written
    });
    let least = results_range(&shares);
    found.number("bytes written of 64 MiB, least / most", least);
    found
}

fn results_range(values: &[u64]) -> String {
    let mib = |value: Option<&u64>| value.map_or(0, |bytes| bytes >> 20);
    format!("{} / {} MiB", mib(values.iter().min()), mib(values.iter().max()))
}

const MARK: &str = r#"
(
    while ! ls "$1"/disk/*_0003_*.mcap* >/dev/null 2>&1; do sleep 0.05; done
    "$2" keep "$1"/disk/*_0002_*.mcap && touch "$1/marked"
) &"#;

fn ring(job: &Job) -> Found {
    let time = job.duration.unwrap_or(Duration::from_secs(3600));
    let (mut found, results) = runs(job, |run| {
        let running = on_small_disk(&run, MARK, "--when-full ring --min-free 4MiB");
        let mut line =
            terminal(&run.folder.join("tty"), &AtomicBool::new(false)).expect("a terminal");
        let (started, mut seed, mut sent) = (Instant::now(), 0, 0);
        while started.elapsed() < time {
            // 2 MiB/s: the disk is written anew every half minute.
            let bytes = crate::support::bytes::noise(seed, 64 << 10);
            line.write_all(&bytes).expect("the recording goes on");
            (seed, sent) = (seed + 1, sent + bytes.len() as u64);
            let due = Duration::from_millis(seed * 1000 / 32);
            std::thread::sleep(due.saturating_sub(started.elapsed()));
        }
        until("the mark", || run.folder.join("marked").exists().then_some(()));
        running.stop_group();
        let ran = running.wait();
        let json = ran.json();
        let books = &json["buses"][0];
        let number = |key: &str| books[key].as_u64().unwrap();
        assert_eq!(number("received"), number("written") + number("dropped"), "{books}");
        assert_eq!(number("received"), sent, "{books}");
        let left: u64 =
            std::fs::read_to_string(run.folder.join("avail")).unwrap().trim().parse().unwrap();
        assert!(left >= 3 << 10, "only {left} KiB were left free");
        let found = run.folder.join("found");
        let numbers: Vec<u32> = files_of(&found);
        assert_eq!(numbers[..2], [1, 2], "the marked one and the one before it: {numbers:?}");
        assert!(numbers[2..].windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
        (sent, number("dropped"), numbers.len(), *numbers.last().unwrap())
    });
    for (sent, dropped, left, last) in results {
        found.number("time", format!("{} s", time.as_secs()));
        found.number("recorded / dropped", format!("{} MiB / {dropped} bytes", sent >> 20));
        found.number("segments at the end, of all", format!("{left} of {last}"));
    }
    found
}

/// The numbers of the segments in a folder, each read strictly.
fn files_of(folder: &Path) -> Vec<u32> {
    let marks = std::fs::read_dir(folder).unwrap().flatten().map(|entry| entry.path());
    for mark in marks.filter(|path| path.extension().is_some_and(|e| e == "keep")) {
        std::fs::remove_file(mark).unwrap();
    }
    let number = |path: &Path| path.to_string_lossy().rsplit('_').nth(1).unwrap().parse().unwrap();
    files(folder).iter().map(|(path, _)| number(path)).collect()
}
