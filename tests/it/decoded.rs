//! Decoded channels: `record --decode` and `bustape decode`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use bustape::frame::{CanFlags, CanFrame, Direction, Frame, SerialBytes, Stamped};
use bustape::recording::writer::Layout;

use crate::support::make::{SECOND, START, at, head, make, make_with};
use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::peers;
use crate::support::process::{args, bustape, spawn, start};
use crate::support::until;

const BUSES: [&str; 2] = ["can0", "rect"];

fn awkward() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/support/decoded.dbc")
}

fn data_frame(id: u32, data: &[u8]) -> Frame {
    let flags = if id > 0x7FF { CanFlags::EXTENDED } else { CanFlags::default() };
    let flags = if data.len() > 8 { flags | CanFlags::FD } else { flags };
    Frame::Can(CanFrame::new(id, flags, data))
}

/// Frames of all messages of the database and one that it does not have, of any content, some of
/// them short. The same numbers every time.
fn frames(count: u64) -> Vec<(usize, Stamped<Frame>)> {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let ids = [(0x100, 8), (0x18FF_0A7E, 8), (300, 16), (301, 12), (0x7F0, 8)];
    let frame = |number: u64| {
        let (id, length) = ids[(random() % 5) as usize];
        let mut data: Vec<u8> = (0..length).map(|_| random() as u8).collect();
        match random() % 8 {
            0 => data.truncate((random() % 9) as usize % length),
            // Where tables have their texts.
            1 => data.fill(0),
            2 => data.fill(0xFF),
            3 => data[0] = (random() % 4) as u8,
            4 => data[length - 4..]
                .copy_from_slice(&(i32::MAX ^ -((random() % 2) as i32)).to_le_bytes()),
            _ => {}
        }
        (0, at(number * 1_000_000, data_frame(id, &data)))
    };
    (0..count).map(frame).collect()
}

fn decode(from: &Path, to: &Path, with: &[String]) -> crate::support::process::Ran {
    let mut list = args(&[&"decode", &from, &"-o", &to]);
    for with in with {
        list.extend(args(&[&"--decode", with]));
    }
    bustape(list)
}

/// What every message and value of a bus is, by cantools.
fn compare(path: &Path, bus: &str) -> serde_json::Value {
    let mut command = peers::python("decoded.py");
    command.arg(path).arg(awkward()).arg(bus);
    spawn(command).wait().expect(0).json()
}

/// Everything but the decoded channels.
fn rest(file: &Mcap) -> Vec<(u64, String, Vec<u8>)> {
    let kept = file
        .messages
        .iter()
        .filter(|message| !file.channels[&message.channel].metadata.contains_key("protocol"));
    let mut kept: Vec<_> =
        kept.map(|m| (m.time, file.topic(m).to_owned(), m.data.clone())).collect();
    kept.sort();
    kept
}

/// The decoded messages and the log, by topic.
fn decoded(file: &Mcap) -> BTreeMap<String, Vec<(u64, Vec<u8>)>> {
    let mut topics: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for message in &file.messages {
        let channel = &file.channels[&message.channel];
        if channel.metadata.contains_key("protocol") || channel.topic == "/bustape/log" {
            let topic = topics.entry(channel.topic.clone()).or_default();
            topic.push((message.time, message.data.clone()));
        }
    }
    for messages in topics.values_mut() {
        messages.sort();
    }
    topics
}

#[test]
fn values_and_labels_are_those_of_cantools_also_under_awkward_names() {
    let folder = tempfile::tempdir().unwrap();
    let with = [format!("can0={}", awkward().display())];
    for layout in [Layout::Frame, Layout::Batch] {
        let path = |name: &str| folder.path().join(format!("{}-{name}", layout.name()));
        make(&path("raw"), layout, &BUSES, &frames(2_000));
        let ran = decode(&path("raw"), &path("new"), &with).expect(0);
        assert!(ran.out.starts_with("can0: decoded 1,"), "{}", ran.out);
        let seen = compare(&path("new"), "can0");
        for (what, least) in [("messages", 1_000), ("values", 4_000), ("labels", 400)] {
            assert!(seen[what].as_u64().unwrap() > least, "{seen}");
        }
        let file = mcap::finished(&path("new"));
        assert_eq!(messages::decoded(&file).count(), file.messages.len());
        let node = peers::node_reads(&path("new"));
        assert_eq!(node.messages.len(), file.messages.len());
        // A message may be called as one of our own channels; both are there.
        assert_eq!(node.count("/can0/raw_"), file.on("/can0/raw_").count() as u64);
    }
}

#[test]
fn all_that_was_there_stays_and_decoding_again_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let dbc = folder.path().join("plant.dbc");
    fs::copy(awkward(), &dbc).unwrap();
    let with = [format!("can0={}", dbc.display())];
    for layout in [Layout::Frame, Layout::Batch] {
        let path = |name: &str| folder.path().join(format!("{}-{name}", layout.name()));
        make(&path("raw"), layout, &BUSES, &frames(500));
        let before = fs::read(path("raw")).unwrap();
        decode(&path("raw"), &path("new"), &with).expect(0);
        assert!(fs::read(path("raw")).unwrap() == before, "the original was changed");
        let (old, new) = (mcap::finished(&path("raw")), mcap::finished(&path("new")));
        assert!(rest(&old) == rest(&new), "a message that was there is not the same");
        // The attachment of the same name is replaced, the other one stays.
        let names: Vec<_> = new.attachments.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, ["empty.txt", "plant.dbc"]);
        assert!(new.attachments[1].data == fs::read(awkward()).unwrap());
        let facts = new.facts("bustape.bus.can0");
        assert_eq!((&*facts["protocol"], &*facts["kind"]), ("plant.dbc", "made"));
        let python = peers::python_reads(&path("new"));
        let attached = python.file["attachments"].as_array().unwrap();
        assert!(attached.iter().any(|a| a["sha256"] == facts["definition.plant.dbc"].as_str()));
        assert_eq!(new.facts("another.tool"), old.facts("another.tool"));
        assert_eq!(new.facts("bustape.recording"), old.facts("bustape.recording"));

        let ran = decode(&path("new"), &path("again"), &with).expect(0);
        assert!(ran.err.contains("can0: its decoded channels are replaced"), "{}", ran.err);
        let again = mcap::finished(&path("again"));
        assert!(decoded(&new) == decoded(&again));
        assert_eq!(new.messages.len(), again.messages.len());
    }
}

#[test]
fn live_is_as_afterwards_on_both_kinds_of_bus() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let with = ["can0=hmi-can".to_owned(), "rect=zhongheng-09".to_owned()];
    let ran = bustape(args(&[
        &"record",
        &"can0=sim:hmi-can",
        &"rect=sim:zhongheng-09",
        &"--duration",
        &"3s",
        &"--decode",
        &with[0],
        &"--decode",
        &with[1],
        &"-o",
        &path("live.mcap"),
    ]))
    .expect(0);
    assert!(ran.out.contains("can0: decoded ") && ran.out.contains(" with hmi-can"), "{}", ran.out);
    decode(&path("live.mcap"), &path("after.mcap"), &with).expect(0);
    let (live, after) = (mcap::finished(&path("live.mcap")), mcap::finished(&path("after.mcap")));
    assert!(rest(&live) == rest(&after));
    assert!(decoded(&live) == decoded(&after), "decoded live and afterwards differ");
    let topics = decoded(&live);
    for topic in [
        "/can0/BATMON_2",
        "/can0/CONFIG_REQUEST",
        "/can0/CONFIG_SCR_FILE",
        "/rect/frames",
        "/rect/system_analogs_request",
        "/rect/system_analogs_response",
    ] {
        assert!(topics.contains_key(topic), "no {topic} in {:?}", topics.keys());
    }
    let summary = live.facts("bustape.summary");
    let count = |bus: &str| -> usize {
        let of = |topic: &&String| topic.starts_with(&format!("/{bus}/"));
        topics.iter().filter(|(topic, _)| of(topic)).map(|(_, messages)| messages.len()).sum()
    };
    assert_eq!(summary["can0.decoded"], count("can0").to_string());
    assert_eq!(summary["rect.decoded"], count("rect").to_string());
    let info = bustape(args(&[&"info", &path("live.mcap")])).expect(0).out;
    assert!(info.contains("Decoded") && info.contains("/can0/BATMON_2"), "{info}");
    let cat = args(&[&"cat", &path("live.mcap"), &"--json", &"--topics", &"/can0/INV1_1"]);
    let line = bustape(cat).expect(0).out;
    let first: serde_json::Value = serde_json::from_str(line.lines().next().unwrap()).unwrap();
    assert!(first["message"]["mode"].is_number() && first["message"]["mode_label"].is_string());
    let (python, node) =
        (peers::python_reads(&path("live.mcap")), peers::node_reads(&path("live.mcap")));
    assert_eq!(
        (python.messages.len(), node.messages.len()),
        (live.messages.len(), live.messages.len())
    );
}

#[test]
fn every_segment_has_its_definitions_and_schemas() {
    let folder = tempfile::tempdir().unwrap();
    bustape(args(&[
        &"record",
        &"can0=sim:hmi-can",
        &"-d",
        &folder.path(),
        &"--duration",
        &"3s",
        &"--split-time",
        &"1s",
        &"--decode",
        &"can0=hmi-can",
    ]))
    .expect(0);
    let mut total = 0;
    let files: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().path()).collect();
    assert!(files.len() >= 3, "{files:?}");
    for path in files {
        let file = mcap::finished(&path);
        assert_eq!(file.attachments.len(), 3, "a database, its rules, the configuration");
        assert!(file.facts("bustape.bus.can0").contains_key("definition.hmi-can.dbc"));
        assert_eq!(messages::decoded(&file).count(), file.messages.len());
        total += decoded(&file).values().map(Vec::len).sum::<usize>();
    }
    assert!(total > 150, "{total}");
}

#[test]
fn a_recording_that_was_cut_off_is_decoded_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let running = start(args(&[
        &"record",
        &"can0=sim:hmi-can",
        &"-o",
        &path("a.mcap"),
        &"--chunk-time",
        &"10ms",
    ]));
    until("some frames", || {
        let size = fs::metadata(path("a.mcap.part")).map_or(0, |about| about.len());
        (size > 20_000).then_some(())
    });
    running.kill();
    let with = ["can0=hmi-can".to_owned()];
    let ran = decode(&path("a.mcap.part"), &path("b.mcap"), &with);
    assert!(matches!(ran.status.code(), Some(0 | 3)), "{ran:?}");
    assert!(ran.err.contains("was not finished"), "{}", ran.err);
    assert!(mcap::finished(&path("b.mcap")).on("/can0/BATMON_2").count() > 0);
}

/// A wrong check, bytes of no frame, and an answer that nobody asked for.
#[test]
fn what_is_wrong_on_a_serial_line_is_counted_and_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let bytes = |nanos, data: &[u8]| {
        let (direction, data) = (Direction::Rx, data.to_vec());
        (1, at(nanos, Frame::Serial(SerialBytes { direction, data, errors: Vec::new() })))
    };
    let good = [0x7E, 0x00, 0x01, 0x86, 0x01, 0xFF, 0x17, 0xB0];
    let mut wrong = good;
    wrong[5] = 0xFE;
    let frames = [
        bytes(0, &good[..3]),
        bytes(5_000_000, &good[3..]),
        bytes(SECOND, b"noise"),
        bytes(3 * SECOND, &wrong),
        bytes(3 * SECOND + 1, &wrong),
        bytes(5 * SECOND, &good),
    ];
    make(&path("raw"), Layout::Frame, &BUSES, &frames);
    let ran = decode(&path("raw"), &path("new"), &["rect=zhongheng-09".to_owned()]).expect(0);
    assert!(ran.out.contains("3 invalid"), "{}", ran.out);
    let file = mcap::finished(&path("new"));
    let items: Vec<_> = file.on("/rect/frames").map(|m| m.time - START).collect();
    assert_eq!(items, [0, SECOND, 3 * SECOND, 3 * SECOND + 1, 5 * SECOND]);
    assert_eq!(file.on("/rect/link_reply").count(), 2);
    let cat = args(&[&"cat", &path("new"), &"--json", &"--topics", &"/bustape/log"]);
    let log = bustape(cat).expect(0).out;
    assert!(log.contains("5 bytes outside of any frame"), "{log}");
    assert!(log.contains("wrong check: 0x17b0 received") && log.contains("rect/link"), "{log}");
    assert_eq!(log.lines().count(), 3, "{log}");
}

/// J1939: the message of a parameter group comes from many addresses; which one, stands in it.
#[test]
fn addresses_of_j1939_are_fields() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let frames = [0x0CEF_2A17, 0x0CEF_2A18].map(|id| (0, at(u64::from(id), data_frame(id, &[7]))));
    let dbc = "BO_ 2565807870 Ask: 1 A\n SG_ What : 0|8@1+ (1,0) [0|0] \"\" B\n";
    fs::write(path("truck.dbc"), dbc).unwrap();
    make(&path("raw"), Layout::Frame, &BUSES, &frames);
    let with = format!("can0={}:j1939", path("truck.dbc").display());
    decode(&path("raw"), &path("new"), &[with]).expect(0);
    let file = mcap::finished(&path("new"));
    assert_eq!(file.facts("bustape.bus.can0")["protocol"], "truck.dbc:j1939");
    let of_message = messages::decoded(&file).filter(|(m, _)| file.topic(m) == "/can0/Ask");
    let seen: Vec<_> = of_message.map(|(_, decoded)| messages::as_python(&decoded)).collect();
    let one = |source| {
        serde_json::json!({
            "What": 7, "source_address": source, "destination_address": 0x2A
        })
    };
    assert_eq!(seen, [one(0x17), one(0x18)]);
}

/// More messages than a file has room for channels: the bus is not decoded any more, but nothing
/// of it is lost, and the other bus is decoded on.
#[test]
fn a_decoder_that_fails_does_not_harm_the_recording() {
    const MESSAGES: u32 = 60_100;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut dbc = String::new();
    for id in 0..MESSAGES {
        writeln!(dbc, "BO_ {} M{id}: 1 A", 0x8000_0000 | (0x1000 + id)).unwrap();
    }
    fs::write(path("huge.dbc"), dbc).unwrap();
    let mut frames: Vec<_> =
        (0..MESSAGES).map(|n| (0, at(u64::from(n), data_frame(0x1000 + n, &[1])))).collect();
    frames.insert(0, (1, at(0, data_frame(301, &[0; 12]))));
    frames.push((1, at(SECOND, data_frame(301, &[0; 12]))));
    make_with(&path("raw"), Layout::Batch, &head(&BUSES), &frames, &[]);
    let with =
        [format!("can0={}", path("huge.dbc").display()), format!("rect={}", awkward().display())];
    let ran = decode(&path("raw"), &path("new"), &with).expect(3);
    assert!(ran.err.contains("can0 is not decoded with huge.dbc any more"), "{}", ran.err);
    let file = mcap::finished(&path("new"));
    assert!(rest(&file).iter().filter(|(_, topic, _)| topic != "/bustape/log").count() > 0);
    assert_eq!(messages::cans(&file, "can0").len(), MESSAGES as usize);
    assert!(file.facts("bustape.summary")["can0.decode_error"].contains("60000 decoded channels"));
    assert_eq!(file.on("/bustape/log").count(), 1);
    assert_eq!(file.on("/rect/Doubles").count(), 2);
}

#[test]
fn what_makes_no_sense_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    make(&path("raw"), Layout::Frame, &BUSES, &frames(10));
    let dbc = awkward().display().to_string();
    for (with, why) in [
        (vec!["can0".to_owned()], "give BUS=PROTOCOL"),
        (vec!["can9=hmi-can".to_owned()], "there is no bus can9, only can0, rect"),
        (vec!["can0=nothing".to_owned()], "is no protocol"),
        (vec![format!("can0={dbc}"), format!("can0={dbc}")], "has a protocol already"),
    ] {
        let ran = decode(&path("raw"), &path("new"), &with).expect(2);
        assert!(ran.err.contains(why), "{}", ran.err);
        assert!(!path("new").exists() && !path("new.part").exists());
    }
    let ran = decode(&path("raw"), &path("raw"), &[format!("can0={dbc}")]).expect(1);
    assert!(ran.err.contains("exists and is not overwritten"), "{}", ran.err);
}
