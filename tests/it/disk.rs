//! Disks that fail, are full, or may not be written to.

use std::io::Write as _;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::record::{from_the_beginning, weight};
use crate::support::bytes::noise;
use crate::support::mcap::{self, Mcap};
use crate::support::messages::{self, DISK};
use crate::support::process::{BUSTAPE, Ran, Running, args, bustape, spawn, start, start_injected};
use crate::support::terminal::open;
use crate::support::{peers, several, station, until};

/// received = written + dropped, and what is called written is in the files.
pub fn books(ran: &Ran, files: &[Mcap], bus: &str) -> (u64, u64) {
    let json = ran.json();
    let books = json["buses"].as_array().unwrap().iter().find(|b| b["bus"] == bus).unwrap().clone();
    let number = |key: &str| books[key].as_u64().unwrap();
    assert_eq!(number("received"), number("written") + number("dropped"), "{books}");
    let found: u64 = files.iter().map(|file| weight(file, bus)).sum();
    assert_eq!(found, number("written"), "{books}");
    assert_eq!(books["dropped_by_reason"]["disk"].as_u64().unwrap_or(0), number("dropped"));
    (number("written"), number("dropped"))
}

/// Returns when there are frames in a file that is being written.
fn until_it_goes_on_in(path: &Path) {
    let part = PathBuf::from(format!("{}.part", path.display()));
    until("frames in the next file", || {
        let file = part.exists().then(|| mcap::cut(&part))?;
        file.on("/hmi-can/raw").next().map(drop)
    });
}

#[test]
fn when_a_write_fails_it_says_so_and_goes_on_in_a_new_file() {
    let folder = tempfile::tempdir().unwrap();
    let lost = several(
        vec![(8, "frame"), (9, "batch"), (11, "frame"), (14, "batch")],
        |(write, layout)| {
            let path = folder.path().join(format!("{write}.mcap"));
            let part = folder.path().join(format!("{write}.mcap.part"));
            let inject = format!("inject=write:error=ENOSPC:when={write}+");
            let running = start_injected(
                &["trace=write", &inject],
                &[&part],
                args(&[
                    &"record",
                    &"sim:hmi-can",
                    &"sim:zhongheng-09",
                    &"-o",
                    &path,
                    &"--json",
                    &"--layout",
                    &layout,
                    &"--chunk-time",
                    &"50ms",
                ]),
            );
            let next = folder.path().join(format!("{write}_0002.mcap"));
            until_it_goes_on_in(&next);
            let ran = running.stop().expect(1);
            let sentence = format!("cannot write {}: No space left on device", part.display());
            assert!(ran.err.contains(&format!("error: {sentence}")), "{}", ran.err);
            assert!(ran.err.contains("bustape convert"), "{}", ran.err);
            assert!(!path.exists());
            let files = [mcap::cut(&part), mcap::finished(&next)];
            assert_eq!(files[0].end, files[0].size);
            let (written, dropped) = books(&ran, &files, "hmi-can");
            books(&ran, &files, "zhongheng-09");
            assert!(written > 0);
            // The new file says what the old one cost, and between the two nothing else is missing.
            let gaps = messages::gaps(&files[1], "hmi-can");
            assert_eq!(gaps.iter().map(|gap| gap.0).sum::<u64>(), dropped);
            assert!(gaps.iter().all(|gap| gap.1 == DISK));
            let before = messages::cans(&files[0], "hmi-can");
            from_the_beginning(&files[0], &before);
            let station = station(&files[0], "hmi-can").skip(before.len() + dropped as usize);
            for ((_, recorded), sent) in messages::cans(&files[1], "hmi-can").iter().zip(station) {
                assert_eq!(*recorded, sent);
            }
            assert_eq!(files[1].facts("bustape.recording")["segment"], "2");
            dropped
        },
    );
    assert!(lost.iter().any(|dropped| *dropped > 0), "{lost:?}");
}

#[test]
fn when_the_new_file_cannot_be_written_either_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let parts = ["a.mcap.part", "a_0002.mcap.part"].map(|name| folder.path().join(name));
    let running = start_injected(
        &["trace=write", "inject=write:error=EIO:when=8+"],
        &[&parts[0], &parts[1]],
        args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--json", &"--chunk-time", &"50ms"]),
    );
    // Nobody stops it: it ends by itself.
    let ran = running.wait().expect(1);
    assert_eq!(ran.json()["reason"], "write error");
    assert!(ran.err.contains("Input/output error"), "{}", ran.err);
    let (written, dropped) = books(&ran, &[mcap::cut(&parts[0])], "hmi-can");
    assert!(written > 0 && dropped > 0, "{}", ran.out);
    assert!(!parts[1].exists(), "a file without a frame stays behind");
}

#[test]
fn a_failed_sync_ends_the_file_and_is_not_retried() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let running = start_injected(
        &["trace=fdatasync", "inject=fdatasync:error=EIO:when=3"],
        &[&part],
        args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--json", &"--sync", &"200ms"]),
    );
    let next = folder.path().join("a_0002.mcap");
    until_it_goes_on_in(&next);
    let ran = running.stop().expect(1);
    assert!(ran.err.contains(&format!("cannot write {}", part.display())), "{}", ran.err);
    let files = [mcap::cut(&part), mcap::finished(&next)];
    books(&ran, &files, "hmi-can");
    assert!(!path.exists(), "a file that may not be on the disk must not look finished");
}

#[test]
fn a_file_that_cannot_be_made_safe_does_not_get_its_name_and_the_next_one_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // Of the second file: its head, and its end.
    several(vec![1, 2], |sync: u32| {
        let folder = folder.path().join(sync.to_string());
        std::fs::create_dir(&folder).unwrap();
        let name = |number: u32| folder.join(format!("a_{number:04}.mcap"));
        let part = PathBuf::from(format!("{}.part", name(2).display()));
        let inject = format!("inject=fdatasync:error=EIO:when={sync}");
        let running = start_injected(
            &["trace=fdatasync", &inject],
            &[&part],
            args(&[
                &"record",
                &"sim:hmi-can",
                &"-o",
                &folder.join("a.mcap"),
                &"--json",
                &"--sync",
                &"1h",
                &"--split-time",
                &"500ms",
                &"--duration",
                &"3s",
            ]),
        );
        let ran = running.wait().expect(1);
        let sentence = format!("cannot write {}: Input/output error", part.display());
        assert!(ran.err.contains(&sentence), "{}", ran.err);
        assert!(!name(2).exists());
        let rest = (3..).map(name).take_while(|path| path.exists());
        let mut files = vec![mcap::finished(&name(1)), mcap::cut(&part)];
        files.extend(rest.map(|path| mcap::finished(&path)));
        assert!(files.len() > 3, "{}", files.len());
        books(&ran, &files, "hmi-can");
        let told = messages::decoded(&files[2]).any(|(_, m)| format!("{m:?}").contains(&sentence));
        assert!(told, "{sentence}");
    });
}

/// How many writes a segment's head takes: one a record.
fn head_writes(folder: &Path) -> usize {
    let path = folder.join("head.mcap");
    bustape(args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--count", &"1"])).expect(0);
    let file = mcap::finished(&path);
    file.records.iter().take_while(|(opcode, _)| *opcode != 6).count()
}

/// Records segments of a second, of which the second one fails at some of its writes, counted from behind its
/// head. The files that there are then.
fn second_segment_fails(folder: &Path, writes: &str) -> (Ran, Vec<Mcap>) {
    let name = |number: u32| folder.join(format!("a_{number:04}.mcap"));
    let part = PathBuf::from(format!("{}.part", name(2).display()));
    let (first, rest) = writes.split_at(1);
    let write = head_writes(folder) + first.parse::<usize>().unwrap();
    let inject = format!("inject=write:error=EIO:when={write}{rest}");
    let options = args(&[
        &"record",
        &"sim:hmi-can",
        &"-o",
        &folder.join("a.mcap"),
        &"--json",
        &"--split-time",
        &"1s",
        &"--duration",
        &"4s",
        &"--chunk-time",
        &"1m",
    ]);
    let ran = start_injected(&["trace=write", &inject], &[&part], options).wait().expect(1);
    assert!(ran.err.contains(&format!("cannot write {}", part.display())), "{}", ran.err);
    let mut files = vec![mcap::finished(&name(1)), mcap::cut(&part)];
    let rest = (3..).map(name).take_while(|path| path.exists());
    files.extend(rest.map(|path| mcap::finished(&path)));
    assert!(files.len() > 3, "{}", ran.err);
    (ran, files)
}

#[test]
fn when_the_end_of_a_segment_cannot_be_written_it_goes_on_in_a_new_file() {
    let folder = tempfile::tempdir().unwrap();
    // The first write behind the head is all that the segment holds.
    let (ran, files) = second_segment_fails(folder.path(), "2+");
    assert!(files.iter().all(|file| file.on("/hmi-can/raw").count() > 0), "an empty segment");
    let (_, dropped) = books(&ran, &files, "hmi-can");
    assert_eq!(dropped, 0);
}

#[test]
fn the_gap_that_a_failed_write_leaves_is_where_its_frames_were() {
    let folder = tempfile::tempdir().unwrap();
    let (ran, files) = second_segment_fails(folder.path(), "1");
    let (_, dropped) = books(&ran, &files, "hmi-can");
    let mut gaps = messages::decoded(&files[2]);
    let (_, gap) = gaps.find(|(m, _)| files[2].topic(m) == "/hmi-can/gaps").unwrap();
    let gap = messages::as_python(&gap);
    let [from, to] = ["from_ns", "to_ns"].map(|key| gap[key].as_u64().unwrap());
    assert_eq!(gap["count"], dropped);
    assert!(to - from > 500_000_000, "{gap}");
    assert!(messages::cans(&files[0], "hmi-can").last().unwrap().0 < from, "{gap}");
    assert!(to < messages::cans(&files[2], "hmi-can")[0].0, "{gap}");
}

#[test]
fn every_new_name_is_synced_with_its_folder_and_a_new_folder_with_the_one_above() {
    peers::peers();
    let above = tempfile::tempdir().unwrap();
    let (folder, log) = (above.path().join("new"), above.path().join("log"));
    std::fs::create_dir(&folder).unwrap();
    let mut command = Command::new("strace");
    command.args(["-f", "-y", "-qqq", "-e", "trace=openat,linkat,fsync,write", "-o"]).arg(&log);
    command.arg(BUSTAPE).args(args(&[&"record", &"sim:hmi-can", &"-d", &folder]));
    command.args(["--split-time", "300ms", "--duration", "2s"]);
    spawn(command).wait().expect(0);
    let log = std::fs::read_to_string(log).unwrap();
    let synced = |path: &Path| format!("<{}>", path.canonicalize().unwrap().display());
    let (folder_synced, above_synced) = (synced(&folder), synced(above.path()));
    let (mut due, mut names, mut above_done) = (Vec::new(), 0, false);
    for line in log.lines() {
        let is_final = line.contains("linkat(");
        if line.contains("fsync(") {
            due.retain(|_| !line.contains(&folder_synced));
            above_done |= line.contains(&above_synced);
        } else if is_final || line.contains("O_CREAT") && line.contains(".mcap.part") {
            assert!(above_done, "the folder itself may not last: {line}");
            // A new file is begun while the one before gets its name, but no two of a kind at once.
            assert!(!due.contains(&is_final), "another name before the folder was synced: {line}");
            due.push(is_final);
            names += 1;
        } else if line.contains("MCAP0") {
            // Only a head is written before its name lasts.
            assert!(line.contains(".mcap.part"), "{line}");
        }
    }
    assert!(due.is_empty() && names >= 6, "{names} names, {log}");
}

#[test]
fn a_head_that_cannot_be_written_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    several((1..=4).collect(), |write: usize| {
        let path = folder.path().join(format!("{write}.mcap"));
        let part = folder.path().join(format!("{write}.mcap.part"));
        let inject = format!("inject=write:error=EDQUOT:when={write}");
        let args = args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--count", &"1"]);
        let ran = start_injected(&["trace=write", &inject], &[&part], args).wait().expect(1);
        let sentence = format!("error: cannot create {}: ", part.display());
        assert!(ran.err.starts_with(&sentence), "{}", ran.err);
    });
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// A real file system of 9 MiB, in a mount namespace of its own, so that it goes when the
/// recorder does. What is on it at the end is copied to where the test can see it.
const SMALL_DISK: &str = r#"
set -eu
mount -t tmpfs -o size=9m none "$1/disk"
status=0
"$2" record "line=pty:$1/tty" -o "$1/disk/a.mcap" --json || status=$?
cp "$1"/disk/* "$1/found/"
exit $status
"#;

pub fn on_small_disk(script: &str, folder: &Path) -> Running {
    for name in ["disk", "found"] {
        std::fs::create_dir(folder.join(name)).unwrap();
    }
    // With a user namespace, nobody need be root for it.
    let own = if nix::unistd::geteuid().is_root() { "-m" } else { "-rm" };
    let mut trial = Command::new("unshare");
    trial.args([own, "mount", "-t", "tmpfs", "none"]).arg(folder.join("disk"));
    let why =
        "a small disk needs the right to mount: run the tests as root, or allow user namespaces";
    assert!(spawn(trial).wait().status.success(), "{why}");
    let mut command = Command::new("unshare");
    command.args([own, "sh", "-c", script, "sh"]).arg(folder).arg(BUSTAPE);
    spawn(command)
}

#[test]
fn on_a_full_disk_everything_that_is_called_written_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let running = on_small_disk(SMALL_DISK, folder.path());
    let mut line = open(&folder.path().join("tty"));
    let sent = noise(5, 16 << 20);
    // Ends with an error when the recorder goes and its terminal with it.
    let _ = line.write_all(&sent);
    let ran = running.wait().expect(1);
    assert!(ran.err.contains("No space left on device"), "{}", ran.err);
    let found = folder.path().join("found");
    let mut files = vec![mcap::cut(&found.join("a.mcap.part"))];
    for name in ["a_0002.mcap.part", "a_0002.mcap"] {
        files.extend(found.join(name).exists().then(|| mcap::cut(&found.join(name))));
    }
    let (written, dropped) = books(&ran, &files, "line");
    assert!(written > 4 << 20 && dropped > 0, "{}", ran.out);
    let first = messages::streams(&files[0], "line").0;
    assert!(sent.starts_with(&first));
    // The file system is full, the file is not at fault: it can be finished elsewhere.
    let (part, new) = (found.join("a.mcap.part"), found.join("new.mcap"));
    let ran = bustape(args(&[&"convert", &part, &"-o", &new]));
    assert!(matches!(ran.status.code(), Some(0 | 3)), "{ran:?}");
    assert!(messages::streams(&mcap::finished(&new), "line").0 == first);
}

#[test]
fn nothing_is_started_on_a_disk_that_is_nearly_full() {
    let folder = tempfile::tempdir().unwrap();
    let script = SMALL_DISK.replace("size=9m", "size=1m");
    let ran = on_small_disk(&script.replace("cp ", "ls "), folder.path()).wait();
    assert!(ran.err.contains("free there, at least"), "{ran:?}");
    assert!(!ran.out.contains("a.mcap"), "{ran:?}");
}

fn fails_to_record_into(path: &Path, sentence: &str) {
    let ran = bustape(args(&[&"record", &"sim:hmi-can", &"--count", &"1", &"-o", &path])).expect(1);
    assert!(ran.err.starts_with("error: ") && ran.err.contains(sentence), "{}", ran.err);
    assert_eq!(ran.out, "");
}

#[test]
fn an_existing_file_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for existing in [path.clone(), folder.path().join("a.mcap.part")] {
        std::fs::write(&existing, "mine").unwrap();
        fails_to_record_into(&path, "exists and is not overwritten");
        let some = folder.path().join("b.mcap");
        if !some.exists() {
            bustape(args(&[&"record", &"sim:hmi-can", &"--count", &"1", &"-o", &some])).expect(0);
        }
        let ran = bustape(args(&[&"convert", &some, &"-o", &path])).expect(1);
        assert!(ran.err.contains("exists and is not overwritten"), "{}", ran.err);
        assert_eq!(std::fs::read(&existing).unwrap(), b"mine");
        std::fs::remove_file(&existing).unwrap();
    }
    // A link that leads nowhere is not followed either.
    std::os::unix::fs::symlink(folder.path().join("elsewhere"), &path).unwrap();
    fails_to_record_into(&path, "exists and is not overwritten");
    assert!(!folder.path().join("elsewhere").exists());
}

#[test]
fn a_file_that_appears_meanwhile_is_not_overwritten_either() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("a.mcap"), folder.path().join("a.mcap.part"));
    let running = start(args(&[&"record", &"sim:hmi-can", &"-o", &path]));
    until("the file", || part.exists().then_some(()));
    std::fs::write(&path, "mine").unwrap();
    let ran = running.stop().expect(1);
    assert!(ran.err.contains("complete under the first name"), "{}", ran.err);
    assert_eq!(std::fs::read(&path).unwrap(), b"mine");
    mcap::finished(&part);
}

#[test]
fn a_missing_folder_is_named_with_the_command_that_makes_it() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("no");
    fails_to_record_into(&missing.join("a.mcap"), &format!("mkdir -p {}", missing.display()));
    let ran = bustape(args(&[&"record", &"sim:hmi-can", &"-d", &missing])).expect(1);
    assert!(ran.err.contains(&format!("mkdir -p {}", missing.display())), "{}", ran.err);
    assert!(!missing.exists());
}

#[test]
fn a_folder_without_the_right_to_write_is_said_and_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let closed = folder.path().join("closed");
    std::fs::create_dir(&closed).unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    std::fs::set_permissions(&closed, PermissionsExt::from_mode(0o555)).unwrap();
    // Root may write everywhere, so the recorder must not be it. The binary may stand where only
    // root can reach it.
    let binary = folder.path().join("bustape");
    std::fs::copy(BUSTAPE, &binary).unwrap();
    let command = if nix::unistd::geteuid().is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]).arg(&binary);
        command
    } else {
        Command::new(&binary)
    };
    for target in [["-o".into(), closed.join("a.mcap")], ["-d".into(), closed.clone()]] {
        let mut command2 = Command::new(command.get_program());
        command2
            .args(command.get_args())
            .args(["record", "sim:hmi-can", "--count", "1"])
            .args(&target);
        let ran = spawn(command2).wait().expect(1);
        assert!(ran.err.contains(closed.to_str().unwrap()), "{}", ran.err);
        assert!(
            ran.err.contains("Permission denied") && ran.err.contains("right to write"),
            "{}",
            ran.err
        );
    }
    assert_eq!(std::fs::read_dir(&closed).unwrap().count(), 0);
}

#[test]
fn a_conversion_that_fails_leaves_no_half_made_file() {
    let folder = tempfile::tempdir().unwrap();
    let (path, new) = (folder.path().join("a.mcap"), folder.path().join("new.mcap"));
    let part = folder.path().join("new.mcap.part");
    bustape(args(&[&"record", &"sim:hmi-can", &"--count", &"30", &"-o", &path])).expect(0);
    for write in 1..=8 {
        let inject = format!("inject=write:error=ENOSPC:when={write}+");
        let options = ["trace=write", &inject];
        let args = args(&[&"convert", &path, &"-o", &new]);
        let ran = start_injected(&options, &[&part], args).wait();
        if ran.status.success() {
            assert!(write > 5, "a conversion makes more writes than {write}");
            return;
        }
        let ran = ran.expect(1);
        assert!(ran.err.contains("new.mcap") && ran.err.contains("No space left"), "{}", ran.err);
        assert!(!new.exists() && !part.exists(), "after write {write} failed");
    }
}
