//! What a database cannot say: remote messages, identifiers with two meanings, messages of several
//! frames.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::process::{Command, Stdio};

use serde_json::{Value as Json, json};

use crate::support::process::{BUSTAPE, bustape};

const SEQUENCES: &str = include_str!("../data/hmi-can-sequences.json");
const FRAMES: &str = include_str!("../data/hmi-can-frames.json");
const PAGE: &str = include_str!("../../docs/protocols.md");

/// What `explain --json` makes of lines of candump.
fn explain(protocol: &str, stdin: &str) -> Vec<Json> {
    let mut child = Command::new(BUSTAPE)
        .args(["explain", "--decode", protocol, "--json"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // Larger than what a pipe holds.
    let (mut pipe, text) = (child.stdin.take().unwrap(), stdin.to_owned());
    let writer = std::thread::spawn(move || pipe.write_all(text.as_bytes()).unwrap());
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// As candump writes it.
fn candump(frame: &Json) -> String {
    let remote = if frame["rtr"] == true { "R" } else { frame["data"].as_str().unwrap() };
    format!("{}#{remote}", &frame["id"].as_str().unwrap()[2..])
}

fn sequences() -> Vec<Json> {
    serde_json::from_str(SEQUENCES).unwrap()
}

/// Compares what was explained of a sequence with what is expected of it.
#[track_caller]
fn check(sequence: &Json, bus: &Json, explained: &[&Json]) {
    let name = &sequence["name"];
    let (together, frames): (Vec<&Json>, Vec<&Json>) =
        explained.iter().partition(|line| !line["assembly"].is_null());
    let messages: Vec<&Json> = frames.iter().map(|line| &line["message"]).collect();
    let sent = sequence["frames"].as_array().unwrap();
    let expected: Vec<&Json> = sent.iter().map(|frame| &frame["message"]).collect();
    assert_eq!(messages, expected, "{name}");
    let expected = sequence["expect"].as_array().unwrap();
    let together: Vec<Json> = together.into_iter().cloned().collect();
    let expected = expected.iter().cloned().map(|mut line| {
        (line["time"], line["bus"]) = (Json::Null, bus.clone());
        line
    });
    // Which of two is told first at the end of the input is no promise.
    let sorted = |lines: Vec<Json>| {
        let mut lines: Vec<String> = lines.into_iter().map(in_order).collect();
        lines.sort();
        lines
    };
    assert_eq!(sorted(together), sorted(expected.collect()), "{name}");
}

/// With its keys in order.
fn in_order(object: Json) -> String {
    let Json::Object(object) = object else { panic!("{object}") };
    json!(object.into_iter().collect::<BTreeMap<_, _>>()).to_string()
}

#[test]
fn each_sequence_of_frames_becomes_the_messages_that_the_protocol_says() {
    assert!(sequences().len() > 50);
    for sequence in sequences() {
        let lines = sequence["frames"].as_array().unwrap().iter().map(candump);
        let explained = explain("hmi-can", &(lines.collect::<Vec<_>>().join("\n") + "\n"));
        check(&sequence, &Json::Null, &explained.iter().collect::<Vec<_>>());
    }
}

#[test]
fn frames_of_one_bus_do_not_disturb_those_of_another() {
    // All sequences at once, each on its own bus, a frame of each in turn.
    let sequences = sequences();
    let mut lines = Vec::new();
    for turn in 0..40 {
        for (bus, sequence) in sequences.iter().enumerate() {
            if let Some(frame) = sequence["frames"].get(turn) {
                lines.push(format!("can{bus} {}\n", candump(frame)));
            }
        }
    }
    let explained = explain("hmi-can", &lines.concat());
    for (bus, sequence) in sequences.iter().enumerate() {
        let bus = json!(format!("can{bus}"));
        let own: Vec<&Json> = explained.iter().filter(|line| line["bus"] == bus).collect();
        check(sequence, &bus, &own);
    }
}

#[test]
fn every_single_frame_decodes_as_the_protocol_says() {
    let expected: Vec<Json> = serde_json::from_str(FRAMES).unwrap();
    let lines = expected.iter().enumerate();
    let lines = lines.map(|(bus, frame)| format!("can{bus} {}\n", candump(frame)));
    let explained = explain("hmi-can", &lines.collect::<String>());
    let explained = explained.iter().filter(|line| line["assembly"].is_null());
    let explained: Vec<&Json> = explained.collect();
    assert_eq!(explained.len(), expected.len());
    for (expected, explained) in expected.iter().zip(explained) {
        for key in ["message", "dir", "check", "signals", "absent", "extra", "rtr"] {
            if !expected[key].is_null() {
                assert_eq!(expected[key], explained[key], "{key} of {expected}");
            }
        }
        // Vectors of short and long frames do not have them.
        if !expected["labels"].is_null() {
            assert_eq!(expected["labels"], explained["labels"], "{expected}");
        }
    }
}

#[test]
fn an_assembly_has_the_time_of_its_last_frame() {
    let stdin = "(1.000000) can0 00130100#6161616161616161\n\
                 (1.250000) can0 00130101#0000000000000000\n\
                 (2.000000) can0 00130100#6161616161616161\n";
    let explained = explain("hmi-can", stdin);
    let times: Vec<&Json> = explained.iter().map(|line| &line["time"]).collect();
    let second = |text: &str| json!(format!("1970-01-01T00:00:0{text}0Z"));
    assert_eq!(times[2], &second("1.25000000"));
    assert_eq!(times[4], &second("2.00000000"));
    assert_eq!(explained[4]["complete"], false);
}

#[test]
fn people_see_fields_with_their_units_and_the_names_of_values() {
    let frames = ["00120000#0e00030320000300", "00120001#554e3127b99a", "00130000#R"];
    let text = bustape(["explain", "--decode", "hmi-can"].into_iter().chain(frames)).expect(0).out;
    assert!(text.contains("= MODBUS_ANS  ctrl-to-hmi  complete: 14 bytes in 2 frames"), "{text}");
    let line = |name: &str| {
        let line = text.lines().rev().find(|line| line.trim_start().starts_with(name)).unwrap();
        line.split_whitespace().skip(1).collect::<Vec<_>>().join(" ")
    };
    assert_eq!(line("length"), "14 B");
    assert_eq!(line("function"), "3 Read holding registers");
    assert_eq!(line("registers"), "20053 10033 39609");
    assert!(text.ends_with("CONFIG_REQUEST  hmi-to-ctrl  remote frame\n"), "{text}");
}

/// The first piece of the page that is written in `language`.
fn example(language: &str) -> &'static str {
    let from = PAGE.split(&format!("```{language}\n")).nth(1).unwrap();
    from.split("```").next().unwrap()
}

/// A folder with the example of the page; `rules` may change it.
fn pack(rules: impl Fn(&str) -> String) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("pack.dbc"), example("dbc")).unwrap();
    let path = folder.path().join("pack.toml");
    std::fs::write(&path, rules(example("toml"))).unwrap();
    let path = path.to_str().unwrap().to_owned();
    (folder, path)
}

#[test]
fn the_rules_of_the_documentation_do_what_the_page_says() {
    let (_folder, rules) = pack(str::to_owned);
    let checked = bustape(["protocols", "check", &rules]).expect(0).out;
    assert!(
        checked.contains("1 remote rules, 2 context rules, 2 assembly rules; 0 odd"),
        "{checked}"
    );
    let page = PAGE.split("end in\n\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let told: Json = serde_json::from_str(page).unwrap();
    let stdin = "120#0A00020164006500\n121#66006700\n\
        100#R\n100#0100\n100#0000000000000000\n\
        (1.00) can1 200#00002041\n(1.05) can1 200#00002041\n\
        (2.00) can1 200#00002041\n(2.15) can1 200#00002041\n\
        110#4142434445464748\n111#494A4B4C\n\
        (3.00) can1 120#0A00020164006500\n(4.00) can1 121#66006700\n";
    let lines = explain(&rules, stdin);
    assert_eq!(lines[2], told);
    let messages: Vec<&Json> = lines.iter().map(|line| &line["message"]).collect();
    assert_eq!(messages[3..6], [&json!("STATUS_REQUEST"), &json!("FAULT"), &json!("STATUS")]);
    let limits = ["SET_LIMIT", "LIMIT_ECHO", "SET_LIMIT", "SET_LIMIT"];
    assert_eq!(messages[6..10], limits.map(|name| json!(name)).iter().collect::<Vec<_>>());
    assert_eq!(
        (&lines[3]["dir"], &lines[7]["dir"]),
        (&json!("host-to-pack"), &json!("pack-to-host"))
    );
    assert_eq!(lines[12]["number"], "ABCDEFGHIJKL");
    let late = lines.iter().rfind(|line| line["assembly"] == "table").unwrap();
    assert_eq!((&late["complete"], &late["samples"]), (&json!(false), &json!([100, 101])));
}

#[test]
fn wrong_rules_are_refused_with_their_line() {
    let refused = |from: &str, to: &str, line: usize, said: &str| {
        assert!(example("toml").contains(from), "{from}");
        let (_folder, rules) = pack(|text| text.replacen(from, to, 1));
        let err = bustape(["protocols", "check", &rules]).expect(1).err;
        let place = format!("pack.toml, line {line}: ");
        assert!(err.contains(&place) && err.contains(said), "{place}{said}\n{err}");
        assert!(bustape(["explain", "--decode", &rules, "100#00"]).expect(1).err.contains(&place));
    };
    refused("\"FAULT\"", "\"FAULTS\"", 14, "there is no message \"FAULTS\"");
    refused("id = 0x100", "id = 0x100\nids = 3", 8, "unknown field `ids`");
    refused("sender = \"host\"", "sender = \"guest\"", 9, "expected one of the two nodes");
    refused("length = 2", "title = \"x\"", 12, "a context without a condition");
    refused("\"LIMIT_ECHO\"", "\"STATUS\"", 20, "another message \"STATUS\"");
    refused("after = \"SET_LIMIT\"", "after = \"SET\"", 22, "there is no message \"SET\"");
    refused("\"SERIAL_2\"]", "\"SERIAL_1\"]", 30, "stands twice");
    refused("number = 0x00F", "number = 0x005", 38, "neighbouring bits");
    refused("field = \"bytes\"", "field = \"byte\"", 39, "lies in the first frame");
    refused("{ cell = ", "{ flags = ", 42, "no field \"flags\" with values");
    refused("HISTORY_0.cell", "HISTORY_0.sell", 45, "there is no table");
    refused("u16[]", "text[]", 47, "expected a type with a size");
    refused("name = \"samples\"", "name = \"cell\"", 34, "used twice");
    refused("dbc = \"pack.dbc\"", "", 1, "missing field `dbc`");
    refused("dbc = \"pack.dbc\"", "dbc = \"pack.dbc\"\n[framing]", 3, "unknown field `framing`");
    let (_folder, rules) = pack(|text| text.replace("pack.dbc", "none.dbc"));
    assert!(bustape(["protocols", "check", &rules]).expect(1).err.contains("none.dbc"));
}
