//! Each system call in its turn: killed in it, or failed by it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

use super::feed::{Until, talk};
use super::item::{Found, Item, Job};
use super::kills::{files, has_summary, start, terminal};
use super::runs::{Run, runs};
use crate::disk::books;
use crate::record::{from_the_beginning, in_order};
use crate::support::mcap::{self, Mcap};
use crate::support::process::{Ran, Running, args, spawn};
use crate::support::{messages, peers, until};

/// A kill in each of the first calls of each kind.
pub const KILLED: Item = Item {
    name: "calls",
    promise: "a kill in any of the first 300 calls of write, fdatasync, openat, linkat, unlink and rename \
              leaves files that can be read, with no frame missing before the cut, and the next start makes \
              finished recordings of them",
    count: 6 * 300,
    unit: "kills",
    side_by_side: 6,
    run: killed,
};

/// Each of the first writes fails.
pub const FAILED: Item = Item {
    name: "writes",
    promise: "each of the first 200 writes fails with ENOSPC or EIO (once, or from there on), is interrupted, \
              or is short: no panic, exit status 1 where it failed and 0 where nothing was lost, earlier chunks \
              readable, received = written + dropped",
    count: 6 * 200,
    unit: "failures",
    side_by_side: 6,
    run: failed,
};

/// Each of the first syncs fails.
pub const SYNCS: Item = Item {
    name: "syncs",
    promise: "a sync that fails ends its file, is not tried again, is told in the next file, and exit status is 1",
    count: 60,
    unit: "failures",
    side_by_side: 6,
    run: syncs,
};

const KINDS: [&str; 6] = ["write", "fdatasync", "openat", "linkat", "unlink", "rename"];

/// Starts a program under strace. Each thread counts its own calls.
pub fn injected(
    program: &Path,
    strace: &[&str],
    paths: &[&Path],
    more: Vec<std::ffi::OsString>,
) -> Running {
    let mut command = Command::new("strace");
    // As a grandchild, so that the process that is started is the recorder itself.
    command.args(["-D", "-f", "-qqq", "-o", "/dev/null"]);
    for option in strace {
        command.args(["-e", option]);
    }
    for path in paths {
        command.arg("-P").arg(path);
    }
    command.arg(program).args(more);
    spawn(command)
}

fn killed(job: &Job) -> Found {
    peers::peers();
    let each = job.count.div_ceil(KINDS.len() as u64);
    // The first call of each kind that is never reached.
    let beyond: Vec<AtomicU64> = KINDS.iter().map(|_| AtomicU64::new(u64::MAX)).collect();
    let job = Job {
        count: each * KINDS.len() as u64,
        folder: job.folder.clone(),
        bustape: job.bustape.clone(),
        ..*job
    };
    let (mut found, kills) = runs(&job, |run| {
        let (kind, call) = ((run.number / each) as usize, run.number % each + 1);
        if beyond[kind].load(Relaxed) < call {
            return None;
        }
        let reached = killed_in(run, KINDS[kind], call);
        if !reached {
            beyond[kind].fetch_min(call, Relaxed);
        }
        reached.then_some(kind)
    });
    let kills: Vec<usize> = kills.into_iter().flatten().collect();
    found.done = kills.len() as u64;
    for (kind, name) in KINDS.iter().enumerate() {
        let count = kills.iter().filter(|k| **k == kind).count();
        let end = if count < each as usize { ", all there are" } else { "" };
        found.number(&format!("kills in {name}"), format!("{count}{end}"));
    }
    found
}

fn is_of_first(path: &Path) -> bool {
    path.to_string_lossy().contains("_s0001_") && path.extension().is_some_and(|e| e == "mcap")
}

/// Starts the next recording in the folder of one that was cut off, and stops it when that one is recovered.
pub fn next_start(program: &Path, out: &Path) {
    let left: Vec<PathBuf> =
        std::fs::read_dir(out).unwrap().flatten().map(|entry| entry.path()).collect();
    let has_messages = |path: &PathBuf| {
        let bytes = std::fs::read(path).unwrap();
        path.extension().is_some_and(|e| e == "part") && holds_message(&bytes)
    };
    let left: Vec<PathBuf> = left.into_iter().filter(has_messages).collect();
    if left.is_empty() {
        return;
    }
    let running = start(program, args(&[&"record", &"sim:zhongheng-09", &"-d", &out]));
    // From then on it listens to signals.
    let own = |path: &Path| path.to_string_lossy().contains("_s0002_");
    until("its own file", || {
        let mut entries = std::fs::read_dir(out).unwrap().flatten();
        entries.any(|entry| own(&entry.path())).then_some(())
    });
    until("the recovery", || (!left.iter().any(|part| part.exists())).then_some(()));
    running.stop().expect(0);
}

/// True if a recovery has something to keep. What is behind a power cut's end does not matter here.
fn holds_message(bytes: &[u8]) -> bool {
    match mcap::parse(bytes, false) {
        Ok(file) => !file.messages.is_empty(),
        Err(_) => bytes.len() > 4096,
    }
}

/// False when the recording was over before that call.
fn killed_in(run: Run<'_>, kind: &str, call: u64) -> bool {
    let out = run.folder.join("out");
    std::fs::create_dir(&out).unwrap();
    let layout = ["frame", "batch"][(call % 2) as usize];
    let (split, time) =
        if matches!(kind, "write" | "fdatasync") { ("2s", "16s") } else { ("250ms", "8s") };
    let inject = format!("inject={kind}:signal=SIGKILL:when={call}");
    let options = args(&[
        &"record",
        &"sim:hmi-can",
        &"-d",
        &out,
        &"--layout",
        &layout,
        &"--chunk-time",
        &"20ms",
        &"--sync",
        &"20ms",
        &"--split-time",
        &split,
        &"--duration",
        &time,
    ]);
    let running = injected(run.bustape, &[&format!("trace={kind}"), &inject], &[], options);
    let ran = running.wait();
    if ran.status.code().is_some() {
        ran.expect(0);
        return false;
    }
    let before = all(&out);
    next_start(run.bustape, &out);
    let after: Vec<_> = files(&out).into_iter().filter(|(path, _)| is_of_first(path)).collect();
    let frames: Vec<_> = after.iter().flat_map(|(_, f)| messages::cans(f, "hmi-can")).collect();
    assert_eq!(frames, before, "what the next start made of it");
    true
}

/// The station's frames of all files, none missing between them.
fn all(out: &Path) -> Vec<(u64, bustape::frame::CanFrame)> {
    let files = files(out);
    let mut frames = Vec::new();
    for (_, file) in &files {
        if !file.messages.is_empty() {
            in_order(file, has_summary(file));
            frames.extend(messages::cans(file, "hmi-can"));
        }
    }
    if let Some((_, file)) = files.iter().find(|(_, file)| !file.messages.is_empty()) {
        from_the_beginning(file, &frames);
    }
    frames
}

/// What happens to a write, and whether it costs anything.
const FAILURES: [(&str, bool); 6] = [
    ("error=ENOSPC:when=N", true),
    ("error=EIO:when=N", true),
    ("error=EINTR:when=N", false),
    ("short", false),
    ("error=ENOSPC:when=N+", true),
    ("error=EIO:when=N+", true),
];

fn failed(job: &Job) -> Found {
    peers::peers();
    let each = job.count.div_ceil(FAILURES.len() as u64);
    short_write(&job.folder);
    let job = Job {
        count: each * FAILURES.len() as u64,
        folder: job.folder.clone(),
        bustape: job.bustape.clone(),
        ..*job
    };
    let (mut found, exits) = runs(&job, |run| {
        let (how, write) = ((run.number / each) as usize, run.number % each + 1);
        (how, fails(&run, &job.folder, FAILURES[how], write))
    });
    for (how, (name, _)) in FAILURES.iter().enumerate() {
        let of = |code| exits.iter().filter(|exit| **exit == (how, code)).count();
        let text = format!(
            "{} with exit status 1, {} with 0 (nothing lost, or not reached)",
            of(1),
            of(0)
        );
        found.number(&name.replace("when=N", "Nth write").replace(':', ", "), text);
    }
    std::fs::remove_file(job.folder.join("short_write.so")).ok();
    found
}

/// Makes the library that shortens writes.
fn short_write(folder: &Path) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/soak/short_write.c");
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-O1", "-o"]).arg(folder.join("short_write.so"));
    spawn(command_with(compiler, &[&source])).wait().expect(0);
}

fn command_with(mut command: Command, more: &[&Path]) -> Command {
    command.args(more).arg("-ldl");
    command
}

fn fails(run: &Run<'_>, shared: &Path, (how, costs): (&str, bool), write: u64) -> i32 {
    let path = run.folder.join("a.mcap");
    let parts = ["a.mcap.part", "a_0002.mcap.part"].map(|name| run.folder.join(name));
    // A line on which there is always something, so that there are as many writes.
    let tty = run.folder.join("tty");
    let line = format!("line=pty:{}", tty.display());
    let duration = format!("{}ms", 600 + 30 * write);
    let options = args(&[
        &"record",
        &"sim:hmi-can",
        &line,
        &"sim:zhongheng-09",
        &"-o",
        &path,
        &"--json",
        &"--chunk-time",
        &"20ms",
        &"--layout",
        &["frame", "batch"][(write % 2) as usize],
        &"--duration",
        &duration,
    ]);
    let stop = AtomicBool::new(false);
    let ran = std::thread::scope(|scope| {
        let _until = Until(&stop);
        scope.spawn(|| terminal(&tty, &stop).map(|mut line| talk(&mut line, 500, &stop)));
        let ran = if how == "short" {
            let mut command = Command::new(run.bustape);
            command.args(options).env("LD_PRELOAD", shared.join("short_write.so"));
            command.env("SHORT_WRITE", write.to_string());
            spawn(command).wait()
        } else {
            let inject =
                format!("inject=write:{}", how.replace("when=N", &format!("when={write}")));
            let paths: Vec<&Path> = parts.iter().map(PathBuf::as_path).collect();
            injected(run.bustape, &["trace=write", &inject], &paths, options).wait()
        };
        stop.store(true, Relaxed);
        ran
    });
    assert!(!ran.err.contains("panicked"), "{}", ran.err);
    let code = ran.status.code().expect("it ended by itself");
    if !costs {
        assert_eq!(code, 0, "{}", ran.err);
        let file = mcap::finished(&path);
        books_of(&ran, &[file]);
        return code;
    }
    if code == 0 {
        // A machine so busy that there were not so many writes.
        books_of(&ran, &[mcap::finished(&path)]);
        return code;
    }
    assert_eq!(code, 1, "write {write}: {}", ran.err);
    assert!(ran.err.contains("a.mcap.part: ") && ran.err.contains("os error"), "{}", ran.err);
    if ran.err.starts_with("error: cannot create") {
        assert_eq!(std::fs::read_dir(run.folder).unwrap().count(), 0, "an empty file is left");
        return code;
    }
    assert!(!path.exists(), "a file that failed looks finished");
    let mut files = vec![mcap::cut(&parts[0])];
    assert_eq!(files[0].end, files[0].size, "a chunk is half there");
    for name in ["a_0002.mcap.part", "a_0002.mcap"] {
        let path = run.folder.join(name);
        files.extend(path.exists().then(|| mcap::cut(&path)));
    }
    books_of(&ran, &files);
    code
}

/// The books balance, and what is called written is there, from the beginning.
fn books_of(ran: &Ran, files: &[Mcap]) {
    books(ran, files, "hmi-can");
    books(ran, files, "zhongheng-09");
    if ran.out.contains("\"line\"") {
        books(ran, files, "line");
    }
    from_the_beginning(&files[0], &messages::cans(&files[0], "hmi-can"));
}

fn syncs(job: &Job) -> Found {
    peers::peers();
    let (mut found, told) = runs(job, |run| {
        let sync = run.number + 1;
        let (path, part) = (run.folder.join("a.mcap"), run.folder.join("a.mcap.part"));
        let duration = format!("{}ms", 600 + 150 * sync);
        let options = args(&[
            &"record",
            &"sim:hmi-can",
            &"sim:zhongheng-09",
            &"-o",
            &path,
            &"--json",
            &"--sync",
            &"30ms",
            &"--chunk-time",
            &"30ms",
            &"--duration",
            &duration,
        ]);
        let inject = format!("inject=fdatasync:error=EIO:when={sync}");
        let ran = injected(run.bustape, &["trace=fdatasync", &inject], &[&part], options).wait();
        let ran = ran.expect(1);
        assert!(!path.exists(), "a file that may not be on the disk looks finished");
        if ran.err.starts_with("error: cannot create") {
            return false;
        }
        let next = run.folder.join("a_0002.mcap");
        let files = [mcap::cut(&part), mcap::finished(&next)];
        books_of(&ran, &files);
        let mut said = files[1].on("/bustape/log").map(|m| String::from_utf8_lossy(&m.data));
        assert!(said.any(|text| text.contains("cannot write")), "the next file does not tell");
        true
    });
    found.number("told in the next file", told.iter().filter(|told| **told).count());
    found.number(
        "at the head of the file, which is then not made",
        told.iter().filter(|told| !**told).count(),
    );
    found
}
