//! The power goes while a machine records: on ext4 and on vfat.
//!
//! An emulated machine records onto a disk of its own, and QEMU keeps each write and each flush of that disk
//! in a log, in their order. From the log follows what the disk may hold at any moment: everything that
//! was flushed, and of what was written since then anything, since a disk with a cache of its own may write it
//! in any order or not at all. So one recording gives as many power cuts as are wanted, harder ones than
//! killing the machine does, which loses nothing that has reached its disk's cache. A few machines
//! are killed in truth as well, to see that both agree.

use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use super::calls::next_start;
use super::disklog::Log;
use super::feed::{RECORD, record};
use super::item::{Found, Item, Job, spread};
use super::runs::{Run, runs};
use crate::record::from_the_beginning;
use crate::support::bytes::Random;
use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{args, spawn};

/// What a power cut may cost: the sync time and half of it again.
const BOUND: Duration = Duration::from_millis(1500);
/// Size of the disk.
const DISK: u64 = 64 << 20;
/// True kills on each file system.
const KILLS: u64 = 5;

pub const EXT4: Item = Item {
    name: "power-ext4",
    promise: "a power cut at any moment, on ext4, segments of 3 s, sync of 1 s: all finished segments are whole, the \
              open one readable and recoverable, nothing missing but what was said in the last 1.5 s",
    count: 100,
    unit: "power cuts",
    side_by_side: 1,
    run: |job| run(job, "ext4", &["mkfs.ext4", "-q", "-F"]),
};

pub const VFAT: Item = Item {
    name: "power-vfat",
    promise: "the same on vfat, checked by fsck.fat before it is read",
    count: 100,
    unit: "power cuts",
    side_by_side: 1,
    run: |job| run(job, "vfat", &["mkfs.vfat"]),
};

fn run(job: &Job, name: &str, make: &[&str]) -> Found {
    let time = job.duration.unwrap_or(Duration::from_secs(100));
    // In memory: how long this machine's own disk takes for a flush must not matter.
    let folder = tempfile::tempdir_in("/dev/shm").expect("/dev/shm").keep();
    let job = &Job { folder, bustape: job.bustape.clone(), ..*job };
    let machine = Machine::start(&job.folder, name, make, &job.bustape);
    let said = machine.run(time);
    let log = Log::read(&job.folder.join("log")).expect("the log of the disk");
    let cuts = cuts(&log, &said, job.count, job.seed);
    let (mut found, mut losses) = checked(job, name, &log, cuts, &said);
    found.number("writes and flushes in the log", log.entries.len());
    let (p50, max) = spread(&mut losses, 0.5);
    found.number("loss, p50 / max", format!("{p50:.2} / {max:.2} s"));
    let kills = Job {
        count: KILLS.min(job.count),
        folder: job.folder.join("kills"),
        bustape: job.bustape.clone(),
        ..*job
    };
    let (more, losses) = runs(&kills, |run| killed(run, name, make));
    found.violations.extend(more.violations);
    let losses: Vec<String> = losses.iter().map(|loss| format!("{loss:.2}")).collect();
    found.number("true kills of the machine, loss", format!("{} s", losses.join(", ")));
    if found.violations.is_empty() {
        std::fs::remove_dir_all(&job.folder).ok();
    }
    found
}

/// What the machine has said, and when its disk had how much in its log.
struct Said {
    /// When the word came that so many records were sent.
    records: Vec<(Instant, u64)>,
    /// When the log had grown to so many bytes.
    log: Vec<(Instant, u64)>,
}

impl Said {
    /// Writes it down for whoever looks for what was wrong: milliseconds, what, how much.
    fn keep(&self, path: &Path) {
        let start = self.log.first().map_or_else(Instant::now, |(at, _)| *at);
        let line = |what: &str, (at, value): &(Instant, u64)| {
            format!("{} {what} {value}\n", at.saturating_duration_since(start).as_millis())
        };
        let records = self.records.iter().map(|entry| line("records", entry));
        let text: String = self.log.iter().map(|entry| line("log", entry)).chain(records).collect();
        std::fs::write(path, text).expect("room");
    }

    /// When byte `offset` of the log was there.
    fn when(&self, offset: u64) -> Option<Instant> {
        self.log.iter().find(|(_, length)| *length > offset).map(|(at, _)| *at)
    }

    /// How long before `end` the first record was sent that is not among the first `kept`.
    fn lost(&self, kept: u64, end: Instant) -> f64 {
        let missing = self.records.iter().find(|(at, records)| *records > kept && *at <= end);
        missing.map_or(0.0, |(at, _)| (end - *at).as_secs_f64())
    }
}

/// An emulated machine that records onto a disk.
struct Machine {
    child: Child,
    folder: PathBuf,
}

impl Machine {
    fn start(folder: &Path, system: &str, make: &[&str], program: &Path) -> Self {
        let disk = folder.join("disk");
        File::create(&disk).and_then(|file| file.set_len(DISK)).expect("room for a disk");
        spawn(command(make, &[&disk])).wait().expect(0);
        std::fs::copy(&disk, folder.join("base")).expect("room for a disk");
        let lab = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/lab/vcan-run");
        let own = std::env::current_exe().expect("this program has a path");
        let mut lab = Command::new(lab);
        lab.args(["--timeout", "3600", "--disk"])
            .arg(&disk)
            .arg("--disk-log")
            .arg(folder.join("log"));
        lab.arg("--pid-file").arg(folder.join("pid")).arg("--").arg(own);
        lab.args([super::guest::GUEST, "power", system]).arg(program);
        let errors = File::create(folder.join("errors")).expect("a file");
        let child = lab
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(errors)
            .spawn()
            .expect("it starts");
        Self { child, folder: folder.to_owned() }
    }

    /// Lets it record for `time`, then ends it at once.
    fn run(mut self, time: Duration) -> Said {
        let out = BufReader::new(self.child.stdout.take().expect("piped"));
        let records = Mutex::new(Vec::new());
        let mut log = Vec::new();
        std::thread::scope(|scope| {
            let reading = scope.spawn(|| {
                for line in out.lines().map_while(Result::ok) {
                    let number = line.trim().parse::<u64>();
                    number
                        .into_iter()
                        .for_each(|n| records.lock().unwrap().push((Instant::now(), n)));
                }
            });
            let log_file = self.folder.join("log");
            let (patience, mut end) = (Instant::now() + Duration::from_secs(300), None);
            while end.is_none_or(|end| Instant::now() < end) {
                if end.is_none() && !records.lock().unwrap().is_empty() {
                    end = Some(Instant::now() + time);
                }
                let length = log_file.metadata().map_or(0, |about| about.len());
                if log.last().is_none_or(|(_, last)| *last < length) {
                    log.push((Instant::now(), length));
                }
                std::thread::sleep(Duration::from_millis(2));
                let errors =
                    || std::fs::read_to_string(self.folder.join("errors")).unwrap_or_default();
                assert!(end.is_some() || Instant::now() < patience, "no machine: {}", errors());
                let ended = self.child.try_wait().expect("it is ours");
                assert!(ended.is_none(), "the machine ended: {ended:?} {}", errors());
            }
            let pid = std::fs::read_to_string(self.folder.join("pid")).expect("a process");
            let pid = pid.trim().parse().expect("a process");
            nix::sys::signal::kill(
                nix::unistd::Pid::from_raw(pid),
                nix::sys::signal::Signal::SIGKILL,
            )
            .expect("it is ours");
            self.child.wait().expect("it is ours");
            reading.join().expect("a reader");
        });
        let said = Said { records: records.into_inner().unwrap(), log };
        said.keep(&self.folder.join("times"));
        said
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // Its script ends the machine with itself.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

fn command(words: &[&str], paths: &[&Path]) -> Command {
    let mut command = Command::new(words[0]);
    command.args(&words[1..]).args(paths);
    // Where a person's PATH has no /sbin.
    let path = std::env::var("PATH").unwrap_or_default();
    command.env("PATH", format!("{path}:/usr/sbin:/sbin"));
    command
}

/// One power cut.
struct Cut {
    /// So many entries of the log were handed to the disk.
    entries: usize,
    /// The last moment before the next one.
    end: Instant,
    random: Random,
}

/// Cuts at random moments, in their order.
fn cuts(log: &Log, said: &Said, count: u64, seed: u64) -> Vec<Cut> {
    let mut random = Random::new(seed);
    let begin = said.records.first().expect("records").0;
    let first =
        log.entries.iter().position(|entry| said.when(entry.offset).is_some_and(|at| at > begin));
    let first = first.expect("something written");
    let last = log.entries.len() - 1;
    let mut places: Vec<usize> = (0..count).map(|_| first + random.below(last - first)).collect();
    places.sort_unstable();
    let cut = |(number, entries): (usize, usize)| {
        let end = said.when(log.entries[entries].offset)?;
        Some(Cut { entries, end, random: Random::new(seed << 32 | number as u64) })
    };
    places.into_iter().enumerate().filter_map(cut).collect()
}

/// Checks each cut. Returns the losses in seconds.
fn checked(job: &Job, system: &str, log: &Log, cuts: Vec<Cut>, said: &Said) -> (Found, Vec<f64>) {
    let base = job.folder.join("base");
    let disk = File::options().read(true).write(true).open(&base).expect("the empty disk");
    let cuts = Mutex::new((0_usize, cuts.into_iter()));
    let count = cuts.lock().unwrap().1.len() as u64;
    let one = Job {
        count,
        side_by_side: 1,
        folder: job.folder.join("cuts"),
        bustape: job.bustape.clone(),
        ..*job
    };
    runs(&one, |run| {
        let (image, cut) = {
            let mut state = cuts.lock().unwrap();
            let mut cut = state.1.next().expect("as many as runs");
            let durable = log.durable(cut.entries);
            for entry in &log.entries[state.0..durable] {
                log.apply(entry, entry.length, &disk);
            }
            state.0 = durable.max(state.0);
            let image = run.folder.join("disk");
            std::fs::copy(&base, &image).expect("room for a disk");
            unflushed(log, durable, &mut cut, &image);
            (image, cut)
        };
        let kept = check(&run, &image, system);
        let loss = said.lost(kept, cut.end);
        let Cut { entries, .. } = cut;
        assert!(
            loss <= BOUND.as_secs_f64(),
            "{loss:.2} s are missing, cut before entry {entries} of the log"
        );
        loss
    })
}

/// What was handed to the disk but not flushed: all of it, none, or some, perhaps in halves.
fn unflushed(log: &Log, durable: usize, cut: &mut Cut, image: &Path) {
    let disk = File::options().write(true).open(image).expect("the copy");
    let how = cut.random.below(3);
    for entry in &log.entries[durable.min(cut.entries)..cut.entries] {
        let some = [entry.length, 0, if cut.random.below(2) == 0 { 0 } else { entry.length }][how];
        // A write of several sectors may end after any of them.
        let torn = how == 2 && cut.random.below(8) == 0;
        let sectors = some / 512;
        let length = if torn && sectors > 1 {
            512 * cut.random.below(sectors as usize) as u64
        } else {
            some
        };
        log.apply(entry, if entry.is_forced() { entry.length } else { length }, &disk);
    }
}

/// Records that are in the files on a disk.
fn check(run: &Run<'_>, image: &Path, system: &str) -> u64 {
    let out = run.folder.join("files");
    std::fs::create_dir(&out).unwrap();
    taken_out(image, system, run.folder, &out);
    let (mut kept, mut frames, mut first) = (Vec::new(), Vec::new(), None);
    for file in files_of(&out) {
        if !file.messages.is_empty() {
            kept.extend(messages::streams(&file, "line").0);
            frames.extend(messages::cans(&file, "hmi-can"));
            first.get_or_insert(file);
        }
    }
    next_start(run.bustape, &out);
    let again =
        files_of(&out).iter().map(|file| messages::streams(file, "line").0).collect::<Vec<_>>();
    assert!(again.concat() == kept, "the next start keeps less than could be read");
    if let Some(file) = &first {
        from_the_beginning(file, &frames);
    }
    let records = (kept.len() / RECORD) as u64;
    let expected: Vec<u8> = (0..=records).flat_map(record).take(kept.len()).collect();
    assert!(kept == expected, "not what was sent, or not in its order");
    records
}

/// An unfinished file up to where it is whole. A power cut may leave anything behind that, and in a file
/// whose head was not flushed yet anything at all: no frame is in it before that.
fn unfinished(path: &Path) -> Mcap {
    let bytes = std::fs::read(path).unwrap();
    if bytes.len() < 4096 && !bytes.starts_with(b"\x89MCAP0\r\n") {
        return Mcap::default();
    }
    match mcap::parse(&bytes, false) {
        Ok(file) => file,
        Err(why) => {
            let at = why
                .split(" at ")
                .nth(1)
                .and_then(|rest| rest.split(':').next()?.parse::<usize>().ok());
            let at = at.unwrap_or_else(|| panic!("{}: {why}", path.display()));
            mcap::parse(&bytes[..at], false)
                .unwrap_or_else(|why| panic!("{}: {why}", path.display()))
        }
    }
}

/// The files of the first recording in a folder, in their order. All but the last have their name.
fn files_of(out: &Path) -> Vec<Mcap> {
    let entries = std::fs::read_dir(out).unwrap().flatten().map(|entry| entry.path());
    let mut paths: Vec<PathBuf> = entries.collect();
    paths.retain(|path| {
        let name = path.to_string_lossy();
        name.contains("_s0001_") && !name.contains(".damaged")
    });
    paths.sort();
    // Between both names on vfat: the check of the disk leaves one of them empty.
    let is_twin = |path: &PathBuf| {
        let part = path.with_extension("mcap.part");
        path.extension().is_some_and(|e| e == "mcap")
            && part.exists()
            && path.metadata().unwrap().len() == 0
    };
    paths.retain(|path| !is_twin(path));
    let last = paths.len().saturating_sub(1);
    let read = |(number, path): (usize, &PathBuf)| {
        if path.extension().is_some_and(|e| e == "mcap") {
            return mcap::finished(path);
        }
        assert!(number == last, "{} is not the last", path.display());
        unfinished(path)
    };
    paths.iter().enumerate().map(read).collect()
}

/// Copies the files off a disk, as a machine does that is switched on again: the journal is replayed on ext4,
/// vfat is checked first.
fn taken_out(image: &Path, system: &str, folder: &Path, out: &Path) {
    if system == "vfat" {
        let fsck = spawn(command(&["fsck.fat", "-a", "-w"], &[image])).wait();
        assert!(matches!(fsck.status.code(), Some(0 | 1)), "{fsck:?}");
        let mut copy = command(&["mcopy", "-s", "-n", "-i"], &[image]);
        copy.arg("::rec/*").arg(out);
        let copied = spawn(copy).wait();
        // Cut before there was a file.
        let empty = copied.err.contains("\"::rec/*\" not found");
        assert!(copied.status.success() || empty, "{copied:?}");
        return;
    }
    let mount = folder.join("mount");
    std::fs::create_dir(&mount).unwrap();
    let script = "mount -o loop \"$1\" \"$2\" && cp -r \"$2\"/rec/. \"$3\"/ ; umount \"$2\"";
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", script, "sh"]).arg(image).arg(&mount).arg(out);
    let ran = spawn(command).wait();
    assert!(ran.status.success() && ran.err.is_empty(), "{ran:?}");
}

/// The machine itself is killed, and its disk looked at. Returns the loss in seconds.
fn killed(mut run: Run<'_>, system: &str, make: &[&str]) -> f64 {
    let machine = Machine::start(run.folder, system, make, run.bustape);
    let time = Duration::from_millis(2_000 + run.random.below(8_000) as u64);
    let said = machine.run(time);
    let end = said.records.last().expect("records").0;
    let kept = check(&run, &run.folder.join("disk"), system);
    let loss = said.lost(kept, end);
    assert!(loss <= BOUND.as_secs_f64(), "{loss:.2} s are missing");
    loss
}

/// In the machine: records onto its disk, and says how many records it has sent.
pub fn in_guest(system: &str, program: &Path) {
    use std::io::Write as _;
    let disk = Path::new("/run/disk");
    std::fs::create_dir_all(disk).unwrap();
    spawn(command(&["mount", "-t", system, "/dev/vda"], &[disk])).wait().expect(0);
    let out = disk.join("rec");
    std::fs::create_dir(&out).unwrap();
    spawn(Command::new("sync")).wait().expect(0);
    let tty = Path::new("/run/tty");
    let options = args(&[
        &"record",
        &"line=pty:/run/tty",
        &"sim:hmi-can",
        &"-d",
        &out,
        &"--split-time",
        &"3s",
        &"--min-free",
        &"1MiB",
    ]);
    let _running = super::kills::start(program, options);
    let mut line = crate::support::terminal::open(tty);
    let (mut number, started) = (0, Instant::now());
    loop {
        let due = started.elapsed().as_millis() as u64 / 5;
        if due > number {
            let records: Vec<u8> = (number..due).flat_map(record).collect();
            line.write_all(&records).expect("the recorder goes on");
            number = due;
            println!("{number}");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}
