//! Files that are damaged, or made to do harm.

use std::fmt::Write as _;
use std::io::Write as _;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, SerialBytes, Timestamp, Unit,
};
use bustape::recording::definition::{ChannelDefinition, Facts, SchemaDefinition};
use bustape::recording::writer::{Head, Layout, SegmentWriter, WriterOptions};

use crate::support::bytes::{Random, noise};
use crate::support::make::{START, at, make};
use crate::support::mcap;
use crate::support::process::{BUSTAPE, args, bustape};
use crate::support::several;

/// Change it to try other edits; then also try more of them.
const SEED: u64 = 1;
const EDITS: usize = 2_000;

/// What a reader may ask for. Beyond it an allocation fails, and the process aborts.
const MEMORY: u64 = 1 << 30;

/// A small recording with everything in it.
pub fn sound(folder: &Path, layout: Layout) -> (PathBuf, Vec<u8>) {
    let can = |n: u64| Frame::Can(CanFrame::new(n as u32 % 5, CanFlags::FD, &[n as u8; 8]));
    let serial = |n: u64| {
        let (direction, data, errors) = (Direction::Tx, vec![n as u8; 9], Vec::new());
        Frame::Serial(SerialBytes { direction, data, errors })
    };
    let (from, to) = (Timestamp(START), Timestamp(START + 5));
    let gap = Gap { count: 3, unit: Unit::Frames, reason: GapReason::Adapter, from, to };
    let mut frames: Vec<_> = (0..130).map(|n| (0, at(n * 1_000, can(n)))).collect();
    frames.extend((0..20).map(|n| (1, at(200_000 + n, serial(n)))));
    frames.push((0, at(300_000, Frame::Gap(gap))));
    let path = folder.join(format!("{}.mcap", layout.name()));
    make(&path, layout, &["can0", "rect"], &frames);
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

/// Runs one of the commands that read recordings.
fn survives(which: usize, file: &Path, about: &str) -> Output {
    let new = file.with_extension("new");
    let mut command = Command::new(BUSTAPE);
    match which % 6 {
        0 => command.arg("info"),
        1 => command.arg("cat"),
        2 => command.args(["cat", "--json", "--topics", "*"]),
        3 => command.args(["info", "--json"]),
        5 => command.args(["recover", "-o"]).arg(&new),
        _ => command.args(["convert", "--layout", "batch", "-o"]).arg(&new),
    };
    command.arg(file);
    let output = limited(command, file, about);
    std::fs::remove_file(&new).ok();
    output
}

/// Runs a command that reads `file`, with little memory. Panics if it does not end by itself with a
/// sentence.
pub fn limited(mut command: Command, file: &Path, about: &str) -> Output {
    command.stdin(Stdio::null());
    // SAFETY: setrlimit may be called between fork and exec.
    unsafe {
        command.pre_exec(|| {
            let limit = libc::rlimit { rlim_cur: MEMORY, rlim_max: MEMORY };
            match libc::setrlimit(libc::RLIMIT_AS, &raw const limit) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            }
        });
    }
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    let kept = || {
        let kept = std::env::temp_dir().join("bustape-hostile");
        std::fs::copy(file, &kept).unwrap();
        format!("{about}, {command:?}, kept as {}: {} {said}", kept.display(), output.status)
    };
    assert!(output.status.signal().is_none(), "{}", kept());
    let code = output.status.code();
    assert!(matches!(code, Some(0 | 1 | 3)) && !said.contains("panicked"), "{}", kept());
    assert!(code == Some(0) || !said.is_empty(), "{}", kept());
    output
}

#[test]
fn a_file_cut_off_anywhere_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let (path, bytes) = sound(folder.path(), layout);
        let records: Vec<usize> = mcap::finished(&path).records.iter().map(|r| r.1).collect();
        // At each boundary, within each record's head, and in the middle of each record.
        let middles = records.windows(2).map(|pair| usize::midpoint(pair[0], pair[1]));
        let boundaries = records.iter().copied().chain([bytes.len()]);
        let mut ends: Vec<usize> = boundaries.flat_map(|at| [at, at - 1, at + 5]).collect();
        ends.extend(middles);
        ends.extend([0, 1, 7, 8, 9]);
        ends.retain(|end| *end < bytes.len());
        ends.sort_unstable();
        ends.dedup();
        several(ends.into_iter().enumerate().collect(), |(number, end)| {
            let file = folder.path().join(format!("{}-{end}.mcap", layout.name()));
            std::fs::write(&file, &bytes[..end]).unwrap();
            let about = format!("{} bytes of {}", end, layout.name());
            let output = survives(number, &file, &about);
            if end < 8 {
                assert_eq!(output.status.code(), Some(1), "{about}");
                return;
            }
            let strict = mcap::parse(&bytes[..end], false).unwrap();
            let info = bustape(args(&[&"info", &"--json", &file])).expect(0).json();
            assert_eq!(info["segments"][0]["finished"], false, "{about}");
            assert_eq!(info["segments"][0]["messages"], strict.messages.len(), "{about}");
        });
    }
}

#[test]
fn random_damage_never_crashes_a_reader_nor_takes_its_memory() {
    println!("seed {SEED}");
    let folder = tempfile::tempdir().unwrap();
    let originals = [Layout::Frame, Layout::Batch].map(|layout| sound(folder.path(), layout).1);
    let halves = std::thread::available_parallelism().map_or(2, usize::from).min(4);
    let work = (0..halves).map(|half| (half, folder.path().join(format!("{half}.mcap")))).collect();
    several(work, |(half, file): (usize, PathBuf)| {
        for edit in (half..EDITS).step_by(halves) {
            let mut random = Random::new(SEED << 32 | edit as u64);
            let mut bytes = originals[random.below(2)].clone();
            for _ in 0..=random.below(4) {
                damage(&mut bytes, &mut random);
            }
            std::fs::write(&file, bytes).unwrap();
            survives(random.below(6), &file, &format!("edit {edit}"));
        }
    });
}

/// One of the things that happen to files, and one that somebody may think of.
pub fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    let at = random.below(bytes.len().max(1));
    match random.below(7) {
        _ if bytes.len() < 32 => bytes.push(1),
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.next() as u8,
        // A length, a count or an offset that goes too far.
        2 => {
            let extreme = [u64::MAX, 1 << 63, 1 << 40, 1 << 31, 0xFFFF_FFFF, 0][random.below(6)];
            let at = at.min(bytes.len() - 8);
            let width = [4, 8][random.below(2)];
            bytes[at..at + width].copy_from_slice(&extreme.to_le_bytes()[..width]);
        }
        3 => bytes.truncate(at),
        4 => drop(bytes.drain(at..(at + random.below(64)).min(bytes.len()))),
        5 => {
            let piece: Vec<u8> = bytes[at..(at + random.below(64)).min(bytes.len())].to_vec();
            bytes.splice(at..at, piece).for_each(drop);
        }
        _ => {
            let piece = noise(random.next(), random.below(32));
            bytes.splice(at..at, piece).for_each(drop);
        }
    }
}

#[test]
fn what_is_no_recording_is_said_to_be_none() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    for (content, sentence) in [
        (&b""[..], "is not an MCAP file"),
        (b"PK\x03\x04", "is not an MCAP file"),
        (&noise(1, 5000), "is not an MCAP file"),
    ] {
        std::fs::write(&file, content).unwrap();
        for which in 0..5 {
            let output = survives(which, &file, "garbage");
            let said = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1));
            assert!(said.contains(sentence) && said.contains(file.to_str().unwrap()), "{said}");
        }
    }
    let ran = bustape(args(&[&"info", &folder.path().join("no.mcap")])).expect(1);
    assert!(ran.err.contains("No such file"), "{}", ran.err);
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let ran = bustape(args(&[&"info", &empty])).expect(1);
    assert!(ran.err.contains("there is no recording in"), "{}", ran.err);
}

#[test]
fn a_chunk_that_unpacks_to_gigabytes_stops_at_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bomb.mcap");
    let mut packed = zstd::Encoder::new(Vec::new(), 1).unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..1500 {
        packed.write_all(&zeros).unwrap();
    }
    let packed = packed.finish().unwrap();
    // What it says of its size: the truth, less than the truth, and nonsense.
    for claimed in [1500 << 20, 1 << 20, 1 << 40, u64::MAX] {
        let mut body = Vec::new();
        for number in [START, START, claimed] {
            body.extend_from_slice(&u64::to_le_bytes(number));
        }
        body.extend_from_slice(&[0; 4]);
        body.extend_from_slice(&4u32.to_le_bytes());
        body.extend_from_slice(b"zstd");
        body.extend_from_slice(&(packed.len() as u64).to_le_bytes());
        body.extend_from_slice(&packed);
        let mut out = std::fs::File::create(&file).unwrap();
        out.write_all(b"\x89MCAP0\r\n\x01").unwrap();
        out.write_all(&8u64.to_le_bytes()).unwrap();
        out.write_all(&[0; 8]).unwrap();
        out.write_all(&[6]).unwrap();
        out.write_all(&(body.len() as u64).to_le_bytes()).unwrap();
        out.write_all(&body).unwrap();
        for which in 0..5 {
            let output = survives(which, &file, "a bomb");
            let said = String::from_utf8(output.stderr).unwrap();
            assert!(which % 3 == 0 || output.status.code() == Some(3), "{said}");
        }
    }
}

#[test]
fn a_hundred_thousand_empty_chunks_are_read_past() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("chunks.mcap");
    let (_, sound) = sound(folder.path(), Layout::Frame);
    let parsed = mcap::parse(&sound, true).unwrap();
    let (_, first_chunk) = *parsed.records.iter().find(|(opcode, _)| *opcode == 6).unwrap();
    let mut empty = Vec::new();
    for number in [START, START, 0] {
        empty.extend_from_slice(&u64::to_le_bytes(number));
    }
    empty.extend_from_slice(&[0; 4]);
    empty.extend_from_slice(&0u32.to_le_bytes());
    empty.extend_from_slice(&0u64.to_le_bytes());
    let empty = record(6, &empty);
    let (head, rest) = sound.split_at(first_chunk);
    let bytes = [head, &empty.repeat(100_000), rest].concat();
    std::fs::write(&file, bytes).unwrap();
    // Its index points beside what it means, so nothing but walking the file finds the frames.
    for which in 0..6 {
        survives(which, &file, "empty chunks");
    }
    let original = folder.path().join("frame.mcap");
    let [ours, theirs] =
        [&file, &original].map(|path| bustape(args(&[&"cat", &"--topics", &"*", path])).out);
    assert!(!ours.is_empty() && ours == theirs);
    let recovered = folder.path().join("recovered.mcap");
    bustape(args(&[&"recover", &file, &"-o", &recovered]));
    assert_eq!(mcap::finished(&recovered).messages, parsed.messages);
}

/// A batch of 65,536 empty frames in two bytes each.
pub fn dense_batch() -> Vec<u8> {
    let zeros = vec![0; 65_536];
    let length = [0x80, 0x80, 0x04];
    let mut batch = vec![0x08, 0x80, 0x80, 0x04, 0x10, 0x01];
    for (field, data) in [(0x1A, &zeros), (0x2A, &zeros)] {
        if field == 0x2A {
            batch.extend_from_slice(&[0x22, 0x02, 0x08, 0x01]);
        }
        batch.push(field);
        batch.extend_from_slice(&length);
        batch.extend_from_slice(data);
    }
    batch
}

#[test]
fn batches_of_millions_of_frames_stop_at_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("dense.mcap");
    let out = Box::new(std::fs::File::create_new(&path).unwrap());
    let head = Head { buses: vec![("can0".to_owned(), Facts::new())], ..Head::default() };
    let mut writer = SegmentWriter::create(out, WriterOptions::default(), &head).unwrap();
    let data = bustape::recording::schema::CAN_BATCH.descriptor;
    let channel = ChannelDefinition {
        topic: "/can0/raw".to_owned(),
        encoding: "protobuf".to_owned(),
        schema: Some(SchemaDefinition { name: "bustape.CanBatch", encoding: "protobuf", data }),
        metadata: Facts::from([("bus".to_owned(), "can0".to_owned())]),
    };
    let channel = writer.define(channel).unwrap();
    // 64 MiB of them are 33 million frames, some 3.5 GiB when all are unpacked at once.
    let batch = dense_batch();
    for _ in 0..(64 << 20) / batch.len() - 1 {
        writer.add_raw(channel, Timestamp(START), &batch);
    }
    writer.finish(Facts::new()).unwrap();
    for which in [1, 4] {
        let output = survives(which, &path, "dense batches");
        assert_eq!(output.status.code(), Some(3));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("more than 1048576 frames"), "{said}");
    }
}

/// A record of an MCAP file.
fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![opcode];
    bytes.extend_from_slice(&(body.len() as u64).to_le_bytes());
    bytes.extend_from_slice(body);
    bytes
}

/// A text of an MCAP record.
fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// A chunk of these records, packed.
fn packed(records: &[u8]) -> Vec<u8> {
    let data = zstd::encode_all(records, 3).unwrap();
    let mut chunk = Vec::new();
    for number in [START, START, records.len() as u64] {
        chunk.extend_from_slice(&number.to_le_bytes());
    }
    chunk.extend_from_slice(&[0; 4]);
    chunk.extend_from_slice(&text("zstd"));
    chunk.extend_from_slice(&(data.len() as u64).to_le_bytes());
    chunk.extend_from_slice(&data);
    record(6, &chunk)
}

/// A channel of batches, and messages on it.
fn batches(messages: &[&[u8]]) -> Vec<u8> {
    let schema = [&1u16.to_le_bytes()[..], &text("bustape.CanBatch"), &text("protobuf"), &[0; 4]];
    let bus = [text("bus"), text("can0")].concat();
    let channel = [
        &[1, 0, 1, 0][..],
        &text("/can0/raw"),
        &text("protobuf"),
        &(bus.len() as u32).to_le_bytes(),
        &bus,
    ];
    let mut all = [record(3, &schema.concat()), record(4, &channel.concat())].concat();
    for message in messages {
        let head = [&[1, 0, 0, 0, 0, 0][..], &START.to_le_bytes(), &START.to_le_bytes()].concat();
        all.extend(record(5, &[&head[..], message].concat()));
    }
    all
}

#[test]
fn small_files_that_claim_much_stop_at_the_limits() {
    let folder = tempfile::tempdir().unwrap();
    let head = [&b"\x89MCAP0\r\n"[..], &record(1, &[text(""), text("x")].concat())].concat();
    // A batch of 33 million kinds of frames, each of them empty.
    let kinds = packed(&batches(&[&b"\x22\x00".repeat((32 << 20) - 4096)]));
    // A million frames of one moment in each of 12 chunks.
    let moment = packed(&batches(&[&dense_batch()[..]; 15])).repeat(12);
    // 1 GiB of metadata, in 20 records; entries without letters, which take more room than they have bytes.
    let note = |n: u32, body: &[u8]| {
        let length = (body.len() as u32).to_le_bytes();
        record(12, &[&text(&n.to_string())[..], &length, body].concat())
    };
    let long = [text("k"), text(&"a".repeat(50 << 20))].concat();
    let notes: Vec<u8> = (0..20).flat_map(|n| note(n, &long)).collect();
    let key = |n: u32| [0, 6, 12, 18].map(|shift| b'0' + (n >> shift & 63) as u8);
    let short: Vec<u8> =
        (0..4_000_000).flat_map(|n| [&4u32.to_le_bytes()[..], &key(n), &[0; 4]].concat()).collect();
    for (name, content) in
        [("kinds", kinds), ("moment", moment), ("notes", notes), ("short", note(0, &short))]
    {
        let file = folder.path().join(format!("{name}.mcap"));
        std::fs::write(&file, [&head[..], &content].concat()).unwrap();
        // `convert` of the moment's frames is minutes of work, and reads as `cat` does.
        for which in [0, 1, 3] {
            let output = survives(which, &file, name);
            assert!(matches!(output.status.code(), Some(0 | 3)), "{name}: {:?}", output.status);
        }
    }
}

#[test]
fn chunks_that_all_overlap_are_read_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let head = [&b"\x89MCAP0\r\n"[..], &record(1, &[text(""), text("x")].concat())].concat();
    // 30,000 chunks of a frame each, all of one moment.
    let chunk = packed(&batches(&[b"\x08\x01\x10\x01\x1a\x01\x00\x22\x00\x2a\x01\x00"]));
    let file = folder.path().join("overlap.mcap");
    std::fs::write(&file, [&head[..], &chunk.repeat(30_000)].concat()).unwrap();
    let output = survives(1, &file, "chunks of one moment");
    let lines = String::from_utf8(output.stdout).unwrap().lines().count();
    assert_eq!((output.status.code(), lines), (Some(0), 30_000));
}

/// Where each record of a kind begins in a summary, and where the footer does.
fn in_summary(bytes: &[u8], wanted: u8) -> (Vec<usize>, usize) {
    let footer = bytes.len() - 8 - 29;
    let mut at = u64::from_le_bytes(bytes[footer + 9..footer + 17].try_into().unwrap()) as usize;
    let mut found = Vec::new();
    while at < footer {
        if bytes[at] == wanted {
            found.push(at);
        }
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    (found, footer)
}

#[test]
fn an_index_that_lies_never_leads_to_other_data_in_silence() {
    let folder = tempfile::tempdir().unwrap();
    for layout in [Layout::Frame, Layout::Batch] {
        let (path, bytes) = sound(folder.path(), layout);
        let expected = bustape(args(&[&"cat", &"-N", &path])).expect(0).out;
        let (indexes, footer) = in_summary(&bytes, 8);
        assert!(indexes.len() > 2, "{} chunks", indexes.len());
        let (start, length) = (9 + 16, 9 + 24);
        let word = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        // Somewhere else, behind the end, in another chunk, over another one, of no size.
        let other = word(indexes[1] + start);
        let lies =
            [(start, 8), (start, u64::MAX), (start, other), (start, word(indexes[0] + start) + 1)];
        let sizes = [(length, 0), (length, 1 << 40), (length, word(indexes[0] + length) * 2)];
        let lies =
            indexes.iter().flat_map(|at| lies.iter().chain(&sizes).map(move |lie| (*at, *lie)));
        several(lies.enumerate().collect(), |(number, (at, (field, value)))| {
            let mut bytes = bytes.clone();
            bytes[at + field..at + field + 8].copy_from_slice(&value.to_le_bytes());
            // The checksum of the summary vouches for the lie.
            let summary =
                u64::from_le_bytes(bytes[footer + 9..footer + 17].try_into().unwrap()) as usize;
            let crc = crc32fast::hash(&bytes[summary..footer + 25]);
            bytes[footer + 25..footer + 29].copy_from_slice(&crc.to_le_bytes());
            let file = folder.path().join(format!("{}-{number}.mcap", layout.name()));
            std::fs::write(&file, &bytes).unwrap();
            survives(2, &file, "an index that lies");
            let ran = bustape(args(&[&"cat", &"-N", &file]));
            let same = ran.out == expected;
            assert!(same || ran.status.code() != Some(0), "{field} = {value}: {}", ran.err);
        });
    }
}

#[test]
fn more_definitions_than_there_can_be_and_two_of_one_number_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let schema = |id: u16, name: &str| {
        let body = [&id.to_le_bytes()[..], &text(name), &text("protobuf"), &[0; 4]].concat();
        record(3, &body)
    };
    let channel = |id: u16, schema: u16, topic: &str| {
        let head = [id.to_le_bytes(), schema.to_le_bytes()].concat();
        record(4, &[&head[..], &text(topic), &text("protobuf"), &[0; 4]].concat())
    };
    let message = |channel: u16| {
        let mut body = channel.to_le_bytes().to_vec();
        body.extend_from_slice(&[0; 4]);
        body.extend_from_slice(&[START.to_le_bytes(), START.to_le_bytes()].concat());
        record(5, &body)
    };
    let all: Vec<u8> = (0..=u16::MAX).flat_map(|id| channel(id, 1, &format!("/{id}"))).collect();
    let cases = [
        ("all", [schema(1, "a.B"), all, message(7)].concat()),
        ("schema0", [schema(0, "a.B"), channel(1, 0, "/a"), message(1)].concat()),
        (
            "twice",
            [schema(1, "a.B"), channel(1, 1, "/a"), channel(1, 1, "/b"), message(1)].concat(),
        ),
        ("schemas", [schema(1, "a.B"), schema(1, "a.C"), channel(1, 1, "/a"), message(1)].concat()),
        ("none", [channel(1, 9, "/a"), message(1), message(2)].concat()),
    ];
    for (name, records) in cases {
        let mut chunk = Vec::new();
        for number in [START, START, records.len() as u64] {
            chunk.extend_from_slice(&number.to_le_bytes());
        }
        chunk.extend_from_slice(&[0; 4]);
        chunk.extend_from_slice(&text(""));
        chunk.extend_from_slice(&(records.len() as u64).to_le_bytes());
        chunk.extend_from_slice(&records);
        let head = record(1, &[text(""), text("somebody")].concat());
        let file = folder.path().join(format!("{name}.mcap"));
        std::fs::write(&file, [b"\x89MCAP0\r\n", &head[..], &record(6, &chunk)].concat()).unwrap();
        for which in 0..6 {
            survives(which, &file, name);
        }
    }
}

/// Eight thousand signals behind a switch that is itself behind 120,000 ranges.
#[test]
fn a_database_of_many_ranges_is_loaded_in_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.dbc");
    let signal = |name: &str, bits: &str| format!(" SG_ {name} : {bits}@1+ (1,0) [0|0] \"\" Y\n");
    let mut text =
        format!("BO_ 291 A: 64 X\n{}{}", signal("S0 M", "0|32"), signal("S1 m0M", "32|32"));
    for number in 0..8000 {
        text += &signal(&format!("s{number} m{number}"), "64|8");
    }
    let ranges: Vec<String> = (0..120_000).map(|n| format!("{0}-{0}", 2 * n)).collect();
    writeln!(text, "SG_MUL_VAL_ 291 S1 S0 {};", ranges.join(",")).unwrap();
    for number in 0..8000 {
        writeln!(text, "SG_MUL_VAL_ 291 s{number} S1 {number}-{number};").unwrap();
    }
    std::fs::write(&path, text).unwrap();
    let begun = std::time::Instant::now();
    let ran = bustape(args(&[&"protocols", &"check", &path])).expect(0);
    assert!(ran.out.contains("8,002 signals"), "{}", ran.out);
    assert!(begun.elapsed() < std::time::Duration::from_secs(3), "{:?}", begun.elapsed());
}
