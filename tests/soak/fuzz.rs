//! Edited files by the million, each read by a process of its own with little memory.
//!
//! A worker is this program again: it makes an edit, forks, and the child runs a command of the library
//! as `bustape` does. Forking costs a third of a millisecond where starting a program costs ten, and
//! nothing that a command leaves behind (threads, memory, a broken heap) reaches the next file.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::AsRawFd as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use clap::{CommandFactory as _, FromArgMatches as _};
use serde_json::{Value, json};

use super::hostile;
use super::item::{Found, Item, Job};
use super::runs::runs;
use crate::support::bytes::Random;

/// Address space of a reader.
const MEMORY: u64 = 1 << 30;
/// Resident memory a reader may take, KiB: what `src/recording/limits.rs` promises.
const RESIDENT: i64 = 300 << 10;
/// Processor time a reader may take for such a small file, milliseconds.
const SLOW: u128 = 1_000;
/// Edits of one worker process.
const BLOCK: u64 = 2_000;
/// Seconds after which a reader is taken to hang.
const HANGS: u32 = 60;

/// What `fork` in a loop takes apart.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Recordings,
    Cuts,
    Definitions,
}

impl Kind {
    const ALL: [(Self, &'static str); 3] = [
        (Self::Recordings, "recordings"),
        (Self::Cuts, "cuts"),
        (Self::Definitions, "definitions"),
    ];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(kind, _)| *kind == self).map_or("", |(_, name)| name)
    }
}

pub const RECORDINGS: Item = Item {
    name: "edits",
    promise: "recordings with 1 to 4 random edits, read by info, cat, convert, decode, recover, retime, export and \
              replay with 1 GiB of address space: no panic, no abort, no hang, no control character in what \
              is printed",
    count: 1_000_000,
    unit: "files",
    side_by_side: 2,
    run: |job| fuzz(job, Kind::Recordings),
};

pub const CUTS: Item = Item {
    name: "cuts",
    promise: "recordings cut off at every byte, read by the same commands: as with edited ones",
    // More than there are bytes in them.
    count: 500_000,
    unit: "files",
    side_by_side: 2,
    run: |job| fuzz(job, Kind::Cuts),
};

pub const DEFINITIONS: Item = Item {
    name: "definitions",
    promise: "DBC files and protocol definitions with 1 to 4 random edits, checked, shown and decoded with: no \
              panic, no abort, no hang, no control character in what is printed",
    count: 100_000,
    unit: "files",
    side_by_side: 2,
    run: |job| fuzz(job, Kind::Definitions),
};

fn fuzz(job: &Job, kind: Kind) -> Found {
    let originals = job.folder.join("originals");
    std::fs::create_dir_all(&originals).expect("a folder");
    hostile::originals(kind, &originals, &job.bustape);
    let all = match kind {
        Kind::Cuts => Some(hostile::read(&originals).iter().map(|(_, b)| b.len() as u64).sum()),
        Kind::Recordings | Kind::Definitions => None,
    };
    let count = job.count.min(all.unwrap_or(u64::MAX));
    let blocks = Job {
        count: count.div_ceil(BLOCK),
        folder: job.folder.clone(),
        bustape: job.bustape.clone(),
        ..*job
    };
    let (mut found, results) = runs(&blocks, |run| {
        let first = run.number * BLOCK;
        // In memory: a million small files would only wear the disk.
        let place = Path::new("/dev/shm");
        let folder = tempfile::tempdir_in(place).expect("/dev/shm");
        let mut command = Command::new(std::env::current_exe().expect("this program has a path"));
        command.args([WORKER, kind.name(), &job.seed.to_string(), &first.to_string()]);
        command.arg(BLOCK.min(count - first).to_string()).arg(&originals).arg(folder.path());
        let output = command.stderr(Stdio::piped()).output().expect("it starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "block {first}: {} {said}", output.status);
        // What was broken, and where it is kept: at once, for the series may be long.
        eprint!("{said}");
        serde_json::from_slice::<Value>(&output.stdout).unwrap_or_else(|e| panic!("{e}: {said}"))
    });
    found.all = all;
    found.done = results.iter().map(|r| r["done"].as_u64().unwrap()).sum();
    let most = |key: &str| results.iter().filter_map(|r| r[key].as_u64()).max().unwrap_or(0);
    let sum = |code: &str| results.iter().filter_map(|r| r["exits"][code].as_u64()).sum::<u64>();
    let exits: Vec<String> =
        ["0", "1", "2", "3"].iter().map(|c| format!("{} with {c}", sum(c))).collect();
    found.number("exit statuses", exits.join(", "));
    found.number("most resident memory of a reader", format!("{} MiB", most("resident") >> 10));
    found.number("most processor time of a reader", format!("{} ms", most("slowest")));
    let broken: Vec<&str> = results
        .iter()
        .flat_map(|r| r["broken"].as_array().unwrap())
        .filter_map(Value::as_str)
        .collect();
    found.number("panics, aborts, hangs and the like", broken.len());
    found.violations.extend(broken.iter().take(20).map(|text| (*text).to_owned()));
    std::fs::remove_dir_all(&originals).ok();
    found
}

const WORKER: &str = "--fuzz-worker";

/// Does a worker's work, if this process is one.
pub fn child() -> Option<ExitCode> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [first, kind, seed, from, count, originals, folder] = &args[..] else { return None };
    if first != WORKER {
        return None;
    }
    let kind = Kind::ALL.iter().find(|(_, name)| name == kind)?.0;
    let worker = Worker {
        kind,
        seed: seed.parse().expect("a seed"),
        originals: hostile::read(Path::new(originals)),
        folder: folder.into(),
        commands: hostile::commands(kind, Path::new(folder)),
    };
    let result = worker.work(from.parse().expect("a number"), count.parse().expect("a number"));
    println!("{result}");
    Some(ExitCode::SUCCESS)
}

struct Worker {
    kind: Kind,
    seed: u64,
    originals: Vec<(String, Vec<u8>)>,
    folder: PathBuf,
    commands: Vec<Vec<String>>,
}

/// How a reader ended.
struct Ended {
    status: libc::c_int,
    resident: i64,
    millis: u128,
    said: Vec<u8>,
    printed: Vec<u8>,
}

impl Worker {
    fn work(&self, from: u64, count: u64) -> Value {
        limit_memory();
        if self.kind == Kind::Definitions {
            // Definitions name the files beside them.
            for (name, bytes) in &self.originals {
                std::fs::write(self.folder.join(name), bytes).expect("room in memory");
            }
        }
        let matches: Vec<clap::ArgMatches> = self
            .commands
            .iter()
            .map(|line| {
                bustape::cli::Cli::command().try_get_matches_from(line).expect("a command line")
            })
            .collect();
        let mut exits = [0_u64; 256];
        let (mut resident, mut slowest, mut broken) = (0, 0, Vec::new());
        for edit in from..from + count {
            let mut random = Random::new(self.seed << 32 | edit);
            let (name, bytes) = self.make(edit, &mut random);
            std::fs::write(self.folder.join(name), &bytes).expect("room in memory");
            let which = loop {
                let which = random.below(matches.len());
                if self.commands[which].iter().any(|word| word.contains(name)) {
                    break which;
                }
            };
            let ended = self.reader(&matches[which]);
            resident = resident.max(ended.resident);
            slowest = slowest.max(ended.millis);
            exits[usize::from(libc::WEXITSTATUS(ended.status) as u8)] += 1;
            if let Some(why) = fault(&ended) {
                let kept = std::env::temp_dir().join(format!("soak-{}-{edit}", self.kind.name()));
                std::fs::copy(self.folder.join(name), &kept).ok();
                let line = self.commands[which][1..].join(" ");
                let why = format!("seed {} edit {edit}, {line}: {why}", self.seed);
                eprintln!("  BROKEN (kept in {}): {why}", kept.display());
                broken.push(why);
            }
            self.tidy(name);
        }
        let exits = exits.iter().enumerate().filter(|(_, n)| **n > 0);
        let exits: serde_json::Map<String, Value> =
            exits.map(|(code, n)| (code.to_string(), json!(n))).collect();
        json!({ "done": count, "exits": exits, "resident": resident, "slowest": slowest as u64, "broken": broken })
    }

    /// What is to be read, and under which name.
    fn make(&self, edit: u64, random: &mut Random) -> (&'static str, Vec<u8>) {
        if self.kind == Kind::Cuts {
            let mut at = edit as usize;
            for (_, bytes) in &self.originals {
                if at < bytes.len() {
                    return (hostile::RECORDING, bytes[..at].to_vec());
                }
                at -= bytes.len();
            }
            unreachable!("as many edits as bytes");
        }
        let (name, bytes) = &self.originals[random.below(self.originals.len())];
        hostile::edited(name, bytes, random)
    }

    /// Runs a command in a process of its own.
    fn reader(&self, matches: &clap::ArgMatches) -> Ended {
        let [out, err] = ["stdout", "stderr"].map(|name| self.folder.join(name));
        let [out_file, err_file] =
            [&out, &err].map(|path| File::create(path).expect("room in memory"));
        let cli = bustape::cli::Cli::from_arg_matches(matches).expect("understood before");
        // SAFETY: this process has one thread, so its child may do what any process may.
        let child = unsafe { libc::fork() };
        assert!(child >= 0, "no more processes");
        if child == 0 {
            // SAFETY: plain system calls on descriptors that are open.
            unsafe {
                libc::dup2(out_file.as_raw_fd(), 1);
                libc::dup2(err_file.as_raw_fd(), 2);
                libc::alarm(HANGS);
            }
            let command = std::panic::AssertUnwindSafe(|| bustape::commands::run(&cli, matches));
            let code = std::panic::catch_unwind(command).unwrap_or(101);
            std::io::stdout().flush().ok();
            // SAFETY: ends this process without what was registered for the end of the worker.
            unsafe { libc::_exit(code.into()) }
        }
        let (mut status, mut usage) = (0, std::mem::MaybeUninit::<libc::rusage>::zeroed());
        // SAFETY: both places are ours, and the child is ours.
        let waited = unsafe { libc::wait4(child, &raw mut status, 0, usage.as_mut_ptr()) };
        assert_eq!(waited, child);
        // SAFETY: zero is a valid value of every field, and wait4 has filled it in.
        let usage = unsafe { usage.assume_init() };
        let millis = |t: libc::timeval| t.tv_sec as u128 * 1000 + t.tv_usec as u128 / 1000;
        Ended {
            status,
            resident: usage.ru_maxrss,
            millis: millis(usage.ru_utime) + millis(usage.ru_stime),
            said: std::fs::read(&err).unwrap_or_default(),
            printed: std::fs::read(&out).unwrap_or_default(),
        }
    }

    /// Removes everything the reader has made.
    fn tidy(&self, name: &str) {
        for entry in std::fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let ours = |n: &str| path.file_name().is_some_and(|f| f == n);
            let original = self.originals.iter().any(|(name, _)| ours(name));
            if ours("stdout") || ours("stderr") || ours(name) || original {
                continue;
            }
            if path.is_dir() {
                std::fs::remove_dir_all(path).ok();
            } else {
                std::fs::remove_file(path).ok();
            }
        }
    }
}

/// What was wrong with how a reader ended.
fn fault(ended: &Ended) -> Option<String> {
    let said = String::from_utf8_lossy(&ended.said);
    let end =
        || said.chars().rev().take(400).collect::<Vec<_>>().into_iter().rev().collect::<String>();
    if libc::WIFSIGNALED(ended.status) {
        return Some(format!("killed by signal {}: {}", libc::WTERMSIG(ended.status), end()));
    }
    let code = libc::WEXITSTATUS(ended.status);
    if said.contains("panicked") || code == 101 {
        return Some(format!("panic: {}", end()));
    }
    if !matches!(code, 0..=3) || (code != 0 && said.is_empty() && ended.printed.is_empty()) {
        return Some(format!("exit status {code}: {}", end()));
    }
    if ended.resident > RESIDENT {
        return Some(format!("took {} MiB", ended.resident >> 10));
    }
    if ended.millis > SLOW {
        return Some(format!("took {} ms", ended.millis));
    }
    let printed = String::from_utf8_lossy(&ended.printed);
    let control = |text: &str| text.chars().find(|c| c.is_control() && *c != '\n');
    if let Some(found) = control(&printed).or(control(&said)) {
        return Some(format!("prints the control character {found:?}"));
    }
    None
}

fn limit_memory() {
    let limit = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
    // SAFETY: a plain system call with a structure of ours.
    let set = unsafe { libc::setrlimit(libc::RLIMIT_AS, &raw const limit) };
    assert_eq!(set, 0, "no limit can be set");
    // What a reader that dies leaves behind are the files, not a core.
    let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: as above.
    unsafe { libc::setrlimit(libc::RLIMIT_CORE, &raw const none) };
}
