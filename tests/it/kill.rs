//! What a kill leaves.

use std::ffi::OsStr;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use crate::record::{from_the_beginning, in_order};
use crate::support::bytes::{Random, noise};
use crate::support::mcap::{self, Mcap};
use crate::support::process::{args, bustape, start, start_injected};
use crate::support::terminal::open;
use crate::support::{messages, peers, several, until};

/// Change it to try other moments.
const SEED: u64 = 1;

#[test]
fn a_kill_at_any_moment_leaves_a_file_that_can_be_read_and_finished() {
    let folder = tempfile::tempdir().unwrap();
    println!("seed {SEED}");
    let mut random = Random::new(SEED);
    let moments = (0..15).map(|run| (run, random.below(600) as u64)).collect();
    let with_frames = several(moments, |(run, moment)| {
        let folder = folder.path().join(run.to_string());
        std::fs::create_dir(&folder).unwrap();
        let (path, terminal) = (folder.join("a.mcap"), folder.join("tty"));
        let layout = ["frame", "batch"][run % 2];
        let running = start(args(&[
            &"record",
            &"sim:hmi-can",
            &format!("line=pty:{}", terminal.display()),
            &"-o",
            &path,
            &"--layout",
            &layout,
        ]));
        let sent = noise(run as u64, 1 << 20);
        let mut line = open(&terminal);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                sent.chunks(997).try_for_each(|piece| {
                    std::thread::sleep(Duration::from_millis(3));
                    line.write_all(piece)
                })
            });
            // A third of them at once, also before there is a file; the others in full course.
            if run % 3 > 0 {
                let part = folder.join("a.mcap.part");
                until("frames in the file", || {
                    let file = part.exists().then(|| mcap::cut(&part))?;
                    file.on("/hmi-can/raw").next().map(drop)
                });
            }
            std::thread::sleep(Duration::from_millis(moment));
            running.kill();
        });
        let part = folder.join("a.mcap.part");
        assert!(!path.exists());
        // Between its start and the first file there is nothing to be read, nor lost.
        part.exists() && check(run, &part, &sent)
    });
    let with_frames = with_frames.into_iter().filter(|found| *found).count();
    assert!(with_frames >= 10, "only {with_frames} of 15 runs got as far as a frame");
}

/// What must hold of a file that was cut off. True if there is a frame in it.
fn check(run: usize, part: &Path, sent: &[u8]) -> bool {
    let file = mcap::cut(part);
    let frames = messages::cans(&file, "hmi-can");
    from_the_beginning(&file, &frames);
    let (bytes, _) = messages::streams(&file, "line");
    assert!(sent.starts_with(&bytes), "run {run}: not what was sent");
    if file.metadata.len() < 4 {
        // Cut off in its head: no bus is known yet.
        assert!(file.messages.is_empty());
        return false;
    }
    in_order(&file, false);
    said_to_be_unfinished(part, &file);
    let cat = bustape(args(&[&"cat", &"-N", &part])).out;
    let can = cat.lines().filter(|line| line.contains(" hmi-can ")).count();
    assert_eq!(can, frames.len(), "run {run}");
    let json = bustape(args(&[&"cat", &"--json", &part])).out;
    assert_eq!(json.lines().count(), messages::raw(&file, "line").len() + frames.len());
    if run.is_multiple_of(5) {
        let python = peers::python_streams(part);
        assert_eq!(python.count("/hmi-can/raw"), file.on("/hmi-can/raw").count() as u64);
        assert_eq!(python.count("/line/raw"), file.on("/line/raw").count() as u64);
    }
    finishes(part, &file, &cat);
    !frames.is_empty()
}

fn said_to_be_unfinished(part: &Path, file: &Mcap) {
    let info = bustape(args(&[&"info", &part])).expect(0);
    assert!(info.out.contains("NOT FINISHED"), "{}", info.out);
    let advice = format!("bustape convert {} -o", part.display());
    assert!(info.err.contains("was not finished") && info.err.contains(&advice), "{}", info.err);
    let info = bustape(args(&[&"info", &"--json", &part])).expect(0).json();
    assert_eq!(info["segments"][0]["finished"], false);
    assert_eq!(info["segments"][0]["readable_bytes"], file.end);
    assert_eq!(info["segments"][0]["messages"], file.messages.len());
}

fn finishes(part: &Path, file: &Mcap, cat: &str) {
    let new = part.with_file_name("new.mcap");
    let code = if file.end < file.size { 3 } else { 0 };
    let before = std::fs::read(part).unwrap();
    bustape(args(&[&"convert", &part, &"-o", &new])).expect(code);
    assert!(std::fs::read(part).unwrap() == before, "the original was touched");
    let converted = mcap::finished(&new);
    in_order(&converted, true);
    assert_eq!(bustape(args(&[&"cat", &"-N", &new])).expect(0).out, cat);
    for bus in ["hmi-can", "line"] {
        assert_eq!(messages::raw(&converted, bus), messages::raw(file, bus));
    }
}

#[test]
fn a_lone_frame_reaches_the_disk_by_itself_and_survives_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let (path, terminal) = (folder.path().join("a.mcap"), folder.path().join("tty"));
    let part = folder.path().join("a.mcap.part");
    let running =
        start(args(&[&"record", &format!("line=pty:{}", terminal.display()), &"-o", &path]));
    let mut line = open(&terminal);
    let mut sent = Vec::new();
    for word in ["one", "two", "three"] {
        line.write_all(word.as_bytes()).unwrap();
        sent.extend_from_slice(word.as_bytes());
        // Nothing follows it: no chunk gets full, nobody asks.
        until("a lone frame on the disk", || {
            let found = part.exists() && messages::streams(&mcap::cut(&part), "line").0 == sent;
            found.then_some(())
        });
    }
    running.kill();
    assert_eq!(messages::streams(&mcap::cut(&part), "line").0, sent);
}

#[test]
fn no_write_is_a_bad_one_to_die_in() {
    let folder = tempfile::tempdir().unwrap();
    let lasted = several((1..=20).collect(), |write: usize| {
        let path = folder.path().join(format!("{write}.mcap"));
        let part = folder.path().join(format!("{write}.mcap.part"));
        let inject = format!("inject=write:signal=SIGKILL:when={write}");
        let running = start_injected(
            &["trace=write", &inject],
            &[&part],
            args(&[
                &"record",
                &"sim:hmi-can",
                &"sim:zhongheng-09",
                &"-o",
                &path,
                &"--chunk-time",
                &"20ms",
                &"--layout",
                &["frame", "batch"][write % 2],
            ]),
        );
        let ran = running.wait();
        assert!(ran.status.code().is_none(), "not killed in write {write}: {ran:?}");
        let file = mcap::cut(&part);
        assert_eq!(file.end, file.size, "write {write} is half there");
        from_the_beginning(&file, &messages::cans(&file, "hmi-can"));
        if file.messages.is_empty() {
            assert!(file.chunks.is_empty(), "head only");
            let info = bustape(args(&[&"info", &part]));
            assert!(matches!(info.status.code(), Some(0 | 1)), "{info:?}");
        } else {
            in_order(&file, false);
            said_to_be_unfinished(&part, &file);
        }
        file.chunks.len()
    });
    assert!(lasted.iter().any(|chunks| *chunks > 3), "{lasted:?}");
}

#[test]
fn a_kill_while_the_file_gets_its_name_leaves_one_recording() {
    let folder = tempfile::tempdir().unwrap();
    for call in ["linkat", "unlink"] {
        let folder = folder.path().join(call);
        std::fs::create_dir(&folder).unwrap();
        let (path, part) = (folder.join("a.mcap"), folder.join("a.mcap.part"));
        let inject = format!("inject={call}:signal=SIGKILL:when=1");
        let running = start_injected(
            &[&format!("trace={call}"), &inject],
            &[&part],
            args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--count", &"20", &"--sync", &"1h"]),
        );
        assert!(running.wait().status.code().is_none(), "not killed in {call}");
        let file = mcap::finished(if path.exists() { &path } else { &part });
        assert_eq!(messages::cans(&file, "hmi-can").len(), 20);
        // Also where both names lead to it.
        let cat = bustape(args(&[&"cat", &folder])).expect(0).out;
        assert_eq!(cat.lines().count(), 20, "after a kill in {call}");
    }
}

#[test]
fn while_the_disk_takes_its_time_what_comes_is_written_and_a_kill_does_not_take_it() {
    let folder = tempfile::tempdir().unwrap();
    let (out, terminal) = (folder.path().join("out"), folder.path().join("tty"));
    std::fs::create_dir(&out).unwrap();
    // The syncs of the first file's head and of its first chunks are quick; then none ever ends, nor does
    // what finishes that file and begins the next.
    let slow = ["trace=fdatasync", "inject=fdatasync:delay_enter=600000000:when=3+"];
    let line = format!("line=pty:{}", terminal.display());
    let options: [&dyn AsRef<OsStr>; 9] =
        [&"record", &line, &"-d", &out, &"--sync", &"100ms", &"--split-time", &"2s", &"--json"];
    let running = start_injected(&slow, &[], args(&options));
    let mut line = open(&terminal);
    let mut sent = Vec::new();
    // Until there are three files, of which none has its final name, and for as long again.
    for round in 0..1200_u32 {
        let text = format!("{round:06}\n");
        line.write_all(text.as_bytes()).unwrap();
        sent.extend_from_slice(text.as_bytes());
        until("what was just said is in a file", || {
            let files = crate::windows::files(&out);
            let kept = files.iter().flat_map(|path| messages::streams(&mcap::cut(path), "line").0);
            (kept.count() == sent.len()).then_some(())
        });
        let files = crate::windows::files(&out);
        if files.len() == 3 && !messages::streams(&mcap::cut(&files[2]), "line").0.is_empty() {
            break;
        }
    }
    running.kill();
    let files = crate::windows::files(&out);
    assert_eq!(files.len(), 3, "{files:?}");
    assert!(files.iter().all(|path| path.extension().is_some_and(|ending| ending == "part")));
    // All but the last are complete, and the next start gives them their names.
    bustape(args(&[&"recover", &"--in-place", &out])).expect(0);
    let mut files = crate::windows::files(&out);
    files.retain(|path| path.extension().is_some_and(|ending| ending == "mcap"));
    let kept: Vec<u8> =
        files.iter().flat_map(|path| messages::streams(&mcap::finished(path), "line").0).collect();
    assert!(files.len() == 3 && kept == sent, "{files:?}");
}
