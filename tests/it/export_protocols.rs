//! Tables of what is more than the signals of one CAN frame: serial lines, remote messages, messages
//! of several frames, lists.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use bustape::frame::{Direction, Frame, SerialBytes};
use bustape::recording::writer::Layout;
use serde_json::{Value, json};

use crate::support::make::{at, make};
use crate::support::process::{Ran, args, bustape, spawn};
use crate::support::{files, peers};

fn data(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

/// `bustape export INPUT -o OUT ...`.
fn export(input: &Path, out: &Path, more: &[&str]) -> Ran {
    let mut all = args(&[&"export", &input, &"-o", &out, &"--force"]);
    all.extend(more.iter().map(Into::into));
    bustape(all)
}

/// JSON lines: for each bus and message its rows, values and labels in one.
fn rows(path: &Path) -> BTreeMap<(String, String), Vec<Value>> {
    let mut rows: BTreeMap<_, Vec<Value>> = BTreeMap::new();
    for line in fs::read_to_string(path).unwrap().lines() {
        let line: Value = serde_json::from_str(line).unwrap();
        let text = |key: &str| line[key].as_str().unwrap().to_owned();
        let mut row = line["signals"].clone();
        for (name, label) in line["labels"].as_object().unwrap() {
            row[format!("{name}_label")] = label.clone();
        }
        rows.entry((text("bus"), text("message"))).or_default().push(row);
    }
    rows
}

/// What a field of the sample vectors is in a table; `None` for what JSON has no number for.
fn expected(field: &Value) -> Option<Value> {
    let value = field.get("scaled").unwrap_or(&field["value"]);
    match (value, &field["type"]) {
        (Value::Object(text), _) => text.get("text").cloned(),
        (Value::String(_), kind) if kind != "text" => None,
        (value, _) => Some(value.clone()),
    }
}

fn assert_same(found: &Value, wanted: &Value, what: &str) {
    match (found.as_f64(), wanted.as_f64()) {
        (Some(found), Some(wanted)) => {
            // Floats of 32 bits are as short as they can be.
            let same = found == wanted || found as f32 == wanted as f32;
            assert!(same, "{what}: {found} for {wanted}");
        }
        _ => assert_eq!(found, wanted, "{what}"),
    }
}

/// The bytes of each sample vector come in on a line of their own.
#[test]
fn fields_and_records_of_serial_messages_are_those_of_the_sample_vectors() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let vectors = data("zhongheng-vectors.json");
    let vectors = vectors["vectors"].as_array().unwrap().iter();
    let vectors: Vec<&Value> = vectors.filter(|vector| vector["byte_order"] == "big").collect();
    let names: Vec<&str> = vectors.iter().map(|vector| vector["id"].as_str().unwrap()).collect();
    let frames = vectors.iter().enumerate().map(|(bus, vector)| {
        let wire = vector.get("wire").or_else(|| vector.get("wire_full")).unwrap();
        let data = bytes(wire.as_str().unwrap());
        let direction = Direction::Rx;
        (bus, at(bus as u64, Frame::Serial(SerialBytes { direction, data, errors: Vec::new() })))
    });
    make(&path("raw.mcap"), Layout::Frame, &names, &frames.collect::<Vec<_>>());
    let out = path("out.jsonl");
    export(&path("raw.mcap"), &out, &["--format", "jsonl", "--decode", "zhongheng-09"]).expect(0);
    let mut rows = rows(&out);
    let (mut fields, mut elements) = (0, 0);
    for (vector, name) in vectors.iter().zip(&names) {
        let mut take = |table: String| {
            let key = (String::from(*name), table);
            let rows = rows.get_mut(&key).unwrap_or_else(|| panic!("no table {key:?}"));
            rows.remove(0)
        };
        for message in vector["items"].as_array().unwrap().iter().map(|item| &item["message"]) {
            let known = ["request", "response"].contains(&message["kind"].as_str().unwrap_or(""));
            let Some(command) = message["cmd"].as_str().filter(|_| known) else { continue };
            let table = format!("{command}_{}", message["kind"].as_str().unwrap());
            let row = take(table.clone());
            let list = message["fields"].as_array().unwrap();
            for record in list.chunk_by(|a, b| a["record"] == b["record"]) {
                let index = &record[0]["record"];
                let row =
                    if index.is_null() { row.clone() } else { take(format!("{table}.records")) };
                if !index.is_null() {
                    assert_eq!(row["index"], *index, "{name} {table}");
                    elements += 1;
                }
                for field in record {
                    let what = format!("{name} {table} {}", field["name"]);
                    let Some(wanted) = expected(field) else { continue };
                    assert_same(&row[field["name"].as_str().unwrap()], &wanted, &what);
                    fields += 1;
                }
            }
        }
    }
    assert!(fields > 1000 && elements > 150, "{fields} fields, {elements} elements");
    let left =
        rows.iter().filter(|((_, table), rows)| table.contains("records") && !rows.is_empty());
    assert_eq!(left.count(), 0);
}

/// Each sequence of the samples comes in on a bus of its own.
#[test]
fn messages_of_several_can_frames_are_those_of_the_samples() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let sequences = data("hmi-can-sequences.json");
    let sequences = sequences.as_array().unwrap();
    let mut log = String::new();
    for (bus, sequence) in sequences.iter().enumerate() {
        for (number, frame) in sequence["frames"].as_array().unwrap().iter().enumerate() {
            let id = frame["id"].as_str().unwrap().trim_start_matches("0x");
            let data = frame["data"].as_str().unwrap();
            let data = if frame["rtr"] == true { "R" } else { data };
            writeln!(log, "(1700000{bus:03}.{number:06}) s{bus:02} {id}#{data}").unwrap();
        }
    }
    fs::write(path("can.log"), log).unwrap();
    let out = path("out.jsonl");
    export(&path("can.log"), &out, &["--format", "jsonl", "--decode", "hmi-can"]).expect(0);
    let mut rows = rows(&out);
    let mut registers_seen = 0;
    for (bus, sequence) in sequences.iter().enumerate() {
        let bus = format!("s{bus:02}");
        for wanted in sequence["expect"].as_array().unwrap() {
            let table = match (wanted["kind"].as_str(), wanted["setting"].as_str()) {
                (Some("request"), _) => "MODBUS_REQ".to_owned(),
                (Some(_), _) => "MODBUS_ANS".to_owned(),
                (_, Some(set)) if set.starts_with("CFG") => set.to_owned(),
                (_, setting) => format!("CONFIG_{}", setting.unwrap().to_uppercase()),
            };
            let of = rows.get_mut(&(bus.clone(), table.clone()));
            let row = of.unwrap_or_else(|| panic!("{bus}: no {table}")).remove(0);
            for (key, wanted) in wanted.as_object().unwrap() {
                match key.as_str() {
                    "assembly" | "dir" | "registers" => {}
                    "complete" => assert_eq!(row[key], json!(u8::from(*wanted == true))),
                    "bytes" => assert_eq!(row[key], wanted.as_str().unwrap().to_uppercase()),
                    // An absent field.
                    _ if wanted.is_null() => assert!(row[key].is_null(), "{bus} {key}"),
                    _ => assert_same(&row[key], wanted, &format!("{bus} {table} {key}")),
                }
            }
            for (index, wanted) in wanted["registers"].as_array().into_iter().flatten().enumerate()
            {
                let of = rows.get_mut(&(bus.clone(), format!("{table}.registers")));
                let row = of.unwrap_or_else(|| panic!("{bus}: no registers")).remove(0);
                assert_eq!(row, json!({ "index": index, "registers": wanted }), "{bus} {table}");
                registers_seen += 1;
            }
        }
    }
    assert!(registers_seen > 100, "{registers_seen}");
    let several =
        |table: &str| ["MODBUS_REQ", "MODBUS_ANS"].contains(&table.trim_end_matches(".registers"));
    let left = rows.iter().filter(|((_, table), rows)| several(table) && !rows.is_empty());
    assert_eq!(left.map(|(key, _)| key).collect::<Vec<_>>(), Vec::<&(String, String)>::new());
    let asked = rows.iter().filter(|((_, table), _)| table == "CONFIG_REQUEST");
    assert!(asked.count() >= 2);
}

/// J1939: a parameter group comes from many addresses; which one, stands in its rows.
#[test]
fn rows_of_j1939_messages_say_their_addresses() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let dbc = "BO_ 2565807870 Ask: 1 A\n SG_ What : 0|8@1+ (1,0) [0|0] \"\" B\n";
    fs::write(path("truck.dbc"), dbc).unwrap();
    let log =
        "(1.000001) can0 0CEF2A17#07\n(1.000002) can0 0CEF2A18#\n(1.000003) can0 0CEFFF19#09\n";
    fs::write(path("can.log"), log).unwrap();
    let protocol = format!("{}:j1939", path("truck.dbc").display());
    let more = ["--format", "csv", "--time", "epoch", "--decode", &protocol];
    export(&path("can.log"), &path("out"), &more).expect(0);
    let rows = fs::read_to_string(path("out/can0/Ask.csv")).unwrap();
    assert_eq!(
        rows.lines().collect::<Vec<_>>(),
        [
            "time,What,source_address,destination_address",
            "1.000001000,7,23,42",
            "1.000002000,,24,42",
            "1.000003000,9,25,255",
        ]
    );
    let only = [&more[..], &["--signal", "source_*"]].concat();
    export(&path("can.log"), &path("out"), &only).expect(0);
    let rows = fs::read_to_string(path("out/can0/Ask.csv")).unwrap();
    assert!(rows.starts_with("time,source_address\r\n1.000001000,23\r\n"), "{rows}");
}

/// A raw recording of both simulated devices, and the same decoded.
fn recordings(folder: &Path) -> [PathBuf; 2] {
    let [raw, full] = ["raw.mcap", "full.mcap"].map(|name| folder.join(name));
    let duration = "3s";
    bustape(args(&[
        &"record",
        &"can0=sim:hmi-can",
        &"rect=sim:zhongheng-09",
        &"--duration",
        &duration,
        &"-o",
        &raw,
    ]))
    .expect(0);
    let mut decode = args(&[&"decode", &raw, &"-o", &full]);
    decode.extend(args(&[&"--decode", &"can0=hmi-can", &"--decode", &"rect=zhongheng-09"]));
    bustape(decode).expect(0);
    [raw, full]
}

const DECODE: [&str; 4] = ["--decode", "can0=hmi-can", "--decode", "rect=zhongheng-09"];

#[test]
fn raw_buses_give_the_tables_that_their_decoded_recording_gives() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [raw, full] = recordings(folder.path());
    let range = ["--start", "+1s", "--end", "+2s"];
    for (format, more) in [
        ("csv", &[][..]),
        ("csv", &["--units", "--start", "+1s"]),
        ("jsonl", &[]),
        ("jsonl", &range),
        ("influx", &["--message", "*_response,MODBUS*,CFG_*"]),
        ("csv", &["--shape", "long"]),
        ("csv", &["--shape", "wide", "--every", "200ms"]),
        ("csv", &["--shape", "wide", "--fill", "mean", "--bus", "rect"]),
    ] {
        let more = [&["--format", format], more].concat();
        export(&raw, &path("raw"), &[&more[..], &DECODE].concat()).expect(0);
        export(&full, &path("full"), &more).expect(0);
        if path("raw").is_dir() {
            let names = files(&path("raw"));
            assert_eq!(names, files(&path("full")), "{more:?}");
            assert!(
                names.iter().any(|name| name == "rect/system_analogs_response.csv"),
                "{names:?}"
            );
            for name in names {
                let [a, b] =
                    ["raw", "full"].map(|of| fs::read_to_string(path(of).join(&name)).unwrap());
                assert!(a == b, "{more:?} {name}");
            }
            for of in ["raw", "full"] {
                fs::remove_dir_all(path(of)).unwrap();
            }
        } else {
            let [a, b] = ["raw", "full"].map(|of| fs::read_to_string(path(of)).unwrap());
            assert!(a.lines().count() > 3, "{a}");
            assert!(a == b, "{more:?}: {:?}", a.lines().zip(b.lines()).find(|(a, b)| a != b));
            for of in ["raw", "full"] {
                fs::remove_file(path(of)).unwrap();
            }
        }
    }
    let parquet = ["--format", "parquet", "--bus", "rect"];
    export(&raw, &path("raw"), &[&parquet[..], &DECODE].concat()).expect(0);
    export(&full, &path("full"), &parquet).expect(0);
    let names = files(&path("raw"));
    assert_eq!(names, files(&path("full")));
    for name in names {
        let [a, b] = ["raw", "full"].map(|of| fs::read(path(of).join(&name)).unwrap());
        assert!(a == b, "{name}");
    }
}

#[test]
fn a_whole_dataset_of_can_and_serial_messages_is_read_by_four_programs() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [raw, _] = recordings(folder.path());
    for format in ["parquet", "csv"] {
        let more =
            ["--format", format, "--message", "*_response,MODBUS*,CFG_*,INV*,BATMON*,CONFIG*"];
        export(&raw, &path(format), &[&more[..], &DECODE].concat()).expect(0);
    }
    let mut seen: Vec<Value> = Vec::new();
    for reader in ["duckdb", "polars", "pyarrow", "pandas"] {
        let mut python = peers::python("export_whole.py");
        python.arg(reader).arg(path("parquet")).arg(path("csv"));
        seen.push(spawn(python).wait().expect(0).json());
    }
    assert!(seen.iter().all(|other| *other == seen[0]), "{seen:?}");
    assert!(seen[0]["tables"].as_u64().unwrap() > 20, "{seen:?}");
    assert!(seen[0]["values"].as_u64().unwrap() > 500, "{seen:?}");
}
