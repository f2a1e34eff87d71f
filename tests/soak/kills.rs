//! A kill at any moment: everything but the last moment can be read, in its order.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use nix::sys::signal::Signal;

use super::feed::{Log, Until, record, talk};
use super::item::{Found, Item, Job, spread};
use super::runs::{Run, runs};
use crate::record::{from_the_beginning, in_order};
use crate::support::mcap::{self, Mcap};
use crate::support::process::{Running, args, bustape, spawn};
use crate::support::{messages, peers};

/// What a kill may cost: the chunk time and half of it again.
const BOUND: Duration = Duration::from_millis(300);

/// Records a second on the line.
const RATE: u64 = 4_000;

/// Moments are within this time.
const LONGEST: usize = 10_000;

pub const ITEM: Item = Item {
    name: "kills",
    promise: "kill -9 at a random moment of 0 to 10 s leaves files that an independent reader reads, \
              in order, with nothing missing but what was said in the last 300 ms and while the recorder waited for a \
              write, a processor or the kernel's terminal (4,000 records/s on a \
              line and a simulated CAN bus; both layouts; every third in segments of 2 s)",
    count: 1_000,
    unit: "kills",
    side_by_side: 8,
    run,
};

/// How often it is looked what the recorder is doing.
const LOOK: Duration = Duration::from_millis(20);

/// What the recorder's threads were doing at one moment.
struct Look {
    at: Instant,
    /// The one that writes was in a call that waits for the disk.
    in_disk: bool,
    /// How long they have waited for a processor so far.
    waited: Duration,
}

/// Looks at a recorder's threads until `stop`.
fn watch(pid: u32, stop: &AtomicBool) -> Vec<Look> {
    let mut looks = Vec::new();
    while !stop.load(Relaxed) {
        looks.extend(look(pid));
        std::thread::sleep(LOOK);
    }
    looks
}

/// Sources: proc(5) for `syscall`, sched-stats.rst of the kernel for `schedstat`.
fn look(pid: u32) -> Option<Look> {
    let disk = [libc::SYS_write, libc::SYS_openat];
    let (mut in_disk, mut waited) = (false, Duration::ZERO);
    for task in std::fs::read_dir(format!("/proc/{pid}/task")).ok()?.flatten() {
        let call = std::fs::read_to_string(task.path().join("syscall")).ok()?;
        let call = call.split(' ').next().and_then(|number| number.parse::<i64>().ok());
        let writes = std::fs::read_to_string(task.path().join("comm")).ok()?.trim() == "writer";
        in_disk |= writes && call.is_some_and(|call| disk.contains(&call));
        let schedule = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        waited += Duration::from_nanos(schedule.split(' ').nth(1)?.parse().ok()?);
    }
    Some(Look { at: Instant::now(), in_disk, waited })
}

/// How long the machine held up the recorder within the last second before `end`: the disk, and others
/// on the processors.
fn kept_waiting(looks: &[Look], end: Instant) -> (Duration, Duration) {
    let from = looks.partition_point(|look| look.at + Duration::from_secs(1) < end);
    let to = looks.partition_point(|look| look.at <= end);
    let near = &looks[from.min(to)..to];
    let disk = near
        .windows(2)
        .filter(|pair| pair[0].in_disk || pair[1].in_disk)
        .map(|pair| pair[1].at - pair[0].at)
        .sum();
    let processor = near
        .last()
        .zip(near.first())
        .map_or(Duration::ZERO, |(last, first)| last.waited - first.waited);
    (disk, processor)
}

/// When a byte was given to a pseudo-terminal, and how long the kernel took to hand it over: it has a worker
/// thread for that, which a busy machine keeps waiting, and what is on its way no recorder can have.
static ON_THE_WAY: Mutex<Vec<(Instant, Duration)>> = Mutex::new(Vec::new());

/// Sends bytes through a pseudo-terminal of its own.
fn probe(stop: &AtomicBool) {
    let pty = bustape::sys::pty::Pty::new().expect("a pseudo-terminal");
    let mut line = terminal(pty.path(), stop).expect("the other side");
    let mut byte = [0];
    while !stop.load(Relaxed) {
        let sent = Instant::now();
        line.write_all(b"x").expect("a byte");
        while pty.read(&mut byte).is_err() {
            std::thread::sleep(Duration::from_millis(1));
        }
        ON_THE_WAY.lock().unwrap().push((sent, sent.elapsed()));
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The longest that a byte was on its way within a second before `end`.
fn on_the_way(end: Instant) -> Duration {
    let all = ON_THE_WAY.lock().unwrap();
    let near =
        all.iter().rev().take_while(|(sent, took)| *sent + *took + Duration::from_secs(1) >= end);
    near.filter(|(sent, _)| *sent <= end).map(|(_, took)| *took).max().unwrap_or_default()
}

/// What one kill has cost.
struct Killed {
    kept: (Duration, Duration),
    terminal: Duration,
    loss: Duration,
    held_up: Duration,
    frames: usize,
    torn: bool,
}

fn run(job: &Job) -> Found {
    let stop = AtomicBool::new(false);
    let (mut found, killed) = std::thread::scope(|scope| {
        let _until = Until(&stop);
        scope.spawn(|| probe(&stop));
        runs(job, one)
    });
    let late: Vec<String> = killed
        .iter()
        .filter(|k| k.loss > BOUND)
        .map(|k| {
            format!(
                "{:.0} ms: disk {:.0}, processor {:.0}, kernel's terminal {:.0}",
                ms(k.loss),
                ms(k.kept.0),
                ms(k.kept.1),
                ms(k.terminal)
            )
        })
        .collect();
    found.number(
        "losses above 300 ms, and how long the recorder waited for what in the last second",
        format!("{} ({})", late.len(), late.join("; ")),
    );
    let mut losses: Vec<f64> = killed.iter().map(|k| k.loss.as_secs_f64() * 1e3).collect();
    let (p50, max) = spread(&mut losses, 0.5);
    let (p99, _) = spread(&mut losses, 0.99);
    let held_up = killed.iter().map(|k| k.held_up).max().unwrap_or_default();
    let recorded = killed.iter().filter(|k| k.frames > 0).count();
    let torn = killed.iter().filter(|k| k.torn).count();
    found.number("loss, p50 / p99 / max", format!("{p50:.0} / {p99:.0} / {max:.0} ms"));
    found.number("killed before the first frame was in the file", killed.len() - recorded);
    found.number("files that end inside a record", torn);
    found.number("longest that the machine held up the sender", format!("{held_up:.0?}"));
    found
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Starts the program under test.
pub fn start(program: &Path, arguments: Vec<std::ffi::OsString>) -> Running {
    let mut command = std::process::Command::new(program);
    command.args(arguments);
    spawn(command)
}

/// Opens a recorder's terminal; `None` when `stop` comes before there is one.
pub fn terminal(path: &Path, stop: &AtomicBool) -> Option<std::fs::File> {
    use std::os::unix::fs::OpenOptionsExt as _;
    let mut options = std::fs::OpenOptions::new();
    options.read(true).write(true).custom_flags(libc::O_NOCTTY);
    while !stop.load(Relaxed) {
        match options.open(path) {
            Ok(line) => return Some(line),
            Err(_) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    None
}

fn one(mut run: Run<'_>) -> Killed {
    let (tty, out) = (run.folder.join("tty"), run.folder.join("out"));
    std::fs::create_dir(&out).unwrap();
    let layout = ["frame", "batch"][(run.number % 2) as usize];
    let line = format!("line=pty:{}", tty.display());
    let mut options = args(&[&"record", &line, &"sim:hmi-can", &"--layout", &layout]);
    if run.number.is_multiple_of(3) {
        options.extend(args(&[&"-d", &out, &"--split-time", &"2s"]));
    } else {
        options.extend(args(&[&"-o", &out.join("a.mcap")]));
    }
    let moment = Duration::from_millis(run.random.below(LONGEST) as u64);
    let stop = AtomicBool::new(false);
    let running = start(run.bustape, options);
    let pid = running.pid();
    let (log, end, kept) = std::thread::scope(|scope| {
        let _until = Until(&stop);
        let talking = scope.spawn(|| {
            terminal(&tty, &stop).map_or_else(Log::default, |mut line| talk(&mut line, RATE, &stop))
        });
        let watching = scope.spawn(|| watch(pid, &stop));
        std::thread::sleep(moment);
        let end = Instant::now();
        running.kill();
        stop.store(true, Relaxed);
        let looks = watching.join().expect("the watcher goes on");
        (talking.join().expect("the sender goes on"), end, kept_waiting(&looks, end))
    });
    check(&run, &out, &log, end, kept)
}

fn check(
    run: &Run<'_>,
    out: &Path,
    log: &Log,
    end: Instant,
    waited: (Duration, Duration),
) -> Killed {
    let files = files(out);
    let mut kept = Vec::new();
    let mut frames = Vec::new();
    let mut torn = false;
    for (number, (path, file)) in files.iter().enumerate() {
        let is_part = path.extension().is_some_and(|ending| ending == "part");
        // One before the last may wait for its name, but then its end is written.
        let is_last = number + 1 == files.len();
        assert!(!is_part || is_last || has_summary(file), "{} is not the last", path.display());
        torn |= file.end < file.size;
        if file.messages.is_empty() {
            continue;
        }
        in_order(file, has_summary(file));
        kept.extend(messages::streams(file, "line").0);
        frames.extend(messages::cans(file, "hmi-can"));
    }
    // The last write may have been taken in part.
    let said: Vec<u8> = (0..kept.len() as u64).flat_map(record).take(kept.len()).collect();
    assert!(kept == said, "not what was said, or not in its order");
    if let Some((_, file)) = files.first() {
        from_the_beginning(file, &frames);
    }
    if run.number.is_multiple_of(20) {
        as_others_read(&files);
    }
    if let Some((path, file)) = files.last().filter(|_| run.number.is_multiple_of(7)) {
        recovers(path, file);
    }
    let loss = log.lost(kept.len(), end);
    let what = kept.len();
    if loss > BOUND {
        // What is on its way is known when it has arrived.
        std::thread::sleep(Duration::from_secs(2));
    }
    let terminal = on_the_way(end);
    assert!(
        loss <= BOUND + waited.0 + waited.1 + terminal,
        "{loss:?} are missing; the sender was held up by {:?}, the recorder by {waited:?}, the terminal by {terminal:?}; \
         {what} bytes are there",
        log.held_up
    );
    Killed { kept: waited, terminal, loss, held_up: log.held_up, frames: frames.len(), torn }
}

/// True if its end is written; a file can be killed between that and getting its name.
pub fn has_summary(file: &Mcap) -> bool {
    file.metadata.iter().any(|(name, _)| name == "bustape.summary")
}

/// The files in a folder by their names, read strictly: finished ones to their end.
pub fn files(folder: &Path) -> Vec<(PathBuf, Mcap)> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = entries.collect();
    paths.sort();
    let mut files: Vec<(PathBuf, Mcap)> = Vec::new();
    for path in paths {
        let text = path.to_string_lossy();
        if let Some(finished) = text.strip_suffix(".part")
            && Path::new(finished).exists()
        {
            // Killed between the two steps of giving it its name: both names lead to one file.
            assert!(bustape::recording::disk::is_same(&path, Path::new(finished)), "{text}");
            continue;
        }
        let file = match text.ends_with(".mcap") {
            true => mcap::finished(&path),
            false => mcap::cut(&path),
        };
        files.push((path, file));
    }
    files
}

/// The Python library finds as many messages.
fn as_others_read(files: &[(PathBuf, Mcap)]) {
    for (path, file) in files.iter().filter(|(_, file)| !file.messages.is_empty()) {
        let python = peers::python_streams(path);
        for channel in file.channels.values() {
            let ours = file.on(&channel.topic).count() as u64;
            assert_eq!(python.count(&channel.topic), ours, "{} by Python", channel.topic);
        }
    }
}

/// `bustape recover` keeps all that can be read and leaves the original as it is.
pub fn recovers(path: &Path, file: &Mcap) {
    if file.messages.is_empty() {
        return;
    }
    let copy = path.with_extension("recovered");
    let before = std::fs::read(path).unwrap();
    let ran = bustape(args(&[&"recover", &path, &"-o", &copy]));
    let ran = ran.expect(if file.end < file.size { 3 } else { 0 });
    assert_eq!(mcap::finished(&copy).messages, file.messages, "{}", ran.err);
    assert!(std::fs::read(path).unwrap() == before, "the original was touched");
}

/// How a recorder was told to end.
pub fn stop_by(running: Running, signal: Signal) -> crate::support::process::Ran {
    running.signal(signal);
    running.wait()
}
