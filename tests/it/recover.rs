//! `bustape recover`, and the recovery of what a crash left when the next recording starts.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, SerialBytes, Stamped, Timestamp, Unit,
};
use bustape::recording::writer::Layout;

use crate::record::{from_the_beginning, in_order};
use crate::support::bytes::Random;
use crate::support::make::{START, at, make};
use crate::support::mcap::{self, Mcap, Message};
use crate::support::process::{Ran, args, bustape, spawn, start, start_injected};
use crate::support::{messages, peers, several, until};

/// Change it to try other damage.
const SEED: u64 = 1;

/// Some thousand frames in small chunks; all channels are defined in the first of them.
fn sound(folder: &Path, layout: Layout) -> PathBuf {
    let can =
        |n: u64| Frame::Can(CanFrame::new(n as u32 % 9, CanFlags::default(), &n.to_le_bytes()));
    let serial = |n: u64| {
        let data = (0..30).map(|byte| (byte * n) as u8).collect();
        Frame::Serial(SerialBytes { direction: Direction::Rx, data, errors: Vec::new() })
    };
    let (from, to) = (Timestamp(START), Timestamp(START + 5));
    let gap = Gap { count: 3, unit: Unit::Frames, reason: GapReason::Adapter, from, to };
    let mut frames: Vec<(usize, Stamped<Frame>)> = vec![(0, at(1, Frame::Gap(gap)))];
    frames.extend((2..3000u64).map(|n| match n % 3 {
        0 => (1, at(n * 1_000_000, serial(n))),
        _ => (0, at(n * 1_000_000, can(n))),
    }));
    let path = folder.join(format!("{}.mcap", layout.name()));
    make(&path, layout, &["can0", "rect"], &frames);
    path
}

fn recover(from: &Path, to: &Path) -> Ran {
    bustape(args(&[&"recover", &"--json", &from, &"-o", &to]))
}

#[test]
fn a_sound_file_comes_out_byte_for_byte_as_it_went_in() {
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let path = sound(folder.path(), layout);
        let copy = path.with_extension("copy");
        let json = recover(&path, &copy).expect(0).json();
        assert_eq!(json["files"][0]["whole"], true, "{json}");
        let before = std::fs::read(&path).unwrap();
        assert!(std::fs::read(&copy).unwrap() == before);
        let ran = bustape(args(&[&"recover", &"--in-place", &path])).expect(0);
        assert!(ran.out.contains("sound, left as it is"), "{}", ran.out);
        assert!(std::fs::read(&path).unwrap() == before);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4);
}

#[test]
fn after_a_kill_everything_readable_is_recovered_and_a_second_run_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    println!("seed {SEED}");
    let mut random = Random::new(SEED);
    let moments = (0..8).map(|run| (run, random.below(500) as u64)).collect();
    several(moments, |(run, moment)| {
        let folder = folder.path().join(run.to_string());
        std::fs::create_dir(&folder).unwrap();
        let (path, part) = (folder.join("a.mcap"), folder.join("a.mcap.part"));
        let layout = ["frame", "batch"][run % 2];
        let running = start(args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--layout", &layout]));
        until("frames in the file", || {
            let file = part.exists().then(|| mcap::cut(&part))?;
            file.on("/hmi-can/raw").next().map(drop)
        });
        std::thread::sleep(Duration::from_millis(moment));
        running.kill();
        let before = std::fs::read(&part).unwrap();
        let readable = mcap::cut(&part);
        let copy = folder.join("copy.mcap");
        recover(&part, &copy).expect(if readable.end < readable.size { 3 } else { 0 });
        let file = mcap::finished(&copy);
        assert_eq!(file.messages, readable.messages, "moment {moment}");
        in_order(&file, false);
        from_the_beginning(&file, &messages::cans(&file, "hmi-can"));
        assert_eq!(file.facts("bustape.recovery")["was_finished"], "false");
        assert!(std::fs::read(&part).unwrap() == before, "the original was touched");
        let again = folder.join("again.mcap");
        recover(&copy, &again).expect(0);
        assert!(std::fs::read(&again).unwrap() == std::fs::read(&copy).unwrap());
        let python = peers::python_reads(&copy);
        assert_eq!(python.messages.len(), file.messages.len());
    });
}

/// Damage behind the first chunks, which define the channels. True if no byte has moved.
fn damage(bytes: &mut Vec<u8>, from: usize, random: &mut Random) {
    let at = from + random.below(bytes.len() - from - 200);
    let length = 1 + random.below(150);
    match random.below(5) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at..at + length].fill(0),
        2 => drop(bytes.drain(at..at + length)),
        3 => {
            let more = crate::support::bytes::noise(random.next(), length);
            bytes.splice(at..at, more).for_each(drop);
        }
        // A sector of the disk.
        _ => {
            let start = at / 512 * 512;
            let end = (start + 512).min(bytes.len());
            bytes[start.max(from)..end].fill(0xFF);
        }
    }
}

/// The messages of those chunks that stand in `bytes` untouched.
fn intact(original: &Mcap, sound: &[u8], bytes: &[u8]) -> Vec<Message> {
    let mut rest = &original.messages[..];
    let mut found = Vec::new();
    for chunk in &original.chunks {
        let (messages, behind) = rest.split_at(chunk.messages);
        rest = behind;
        let record = &sound[chunk.offset..chunk.offset + chunk.length];
        if bytes.windows(record.len()).any(|window| window == record) {
            found.extend_from_slice(messages);
        }
    }
    found
}

#[test]
fn wherever_a_file_is_damaged_every_message_of_intact_chunks_is_kept() {
    println!("seed {SEED}");
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let path = sound(folder.path(), layout);
        let (bytes, original) = (std::fs::read(&path).unwrap(), mcap::finished(&path));
        let from = original.chunks[2].offset;
        let work = |edit: u64| {
            let mut random = Random::new(SEED << 32 | edit);
            let mut damaged = bytes.clone();
            for _ in 0..=random.below(4) {
                damage(&mut damaged, from, &mut random);
            }
            let name = |what: &str| folder.path().join(format!("{}-{edit}.{what}", layout.name()));
            std::fs::write(name("mcap"), &damaged).unwrap();
            let about = format!("{} edit {edit}", layout.name());
            let json = recover(&name("mcap"), &name("new")).json();
            let report = &json["files"][0];
            let file = mcap::finished(&name("new"));
            let kept = intact(&original, &bytes, &damaged);
            assert!(is_within(&kept, &file.messages), "{about}: messages are missing, {report}");
            if report["kept"]["unverified_messages"] == 0 {
                assert!(is_within(&file.messages, &original.messages), "{about}: invented");
            }
            if kept.len() < original.messages.len() {
                assert_eq!(report["whole"], false, "{about}: a loss was not told");
                let ranges = report["lost"]["ranges"].as_array().unwrap();
                assert!(!ranges.is_empty(), "{about}: {report}");
            }
            recover(&name("new"), &name("again")).expect(0);
            assert!(std::fs::read(name("new")).unwrap() == std::fs::read(name("again")).unwrap());
            report["whole"] == false
        };
        let lossy = several((0..40).collect(), work);
        assert!(lossy.iter().filter(|lost| **lost).count() > 20, "hardly any damage was done");
    }
}

/// True if `some` stand in `all` in the same order.
fn is_within(some: &[Message], all: &[Message]) -> bool {
    let mut all = all.iter();
    some.iter().all(|wanted| all.any(|message| message == wanted))
}

#[test]
fn what_is_lost_is_told_to_the_byte_and_the_message() {
    let folder = tempfile::tempdir().unwrap();
    let path = sound(folder.path(), Layout::Frame);
    let original = mcap::finished(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    let chunk = &original.chunks[7];
    bytes[chunk.offset..chunk.offset + chunk.length].fill(0);
    let (damaged, new) = (folder.path().join("damaged.mcap"), folder.path().join("new.mcap"));
    std::fs::write(&damaged, &bytes).unwrap();
    let json = recover(&damaged, &new).expect(3).json();
    let lost = &json["files"][0]["lost"];
    assert_eq!(lost["messages"], chunk.messages, "{json}");
    assert_eq!(lost["messages_exact"], true);
    assert_eq!(lost["bytes"], chunk.length);
    let range = &lost["ranges"][0];
    assert_eq!((range["from"].as_u64(), range["to"].as_u64()), {
        let end = chunk.offset + chunk.length;
        (Some(chunk.offset as u64), Some(end as u64))
    });
    assert_eq!(range["messages"], chunk.messages);
    let time = |nanos: u64| bustape::text::rfc3339(Timestamp(nanos));
    assert_eq!(range["not_before"], time(chunk.start));
    assert_eq!(range["not_after"], time(chunk.end));
    let facts = mcap::finished(&new).facts("bustape.recovery").clone();
    assert_eq!(facts["lost_messages_known"], chunk.messages.to_string());
    assert!(facts["lost.0001"].starts_with(&format!("bytes {} to ", chunk.offset)), "{facts:?}");
}

#[test]
fn with_its_first_chunk_lost_a_file_is_understood_by_its_summary() {
    let folder = tempfile::tempdir().unwrap();
    let path = sound(folder.path(), Layout::Frame);
    let original = mcap::finished(&path);
    let mut bytes = std::fs::read(&path).unwrap();
    let first = &original.chunks[0];
    bytes[first.offset + 60..first.offset + first.length].fill(0xAA);
    let (damaged, new) = (folder.path().join("damaged.mcap"), folder.path().join("new.mcap"));
    std::fs::write(&damaged, &bytes).unwrap();
    recover(&damaged, &new).expect(3);
    let file = mcap::finished(&new);
    assert_eq!(file.messages, original.messages[first.messages..]);
    recover(&new, &folder.path().join("again.mcap")).expect(0);
}

#[test]
fn sectors_that_cannot_be_read_cost_only_what_is_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = sound(folder.path(), Layout::Frame);
    let original = mcap::finished(&path);
    let new = folder.path().join("new.mcap");
    let ran = start_injected(
        &["trace=pread64", "inject=pread64:error=EIO:when=40..47"],
        &[&path],
        args(&[&"recover", &path, &"-o", &new]),
    );
    let ran = ran.wait().expect(3);
    assert!(ran.out.contains("lost bytes"), "{}", ran.out);
    let file = mcap::finished(&new);
    assert!(is_within(&file.messages, &original.messages));
    assert!(file.messages.len() * 10 > original.messages.len() * 8, "{}", file.messages.len());
}

#[test]
fn files_of_other_writers_are_recovered_too() {
    let folder = tempfile::tempdir().unwrap();
    for (compression, chunked) in
        [("LZ4", "chunked"), ("ZSTD", "chunked"), ("NONE", "chunked"), ("NONE", "loose")]
    {
        let name = |what: &str| folder.path().join(format!("{compression}-{chunked}-{what}.mcap"));
        let mut command = peers::python("foreign.py");
        command.arg(name("sound")).arg(compression).arg(chunked);
        spawn(command).wait().expect(0);
        recover(&name("sound"), &name("copy")).expect(0);
        let (sound, copy) =
            (peers::python_streams(&name("sound")), peers::python_reads(&name("copy")));
        assert!(sound.messages.len() == 1000 && copy.messages == sound.messages, "{compression}");
        for key in ["profile", "library", "channels", "metadata", "attachments"] {
            assert_eq!(copy.file[key], sound.file[key], "{compression} {key}");
        }
        // Some zeros, and the end is missing.
        let mut bytes = std::fs::read(name("sound")).unwrap();
        let (half, most) = (bytes.len() / 2, bytes.len() * 4 / 5);
        bytes[half..half + 100].fill(0);
        bytes.truncate(most);
        std::fs::write(name("damaged"), &bytes).unwrap();
        let report = recover(&name("damaged"), &name("new")).expect(3);
        let new = peers::python_reads(&name("new"));
        assert!(new.messages.len() > 500, "{compression} {chunked}: {}", new.messages.len());
        // Where nothing vouches for a chunk, zeros may be in its messages.
        let doubtful = report.json()["files"][0]["kept"]["unverified_messages"].as_u64().unwrap();
        let wrong = new.messages.iter().filter(|message| !sound.messages.contains(message)).count();
        assert!(wrong as u64 <= doubtful, "{compression} {chunked}: {wrong} of {doubtful}");
        recover(&name("new"), &name("again")).expect(0);
        let same = std::fs::read(name("new")).unwrap() == std::fs::read(name("again")).unwrap();
        assert!(same, "{compression} {chunked}");
    }
}

#[test]
fn in_place_the_original_is_set_aside_and_never_changed() {
    let folder = tempfile::tempdir().unwrap();
    let path = sound(folder.path(), Layout::Frame);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let (part, name) = (folder.path().join("x.mcap.part"), folder.path().join("x.mcap"));
    for aside in ["x.mcap.damaged", "x.mcap.damaged.2"] {
        std::fs::write(&part, &bytes[..bytes.len() / 2]).unwrap();
        bustape(args(&[&"recover", &"--in-place", &part])).expect(3);
        assert!(!part.exists());
        mcap::finished(&name);
        let set_aside = std::fs::read(folder.path().join(aside)).unwrap();
        assert!(set_aside == bytes[..bytes.len() / 2]);
        std::fs::remove_file(&name).unwrap();
    }
    // A finished file that is damaged keeps its name; the copy takes it.
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2..bytes.len() / 2 + 3000].fill(0);
    std::fs::write(&name, &damaged).unwrap();
    bustape(args(&[&"recover", &"--in-place", &folder.path()])).expect(3);
    mcap::finished(&name);
    assert!(std::fs::read(folder.path().join("x.mcap.damaged.3")).unwrap() == damaged);
    let cat = bustape(args(&[&"cat", &folder.path()])).expect(0);
    assert!(cat.out.lines().count() > 500);
}

#[test]
fn of_both_names_that_a_power_cut_leaves_on_vfat_the_empty_one_goes() {
    let folder = tempfile::tempdir().unwrap();
    let path = sound(folder.path(), Layout::Batch);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let (part, name) = (folder.path().join("x.mcap.part"), folder.path().join("x.mcap"));
    for (full, empty) in [(&part, &name), (&name, &part)] {
        std::fs::write(full, &bytes).unwrap();
        std::fs::write(empty, b"").unwrap();
        bustape(args(&[&"recover", &"--in-place", &part])).expect(0);
        assert!(std::fs::read(&name).unwrap() == bytes);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "set aside needlessly");
        std::fs::remove_file(&name).unwrap();
    }
}

#[test]
fn what_is_being_recorded_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let part = folder.path().join("a.mcap.part");
    let running = start(args(&[&"record", &"sim:hmi-can", &"-o", &path]));
    until("the file", || part.exists().then_some(()));
    let ran = bustape(args(&[&"recover", &"--in-place", &part])).expect(1);
    assert!(ran.err.contains("is being written by process"), "{}", ran.err);
    running.stop().expect(0);
    mcap::finished(&path);
}

#[test]
fn what_is_no_recording_is_not_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let (path, new) = (folder.path().join("a.mcap"), folder.path().join("new.mcap"));
    std::fs::write(&path, crate::support::bytes::noise(3, 50_000)).unwrap();
    let ran = recover(&path, &new).expect(1);
    assert!(ran.err.contains("nothing that can be recognised"), "{}", ran.err);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn what_was_left_before_anything_was_in_it_is_set_aside_and_holds_nothing_up() {
    let folder = tempfile::tempdir().unwrap();
    let name = |name: &str| folder.path().join(name);
    let (_, sound) = crate::hostile::sound(folder.path(), Layout::Frame);
    std::fs::remove_file(name("frame.mcap")).unwrap();
    // A head that did not reach the disk, a name without a byte, and something else by that name.
    std::fs::write(name("p_s0001_0001_20260101T000000Z.mcap.part"), &sound[..30]).unwrap();
    std::fs::write(name("p_s0002_0001_20260101T000000Z.mcap.part"), b"").unwrap();
    std::fs::write(name("p_s0003_0001_20260101T000000Z.mcap.part"), &sound[..sound.len() / 2])
        .unwrap();
    let ran = bustape(args(&[&"recover", &"--in-place", &folder.path()])).expect(0);
    assert!(ran.err.contains("was left before anything was recorded into it"), "{}", ran.err);
    assert!(ran.err.contains("was left empty, and was removed"), "{}", ran.err);
    let mut left: Vec<String> = crate::support::files(folder.path());
    left.sort();
    let kept = [
        "1_0001_20260101T000000Z.mcap.damaged",
        "3_0001_20260101T000000Z.mcap",
        "3_0001_20260101T000000Z.mcap.damaged",
    ];
    assert_eq!(left, kept.map(|name| format!("p_s000{name}")));
    assert_eq!(std::fs::read(name(&left[0])).unwrap(), sound[..30]);
    // Where one of several cannot be recovered at all, the others are.
    std::fs::write(name("noise.mcap"), crate::support::bytes::noise(3, 5000)).unwrap();
    std::fs::write(name("p_s0004_0001_20260101T000000Z.mcap.part"), &sound[..sound.len() / 2])
        .unwrap();
    let ran = bustape(args(&[&"recover", &"--in-place", &folder.path()])).expect(1);
    assert!(ran.err.contains("1 of 3 files could not be recovered"), "{}", ran.err);
    mcap::finished(&name("p_s0004_0001_20260101T000000Z.mcap"));
}

#[test]
fn a_recovery_that_waits_for_the_disk_does_not_hold_up_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let old = sound(folder.path(), Layout::Frame);
    let bytes = std::fs::read(&old).unwrap();
    let left = folder.path().join("p_s0001_0001_20260101T000000Z.mcap");
    std::fs::write(left.with_extension("mcap.part"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::remove_file(&old).unwrap();
    let copy = left.with_extension("mcap.recovery");
    let slow = ["trace=fdatasync", "inject=fdatasync:delay_enter=600000000"];
    let name = args(&[&"record", &"sim:hmi-can", &"-d", &folder.path(), &"--name", &"p"]);
    let running = start_injected(&slow, &[&copy], name);
    until("the recovery", || copy.exists().then_some(()));
    let own = |ending: &str| {
        let names = crate::support::files(folder.path());
        names.into_iter().find(|n| n.starts_with("p_s0002") && n.ends_with(ending))
    };
    until("a frame", || {
        let part = own(".part")?;
        mcap::cut(&folder.path().join(part)).on("/hmi-can/raw").next().map(drop)
    });
    running.signal(nix::sys::signal::Signal::SIGTERM);
    let finished = until("its own file", || own(".mcap"));
    mcap::finished(&folder.path().join(finished));
    running.kill();
}

#[test]
fn what_a_crash_left_is_recovered_when_the_next_recording_starts() {
    let folder = tempfile::tempdir().unwrap();
    let record =
        || start(args(&[&"record", &"sim:hmi-can", &"-d", &folder.path(), &"--name", &"plant"]));
    let parts = || {
        let entries = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path());
        entries.filter(|path| path.to_str().unwrap().ends_with(".part")).collect::<Vec<PathBuf>>()
    };
    let part = |session: &str| {
        until("frames in the file", || {
            let part = parts().into_iter().find(|part| part.to_str().unwrap().contains(session))?;
            mcap::cut(&part).on("/hmi-can/raw").next()?;
            Some(part)
        })
    };
    // One that is still being recorded must not be touched.
    let other =
        start(args(&[&"record", &"sim:hmi-can", &"-d", &folder.path(), &"--name", &"other"]));
    part("other");
    let first = record();
    let left = part("plant_s0001");
    first.kill();
    let readable = mcap::cut(&left);
    let before = std::fs::read(&left).unwrap();
    let second = record();
    let name = left.with_extension("");
    until("the recovered file", || name.exists().then_some(()));
    assert_eq!(mcap::finished(&name).messages, readable.messages);
    let mut aside = name.clone().into_os_string();
    aside.push(".damaged");
    until("the original to be set aside", || (!left.exists()).then_some(()));
    assert!(std::fs::read(&aside).unwrap() == before);
    let own = part("plant_s0002");
    until("it to be told in the recording", || {
        let file = mcap::cut(&own);
        let told = file
            .on("/bustape/log")
            .any(|m| String::from_utf8_lossy(&m.data).contains("was recovered as"));
        told.then_some(())
    });
    let ran = second.stop().expect(0);
    assert!(ran.err.contains("was recovered as"), "{}", ran.err);
    other.stop().expect(0);
    assert!(parts().is_empty());
}
