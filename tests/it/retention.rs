//! Room on the disk: which segments are deleted, which never are, and how a full disk ends.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use bustape::frame::{Direction, Frame, SerialBytes, Timestamp};
use bustape::recording::definition::{ChannelDefinition, Facts};
use bustape::recording::writer::{Layout, SegmentWriter, WriterOptions};

use crate::disk::on_small_disk;
use crate::record::weight;
use crate::support::bytes::noise;
use crate::support::make::{at, head, make};
use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{Ran, args, bustape, start};
use crate::support::terminal::open;
use crate::support::until;

const MIB: usize = 1 << 20;

/// A segment of about one MiB, named as the recorder does.
fn segment(folder: &Path, number: u32, stamp: &str) -> PathBuf {
    let data = noise(number.into(), MIB);
    let serial = SerialBytes { direction: Direction::Rx, data, errors: Vec::new() };
    let path = folder.join(format!("plant_s0001_{number:04}_{stamp}.mcap"));
    make(&path, Layout::Frame, &["line"], &[(0, at(0, Frame::Serial(serial)))]);
    path
}

fn segment_with_event(folder: &Path, number: u32, stamp: &str) -> PathBuf {
    let path = folder.join(format!("plant_s0001_{number:04}_{stamp}.mcap"));
    let file = std::fs::File::create_new(&path).unwrap();
    let options = WriterOptions::default();
    let mut writer = SegmentWriter::create(Box::new(file), options, &head(&["line"])).unwrap();
    let topic = "/bustape/event".to_owned();
    let definition = ChannelDefinition { topic, ..ChannelDefinition::default() };
    let channel = writer.define(definition).unwrap();
    writer.add_raw(channel, Timestamp(1_700_000_000_000_000_000), &noise(9, MIB));
    writer.finish(Facts::new()).unwrap();
    path
}

fn record(folder: &Path, options: &[&str]) -> Ran {
    let mut all = args(&[&"record", &"sim:hmi-can", &"-d", &folder, &"--name", &"plant"]);
    all.extend(args(&[&"--count", &"20"]));
    all.extend(options.iter().map(Into::into));
    bustape(all)
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn the_oldest_goes_first_but_never_one_that_is_kept_or_holds_an_event_nor_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let stamp = "20240101T000000Z";
    let mut paths: Vec<PathBuf> = (1..=8).map(|number| segment(folder, number, stamp)).collect();
    std::fs::remove_file(&paths[2]).unwrap();
    paths[2] = segment_with_event(folder, 3, stamp);
    bustape(args(&[&"keep", &paths[5]])).expect(0);
    // Not ours, whatever they are called.
    for name in [
        "plant_s0001_0001.mcap",
        "plant_s0001_0001_x.mcap",
        "plantX_s0001_0001_20240101T000000Z.mcap",
    ] {
        std::fs::write(folder.join(name), noise(1, MIB)).unwrap();
    }
    let ran = record(folder, &["--keep-size", "5500KiB"]).expect(0);
    let left = |number: usize| paths[number - 1].exists();
    let found: Vec<usize> = (1..=8).filter(|number| left(*number)).collect();
    // 2 is before the event, 5 before the kept one; of the others the oldest went.
    assert_eq!(found, [2, 3, 5, 6, 8], "{}", ran.err);
    assert_eq!(ran.err.matches("deleted ").count(), 3, "{}", ran.err);
    assert_eq!(names(folder).iter().filter(|name| name.contains("_s0001_0001")).count(), 3);
    // It is in the recording too.
    let own = names(folder).into_iter().find(|name| name.contains("_s0002_")).unwrap();
    let own = mcap::finished(&folder.join(own));
    let told =
        own.on("/bustape/log").filter(|m| String::from_utf8_lossy(&m.data).contains("deleted"));
    assert_eq!(told.count(), 3);

    // Once nobody wants it any more, it goes as the others do.
    bustape(args(&[&"keep", &"--undo", &paths[5]])).expect(0);
    record(folder, &["--keep-size", "4MiB"]).expect(0);
    let found: Vec<usize> = (1..=8).filter(|number| left(*number)).collect();
    assert_eq!(found, [2, 3, 8]);
    for undo in [&[][..], &["--undo"]] {
        let mut command = args(&[&"keep", &folder.join("no.mcap")]);
        command.extend(undo.iter().map(Into::into));
        let ran = bustape(command).expect(1);
        assert!(ran.err.contains("there is no file"), "{}", ran.err);
    }
}

#[test]
fn a_budget_that_had_to_give_way_is_kept_again_as_soon_as_something_may_go() {
    let folder = tempfile::tempdir().unwrap();
    let (out, tty) = (folder.path().join("out"), folder.path().join("tty"));
    std::fs::create_dir(&out).unwrap();
    let line = format!("line=pty:{}", tty.display());
    let running = start(args(&[
        &"record",
        &line,
        &"-d",
        &out,
        &"--split-size",
        &"1MiB",
        &"--keep-size",
        &"4MiB",
    ]));
    let mut terminal = open(&tty);
    let mut said = 0;
    let mut say_until = |what: &str, done: &dyn Fn(&[String]) -> bool| {
        until(what, || {
            said += 1;
            terminal.write_all(&noise(said, 200_000)).unwrap();
            done(&names(&out)).then_some(())
        });
    };
    let finished = |all: &[String]| all.iter().filter(|n| n.ends_with(".mcap")).count();
    // Everything that is finished is marked at once, until there is far too much.
    say_until("segments that may not go", &|all| {
        for name in all.iter().filter(|name| name.ends_with(".mcap")) {
            let mark = out.join(format!("{name}.keep"));
            std::fs::write(mark, "").unwrap();
        }
        finished(all) >= 8
    });
    for name in names(&out).iter().filter(|name| name.ends_with(".keep")) {
        std::fs::remove_file(out.join(name)).unwrap();
    }
    say_until("the budget", &|all| finished(all) <= 4);
    let ran = running.stop().expect(0);
    assert_eq!(ran.err.matches("larger than --keep-size").count(), 1, "{}", ran.err);
}

#[test]
fn by_age_only_what_has_a_known_age_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let stamps = [
        "19700101T000000Z",
        "19700101T010000Z",
        "20240101T000000Z",
        "20240102T000000Z",
        "20240103T000000Z",
    ];
    let paths: Vec<PathBuf> =
        (1..).zip(stamps).map(|(number, stamp)| segment(folder, number, stamp)).collect();
    record(folder, &["--keep-time", "100h"]).expect(0);
    let left: Vec<bool> = paths.iter().map(|path| path.exists()).collect();
    // The first two were recorded without a clock. The last one ended when the new one began.
    assert_eq!(left, [true, true, false, false, true]);
}

/// 64 MiB; `$3` are further options. The second segment is marked as soon as it is there.
const DISK: &str = r#"
set -eu
trap : TERM
mount -t tmpfs -o size=64m none "$1/disk"
(
    while ! ls "$1"/disk/*_0003_*.mcap* >/dev/null 2>&1; do sleep 0.05; done
    "$2" keep "$1"/disk/*_0002_*.mcap
    touch "$1/marked"
) &
status=0
"$2" record "line=pty:$1/tty" -d "$1/disk" --json OPTIONS || status=$?
df --output=avail -k "$1/disk" | tail -1 > "$1/avail"
cp "$1"/disk/* "$1/found/"
exit $status
"#;

fn segments(folder: &Path) -> Vec<(u32, Mcap)> {
    let files = names(folder).into_iter().filter(|name| name.ends_with(".mcap"));
    let number = |name: &str| name.split('_').nth(2).unwrap().parse().unwrap();
    files.map(|name| (number(&name), mcap::finished(&folder.join(&name)))).collect()
}

#[test]
fn on_a_small_disk_a_ring_goes_on_for_ever_and_keeps_what_is_marked() {
    let folder = tempfile::tempdir().unwrap();
    let script = DISK.replace("OPTIONS", "--when-full ring --min-free 4MiB --queue 64MiB");
    let running = on_small_disk(&script, folder.path());
    let mut line = open(&folder.path().join("tty"));
    let sent = noise(5, 90 * MIB);
    let (first, rest) = sent.split_at(14 * MIB);
    line.write_all(first).unwrap();
    until("the second segment to be marked", || {
        folder.path().join("marked").exists().then_some(())
    });
    line.write_all(rest).unwrap();
    running.stop_group();
    let ran = running.wait();
    assert!(matches!(ran.status.code(), Some(0 | 3)), "{ran:?}");
    let avail: u64 =
        std::fs::read_to_string(folder.path().join("avail")).unwrap().trim().parse().unwrap();
    assert!(avail >= 3 << 10, "only {avail} KiB were left free");
    let files = segments(&folder.path().join("found"));
    let numbers: Vec<u32> = files.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers[..2], [1, 2], "the marked one and the one before it: {numbers:?}");
    let rest = &numbers[2..];
    assert!(rest[0] > 3 && rest.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
    assert!(rest.len() > 5, "{numbers:?}");
    let books = &ran.json()["buses"][0];
    let number = |key: &str| books[key].as_u64().unwrap();
    assert_eq!(number("received"), number("written") + number("dropped"));
    assert!(number("written") > 64 << 20, "{books}");
    if number("dropped") == 0 && number("received") == sent.len() as u64 {
        let last = files[2..].iter().flat_map(|(_, file)| messages::streams(file, "line").0);
        assert!(sent.ends_with(&last.collect::<Vec<u8>>()));
    }
}

#[test]
fn on_a_full_disk_it_stops_with_a_finished_file_and_every_byte_accounted_for() {
    let folder = tempfile::tempdir().unwrap();
    let running = on_small_disk(&DISK.replace("OPTIONS", "--split-size 8MiB"), folder.path());
    let mut line = open(&folder.path().join("tty"));
    // Ends with an error when the recorder goes and its terminal with it.
    let sent = noise(5, 8 * MIB);
    while line.write_all(&sent).is_ok() {}
    let ran = running.wait().expect(3);
    assert_eq!(ran.json()["reason"], "disk full");
    assert!(ran.err.contains("the disk of"), "{}", ran.err);
    let files: Vec<Mcap> =
        segments(&folder.path().join("found")).into_iter().map(|(_, file)| file).collect();
    // On a busy machine the queue drops some too; the books tell which.
    let books = &ran.json()["buses"][0];
    let number = |key: &str| books[key].as_u64().unwrap();
    assert_eq!(number("received"), number("written") + number("dropped"), "{books}");
    assert_eq!(files.iter().map(|file| weight(file, "line")).sum::<u64>(), number("written"));
    assert!(number("written") > 40 << 20, "{books}");
    let last = files.last().unwrap();
    assert_eq!(last.facts("bustape.summary")["reason"], "disk full");
    let sizes = std::fs::read_dir(folder.path().join("found")).unwrap();
    assert!(sizes.flatten().all(|entry| !entry.path().to_str().unwrap().ends_with(".part")));
}

#[test]
fn a_signal_begins_a_new_segment_without_a_gap() {
    let folder = tempfile::tempdir().unwrap();
    let running = start(args(&[&"record", &"sim:hmi-can", &"-d", &folder.path(), &"--json"]));
    let part = |number: &str| {
        until("frames in the next segment", || {
            let name = names(folder.path()).into_iter().find(|n| n.contains(number))?;
            let file = std::fs::read(folder.path().join(&name)).ok()?;
            mcap::parse(&file, false).ok()?.on("/hmi-can/raw").next().map(drop)
        });
    };
    part("_0001_");
    running.signal(nix::sys::signal::Signal::SIGUSR1);
    part("_0002_");
    let ran = running.stop().expect(0).json();
    let files = segments(folder.path());
    assert_eq!(files.len(), 2);
    assert_eq!(files[0].1.facts("bustape.summary")["reason"], "split");
    let same = |key: &str| {
        let facts = |file: &Mcap| file.facts("bustape.recording")[key].clone();
        assert_eq!(facts(&files[0].1), facts(&files[1].1), "{key}");
    };
    same("session_id");
    same("boot_id");
    let frames: Vec<_> = files.iter().flat_map(|(_, f)| messages::cans(f, "hmi-can")).collect();
    assert_eq!(ran["buses"][0]["received"], frames.len());
    crate::record::from_the_beginning(&files[0].1, &frames);
}

#[test]
fn recordings_are_private_whatever_the_umask() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let mut command = std::process::Command::new("sh");
    command.args(["-c", r#"umask 0; exec "$0" record sim:hmi-can -d "$1" --count 5"#]);
    command.arg(crate::support::process::BUSTAPE).arg(folder.path());
    crate::support::process::spawn(command).wait().expect(0);
    let file = folder.path().join(&names(folder.path())[0]);
    let copy = folder.path().join("copy.mcap");
    bustape(args(&[&"recover", &file, &"-o", &copy])).expect(0);
    for file in [file, copy] {
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
    }
}
