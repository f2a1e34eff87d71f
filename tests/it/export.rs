//! Tables of signals, read by the programs that analysts use.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::Command;

use bustape::import::Settings;
use bustape::recording::writer::Layout;
use nix::sys::signal::Signal;

use crate::support::process::{BUSTAPE, args, bustape, spawn, start, start_injected};
use crate::support::{files, line_protocol, peers, until};

/// Every kind of signal: both byte orders, signs, scales, floats, value tables, multiplexing.
const DBC: &str = r#"VERSION ""
NS_ :
BS_:
BU_: Engine Panel
BO_ 291 EngineData: 8 Engine
 SG_ Speed : 0|16@1+ (0.01,0) [0|655] "km/h" Panel
 SG_ Torque : 23|12@0- (0.5,-100) [0|0] "Nm" Panel
 SG_ Gear : 24|3@1+ (1,0) [0|7] "" Panel
 SG_ Temp : 32|8@1+ (1,-40) [-40|215] "degC" Panel
 SG_ Count : 40|24@1+ (1,0) [0|0] "" Panel
BO_ 2566844414 Muxed: 8 Engine
 SG_ Select M : 0|4@1+ (1,0) [0|15] "" Panel
 SG_ Left m0 : 8|16@1- (1,0) [0|0] "A" Panel
 SG_ Right m1 : 8|16@1- (0.1,0) [0|0] "A" Panel
 SG_ Always : 56|8@1- (1,0) [0|0] "" Panel
BO_ 512 Floats: 12 Panel
 SG_ Single : 0|32@1- (1,0) [0|0] "V" Engine
 SG_ Double : 32|64@1- (1,0) [0|0] "V" Engine
BO_ 513 Large: 8 Panel
 SG_ Whole : 0|64@1+ (1,0) [0|0] "" Engine
CM_ SG_ 291 Speed "Speed over ground";
CM_ BO_ 291 "What the engine does";
VAL_ 291 Gear 0 "Neutral" 1 "First, slow" 2 "=HYPERLINK(A1, B2)" 3 "Rev 'ers'" ;
VAL_ 2566844414 Always -1 "minus one" 5 "five" ;
SIG_VALTYPE_ 512 Single : 1;
SIG_VALTYPE_ 512 Double : 2;
"#;

/// Numbers that repeat from run to run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 11 ^ self.0 << 30
    }
}

const START: u64 = 1_700_000_000_000_000;

/// A log of candump's of `count` frames, a millisecond apart.
fn log(count: u64) -> String {
    let (mut text, mut numbers) = (String::new(), Numbers(7));
    for number in 0..count {
        let time = START + number * 1000;
        let (random, more) = (numbers.next(), numbers.next());
        let data = match number % 7 {
            0 | 1 => format!("123#{random:016X}"),
            // Shorter than declared: some signals are absent.
            2 => format!("123#{:06X}", random & 0xFF_FFFF),
            3 => {
                let select = more % 2;
                format!("18FEEFFE#0{select:X}{:014X}", random & 0xFF_FFFF_FFFF_FFFF)
            }
            4 => {
                let single = (random as f32 / 1e9).to_le_bytes();
                let double = (more as f64 / 1e7).to_le_bytes();
                let bytes = single.iter().chain(&double);
                let hex = bytes.fold(String::new(), |hex, byte| format!("{hex}{byte:02X}"));
                format!("200##0{hex}")
            }
            5 => format!("201#{random:016X}"),
            // Unknown, and a request without data.
            _ => {
                if random % 2 == 0 {
                    "7DF#0102".to_owned()
                } else {
                    "123#R8".to_owned()
                }
            }
        };
        writeln!(text, "({}.{:06}) can0 {data}", time / 1_000_000, time % 1_000_000).unwrap();
    }
    text
}

struct Inputs {
    folder: tempfile::TempDir,
}

impl Inputs {
    /// A log of so many frames, and its database.
    fn new(frames: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("car.dbc"), DBC).unwrap();
        fs::write(folder.path().join("can.log"), log(frames)).unwrap();
        // The checker takes data of CAN FD as any other.
        let plain = log(frames).replace("##0", "#");
        fs::write(folder.path().join("plain.log"), plain).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// `bustape export can.log --decode car.dbc -o OUT ...`.
    fn export(&self, out: &str, more: &[&str]) -> crate::support::process::Ran {
        self.export_from("can.log", out, more)
    }

    fn export_from(&self, input: &str, out: &str, more: &[&str]) -> crate::support::process::Ran {
        let (input, dbc, out) = (self.path(input), self.path("car.dbc"), self.path(out));
        let mut all = args(&[&"export", &input, &"--decode", &dbc, &"-o", &out]);
        all.extend(more.iter().map(Into::into));
        bustape(all)
    }

    /// The lines of a file in line protocol, as JSON; the name of the file they are in.
    fn parsed(&self, name: &str) -> &'static str {
        let lines =
            line_protocol::read(&self.path(name)).into_iter().map(|line| format!("{line}\n"));
        fs::write(self.path("lines.json"), lines.collect::<String>()).unwrap();
        "lines.json"
    }

    /// Compares with what cantools decodes; rows and values that were equal.
    fn check(&self, kind: &str, out: &str, more: &[&str]) -> (u64, u64) {
        let mut python = peers::python("export_check.py");
        python.args([self.path("car.dbc"), self.path("plain.log")]).arg(kind).arg(self.path(out));
        let said = spawn_quiet(python.args(more)).json();
        (said["rows"].as_u64().unwrap(), said["values"].as_u64().unwrap())
    }
}

fn spawn_quiet(command: &mut Command) -> crate::support::process::Ran {
    let mut owned = Command::new(command.get_program());
    owned.args(command.get_args());
    spawn(owned).wait().expect(0)
}

const FRAMES: u64 = 1400;
/// Without the unknown and the remote ones.
const ROWS: u64 = 1200;

#[test]
fn a_dataset_is_read_by_pyarrow_pandas_duckdb_and_polars_as_cantools_decodes_the_frames() {
    let inputs = Inputs::new(FRAMES);
    let ran = inputs.export("trip", &["--format", "parquet", "--json"]).expect(0);
    let said = ran.json();
    assert_eq!((&said["read"], &said["decoded"]), (&FRAMES.into(), &ROWS.into()));
    let lost = said["unknown"].as_u64().unwrap() + said["not_decoded"].as_u64().unwrap();
    assert_eq!(lost, FRAMES - ROWS);
    let names = ["EngineData", "Floats", "Large", "Muxed"];
    let names = names.map(|name| format!("bus=can0/message={name}/part-0000.parquet"));
    assert_eq!(files(&inputs.path("trip")), names);
    let kinds = [
        "Speed=double",
        "Torque=double",
        "Gear=uint8",
        "Temp=int16",
        "Count=uint32",
        "Left=int16",
        "Single=float",
        "Double=double",
        "Whole=uint64",
        "Always=int8",
        "Gear_label=dictionary<values=string, indices=int32, ordered=0>",
    ];
    let equal = inputs.check("pyarrow", "trip", &kinds);
    assert_eq!(equal.0, ROWS);
    assert!(equal.1 > 2 * ROWS);
    for reader in ["unified", "pandas", "duckdb", "polars"] {
        assert_eq!(inputs.check(reader, "trip", &[]), equal, "{reader}");
    }
}

#[test]
fn units_comments_and_the_hash_of_the_definition_are_in_the_file() {
    let inputs = Inputs::new(70);
    inputs.export("trip", &["--format", "parquet"]).expect(0);
    let file = inputs.path("trip/bus=can0/message=EngineData/part-0000.parquet");
    let said = spawn_quiet(peers::python("export_facts.py").arg(file).arg("Speed")).out;
    for line in [
        "bustape.bus=can0",
        "bustape.message=EngineData",
        "bustape.comment=What the engine does",
        "bustape.id=123",
        "bustape.definition=car.dbc",
        "bustape.unit.Speed=km/h",
        "bustape.comment.Speed=Speed over ground",
        "comment:Speed over ground",
        "unit:km/h",
    ] {
        assert!(said.lines().any(|found| found == line), "{line} is not in {said}");
    }
    let hash = said.lines().find_map(|line| line.strip_prefix("bustape.definition_sha256="));
    let mut sum = Command::new("sha256sum");
    let sum = spawn_quiet(sum.arg(inputs.path("car.dbc"))).out;
    assert_eq!(hash, sum.split_whitespace().next());
}

#[test]
fn text_formats_say_what_cantools_decodes() {
    let inputs = Inputs::new(FRAMES);
    inputs.export("trip", &["--format", "csv"]).expect(0);
    // An apostrophe keeps a label from being a formula; nothing else differs.
    let engine = inputs.path("trip/can0/EngineData.csv");
    let text = fs::read_to_string(&engine).unwrap();
    assert!(text.contains(",\"'=HYPERLINK(A1, B2)\","), "{text}");
    fs::write(&engine, text.replace("'=HYPERLINK", "=HYPERLINK")).unwrap();
    let equal = inputs.check("csv", "trip", &[]);
    assert_eq!(equal.0, ROWS);
    inputs.export("epoch", &["--format", "csv", "--time", "epoch", "--units"]).expect(0);
    let engine = fs::read_to_string(inputs.path("epoch/can0/EngineData.csv")).unwrap();
    let head =
        "time,Speed [km/h],Torque [Nm],Gear,Gear_label,Temp [degC],Count\r\n1700000000.000000000,";
    assert!(engine.starts_with(head), "{engine}");
    for (format, out) in [("jsonl", "a.jsonl"), ("influx", "a.influx")] {
        inputs.export(out, &["--format", format]).expect(0);
        let read = if format == "influx" { inputs.parsed(out) } else { out };
        assert_eq!(inputs.check(format, read, &[]), equal, "{format}");
        let stdout = inputs.path("can.log");
        let dbc = inputs.path("car.dbc");
        let all = args(&[&"export", &stdout, &"--decode", &dbc, &"--format", &format, &"-o", &"-"]);
        assert!(bustape(all).expect(0).out == fs::read_to_string(inputs.path(out)).unwrap());
    }
}

#[test]
fn other_shapes_hold_the_same_values() {
    let inputs = Inputs::new(FRAMES);
    let long = |name: &str, format: &str| {
        inputs.export(name, &["--format", format, "--shape", "long"]).expect(0);
    };
    long("long.parquet", "parquet");
    let equal = inputs.check("long", "long.parquet", &[]);
    assert_eq!(equal.0, ROWS);
    long("long.csv", "csv");
    let text = fs::read_to_string(inputs.path("long.csv")).unwrap();
    fs::write(inputs.path("long.csv"), text.replace("'=HYPERLINK", "=HYPERLINK")).unwrap();
    assert_eq!(inputs.check("long", "long.csv", &[]), equal);
    for fill in ["hold", "mean", "none"] {
        let name = format!("{fill}.parquet");
        let more = ["--format", "parquet", "--shape", "wide", "--every", "100ms", "--fill", fill];
        inputs.export(&name, &more).expect(0);
        let (rows, values) = inputs.check("wide", &name, &[fill]);
        assert_eq!((rows, values), (14, 14 * 12), "{fill}");
    }
}

#[test]
fn raw_frames_become_a_table_too() {
    let inputs = Inputs::new(70);
    let export = |format: &str, out: &str| {
        let log = inputs.path("can.log");
        let out = inputs.path(out);
        let all =
            args(&[&"export", &log, &"--format", &format, &"--shape", &"frames", &"-o", &out]);
        bustape(all).expect(0)
    };
    export("csv", "frames.csv");
    let text = fs::read_to_string(inputs.path("frames.csv")).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time,bus,id,flags,dlc,data"));
    let rows: Vec<String> = lines.map(|line| line.trim_end().to_owned()).collect();
    assert_eq!(rows.len(), 70);
    let log = log(70);
    for (row, line) in rows.iter().zip(log.lines()) {
        let cells: Vec<&str> = row.split(',').collect();
        let (id, data) = line.split_whitespace().nth(2).unwrap().split_once('#').unwrap();
        assert_eq!(cells[2].parse::<u32>().unwrap(), u32::from_str_radix(id, 16).unwrap());
        let (flags, dlc, data) = match data {
            "R8" => ("remote", "8", ""),
            data if data.starts_with("#0") => ("fd", "", &data[2..]),
            data => (if id.len() == 8 { "ext" } else { "" }, "", data),
        };
        assert_eq!(cells[3..], [flags, dlc, data], "{line}");
    }
    export("parquet", "frames.parquet");
    let mut python = peers::python("export_frames.py");
    let read = spawn_quiet(python.args([inputs.path("frames.parquet"), inputs.path("frames.csv")]));
    assert_eq!(read.out.trim(), "70");
    export("jsonl", "frames.jsonl");
    assert_eq!(fs::read_to_string(inputs.path("frames.jsonl")).unwrap().lines().count(), 70);
}

#[test]
fn recordings_decoded_or_not_give_the_same_tables_as_their_log() {
    let inputs = Inputs::new(700);
    let path = |name: &str| inputs.path(name);
    let frames = bustape::import::format::open(&path("can.log"), None, &Settings::default());
    let mut reader = frames.unwrap().reader;
    let mut frames = Vec::new();
    while reader.read(&mut frames).unwrap() {}
    let frames: Vec<_> = frames.into_iter().map(|frame| (0, frame.frame)).collect();
    for (layout, name) in [(Layout::Frame, "frame.mcap"), (Layout::Batch, "batch.mcap")] {
        crate::support::make::make(&path(name), layout, &["can0"], &frames);
        let out = format!("{name}.csv");
        inputs.export_from(name, &out, &["--format", "csv", "--shape", "long"]).expect(0);
        inputs.export("log.csv", &["--format", "csv", "--shape", "long", "--force"]).expect(0);
        assert!(fs::read(path(&out)).unwrap() == fs::read(path("log.csv")).unwrap(), "{name}");
    }
    let decode = format!("can0={}", path("car.dbc").display());
    let (raw, full) = (path("frame.mcap"), path("full.mcap"));
    bustape(args(&[&"decode", &raw, &"--decode", &decode, &"-o", &full])).expect(0);
    let out = path("full");
    bustape(args(&[&"export", &full, &"--format", &"parquet", &"-o", &out])).expect(0);
    assert_eq!(inputs.check("pyarrow", "full", &[]).0, 600);
}

#[test]
fn what_is_selected_is_exported_and_nothing_else() {
    let inputs = Inputs::new(FRAMES);
    let head = |more: &[&str]| {
        let more = [&["--format", "csv", "--shape", "long", "--force"], more].concat();
        inputs.export("some.csv", &more).expect(0);
        fs::read_to_string(inputs.path("some.csv")).unwrap()
    };
    let signals = |text: &str| {
        let mut names: Vec<_> =
            text.lines().skip(1).map(|line| line.split(',').nth(3).unwrap().to_owned()).collect();
        names.sort();
        names.dedup();
        names
    };
    assert_eq!(
        signals(&head(&["--message", "E*Data", "--signal", "T*,Gear"])),
        ["Gear", "Temp", "Torque"]
    );
    assert_eq!(signals(&head(&["--signal", "*le"])), ["Double", "Single", "Whole"]);
    let some = head(&["--start", "+100ms", "--end", "2023-11-14T22:13:20.2Z", "--signal", "Whole"]);
    let times: Vec<&str> = some.lines().skip(1).map(|line| &line[..29]).collect();
    assert_eq!(times.first(), Some(&"2023-11-14T22:13:20.103000000"));
    assert_eq!(times.len(), 14);
    let more = ["--format", "csv", "--shape", "long", "--force", "--bus", "other*"];
    let none = inputs.export("some.csv", &more).expect(3);
    assert!(none.err.contains("nothing was exported"), "{}", none.err);
}

#[test]
fn days_and_hours_get_files_of_their_own() {
    let inputs = Inputs::new(0);
    let mut text = String::new();
    // Two hours around midnight, a frame every ten minutes.
    for number in 0..12 {
        writeln!(text, "({}.0) can0 201#{number:016X}", 1_700_002_800 + 600 * number).unwrap();
    }
    fs::write(inputs.path("can.log"), &text).unwrap();
    fs::write(inputs.path("plain.log"), &text).unwrap();
    inputs.export("days", &["--format", "parquet", "--split", "day"]).expect(0);
    let days = ["part-2023-11-14-0000.parquet", "part-2023-11-15-0001.parquet"];
    assert_eq!(
        files(&inputs.path("days")),
        days.map(|day| format!("bus=can0/message=Large/{day}"))
    );
    assert_eq!(inputs.check("duckdb", "days", &[]).0, 12);
    inputs.export("hours", &["--format", "csv", "--split", "hour"]).expect(0);
    let hours = ["Large-2023-11-14T23.csv", "Large-2023-11-15T00.csv"];
    assert_eq!(files(&inputs.path("hours")), hours.map(|hour| format!("can0/{hour}")));
    inputs.export("lines", &["--format", "jsonl", "--split", "day"]).expect(0);
    assert_eq!(files(&inputs.path("lines")), ["2023-11-14.jsonl", "2023-11-15.jsonl"]);
}

#[test]
fn names_and_texts_of_a_database_can_harm_neither_a_spreadsheet_nor_a_terminal() {
    let inputs = Inputs::new(0);
    let dbc = "BO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] \"=cmd|' /C calc'!A0\" A\n\
               VAL_ 1 S 0 \"=1+1\" 1 \"+SUM(A1)\" 2 \"@x\" 3 \"a\x1b]0;b\x07\" 4 \"-2+3\" 5 \"a\u{202e}b\" ;\n";
    fs::write(inputs.path("car.dbc"), dbc).unwrap();
    let lines = (0..6).map(|n| format!("({n}.0) can0 001#{n:02X}00000000000000\n"));
    fs::write(inputs.path("can.log"), lines.collect::<String>()).unwrap();
    inputs.export("bad", &["--format", "csv", "--units"]).expect(0);
    let text = fs::read_to_string(inputs.path("bad/can0/M.csv")).unwrap();
    for (format, name) in [("jsonl", "bad.jsonl"), ("influx", "bad.influx")] {
        inputs.export(name, &["--format", format]).expect(0);
        let text = fs::read_to_string(inputs.path(name)).unwrap();
        assert!(!text.contains(['\x1b', '\x07', '\u{202e}']), "{text}");
    }
    assert!(!text.contains(['\x1b', '\x07', '\u{202e}']), "{text}");
    let labels: Vec<&str> =
        text.lines().skip(1).map(|l| l.splitn(3, ',').nth(2).unwrap()).collect();
    let safe = ["'=1+1", "'+SUM(A1)", "'@x", "\"a\\u{1b}]0;b\\u{7}\"", "'-2+3", "a\\u{202e}b"];
    assert_eq!(labels, safe);
    // A unit does not begin its cell.
    assert!(text.starts_with("time,S [=cmd|' /C calc'!A0],S_label\r\n"), "{text}");
}

#[test]
fn csv_has_the_marks_that_were_asked_for() {
    let inputs = Inputs::new(70);
    let rows = |mark: char, more: &[&str]| -> Vec<Vec<String>> {
        let long = ["--format", "csv", "--shape", "long", "--signal", "Speed,Torque", "--force"];
        inputs.export("a.csv", &[&long[..], more].concat()).expect(0);
        let text = fs::read_to_string(inputs.path("a.csv")).unwrap();
        assert!(text.ends_with("\r\n") && text.lines().count() > 30, "{text}");
        text.lines().map(|line| line.split(mark).map(str::to_owned).collect()).collect()
    };
    let plain = rows(',', &[]);
    let german = rows(';', &["--decimal", "comma"]);
    let tabs = rows('\t', &["--separator", "tab", "--time", "epoch"]);
    let epoch = rows(';', &["--decimal", "comma", "--time", "epoch"]);
    for (((plain, german), tabs), epoch) in plain.iter().zip(&german).zip(&tabs).zip(&epoch).skip(1)
    {
        assert_eq!((plain.len(), &plain[..4]), (7, &german[..4]));
        assert_eq!(plain[4].replace('.', ","), german[4]);
        assert_eq!((&plain[1..], tabs[0].replace('.', ",")), (&tabs[1..], epoch[0].clone()));
        assert!(tabs[0].starts_with("17000000") && tabs[0].len() == 20, "{tabs:?}");
    }
}

#[test]
fn nothing_to_export_is_said_with_its_reason() {
    let inputs = Inputs::new(70);
    let long = ["--format", "csv", "--shape", "long", "--force"];
    for (more, reason) in [
        (&["--message", "x*"][..], "nothing of the input is selected by --message"),
        (&["--bus", "can1", "--end", "+1s"], "is selected by --bus, --end"),
    ] {
        let ran = inputs.export("a.csv", &[&long[..], more].concat()).expect(3);
        assert!(ran.err.contains(reason), "{}", ran.err);
        let text = fs::read_to_string(inputs.path("a.csv")).unwrap();
        assert_eq!(text, "time,bus,message,signal,value,label,unit\r\n");
    }
    let (log, out) = (inputs.path("can.log"), inputs.path("a.csv"));
    let of = |protocol: &str| {
        let all = args(&[&"export", &log, &"--decode", &protocol, &"-o", &out]);
        bustape(all.into_iter().chain(long.iter().map(Into::into))).expect(3).err
    };
    assert!(of("zhongheng-09").contains("no bus has a protocol of its kind"));
    fs::write(inputs.path("other.dbc"), "BO_ 5 Other: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] \"\" A\n")
        .unwrap();
    let other = inputs.path("other.dbc");
    assert!(of(other.to_str().unwrap()).contains("the protocol knows none of the frames"));
    let out = inputs.path("no/such/folder");
    let ran =
        bustape(args(&[&"export", &log, &"--format", &"csv", &"--shape", &"frames", &"-o", &out]));
    assert!(ran.expect(1).err.contains("; create the folder"));
}

#[test]
fn what_exists_is_not_overwritten_and_force_replaces_only_exports() {
    let inputs = Inputs::new(70);
    fs::write(inputs.path("a.csv"), "mine").unwrap();
    let long = ["--format", "csv", "--shape", "long"];
    let ran = inputs.export("a.csv", &long).expect(1);
    assert!(ran.err.contains("a.csv exists and is not overwritten"), "{}", ran.err);
    assert_eq!(fs::read_to_string(inputs.path("a.csv")).unwrap(), "mine");
    inputs.export("a.csv", &[&long[..], &["--force"]].concat()).expect(0);
    assert!(fs::read_to_string(inputs.path("a.csv")).unwrap().starts_with("time,"));
    let parquet = ["--format", "parquet"];
    inputs.export("trip", &parquet).expect(0);
    inputs.export("trip", &parquet).expect(1);
    inputs.export("trip", &["--format", "parquet", "--force", "--message", "Large"]).expect(0);
    assert_eq!(files(&inputs.path("trip")).len(), 1);
    fs::write(inputs.path("trip/notes.txt"), "mine").unwrap();
    let ran = inputs.export("trip", &["--format", "parquet", "--force"]).expect(1);
    assert!(ran.err.contains("notes.txt is not the work of an export"), "{}", ran.err);
    assert!(inputs.path("trip/notes.txt").exists());
    assert!(!inputs.path("trip.part").exists());
}

#[test]
fn an_export_that_is_interrupted_leaves_nothing_that_looks_complete() {
    let inputs = Inputs::new(0);
    let fifo = inputs.path("fifo.log");
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    for (signal, format) in
        [(Signal::SIGKILL, "csv"), (Signal::SIGTERM, "csv"), (Signal::SIGINT, "parquet")]
    {
        let (dbc, out) = (inputs.path("car.dbc"), inputs.path("out"));
        let running =
            start(args(&[&"export", &fifo, &"--decode", &dbc, &"--format", &format, &"-o", &out]));
        let mut pipe = fs::File::options().write(true).open(&fifo).unwrap();
        pipe.write_all(log(70_000).as_bytes()).unwrap();
        let part = inputs.path("out.part");
        until("the export to begin", || part.exists().then_some(()));
        if format == "csv" {
            until("a file", || (!files(&part).is_empty()).then_some(()));
        }
        running.signal(signal);
        let fed = std::thread::spawn(move || {
            // What is waiting for input sees the signal with the next frames.
            for _ in 0..100 {
                if pipe.write_all(log(3000).as_bytes()).is_err() {
                    break;
                }
            }
        });
        let ran = running.wait();
        fed.join().unwrap();
        assert!(!out.exists());
        if signal == Signal::SIGKILL {
            let left = files(&part);
            assert!(
                !left.is_empty() && left.iter().all(|name| name.ends_with(".part")),
                "{left:?}"
            );
            fs::remove_dir_all(&part).unwrap();
        } else {
            let ran = ran.expect(1);
            assert!(ran.err.contains("interrupted"), "{}", ran.err);
            assert!(!part.exists());
        }
    }
}

#[test]
fn a_full_disk_is_an_error_with_the_name_of_the_file() {
    let inputs = Inputs::new(FRAMES);
    let (log, dbc) = (inputs.path("can.log"), inputs.path("car.dbc"));
    for (format, out, file) in [
        ("jsonl", "a.jsonl", "a.jsonl.part"),
        ("csv", "csv", "csv.part/can0/EngineData.csv.part"),
        ("parquet", "trip", "trip.part/bus=can0/message=Large/part-0000.parquet.part"),
    ] {
        let (path, file) = (inputs.path(out), inputs.path(file));
        let ran = start_injected(
            &["inject=write:error=ENOSPC"],
            &[&file],
            args(&[&"export", &log, &"--decode", &dbc, &"--format", &format, &"-o", &path]),
        );
        let ran = ran.wait().expect(1);
        assert!(ran.err.contains("No space left on device"), "{}", ran.err);
        let name = file.to_str().unwrap().trim_end_matches(".part").to_owned();
        assert!(ran.err.contains(&name), "{}", ran.err);
        assert!(!path.exists() && !inputs.path(&format!("{out}.part")).exists());
    }
}

#[test]
fn memory_does_not_grow_with_the_input() {
    let inputs = Inputs::new(200_000);
    let log = inputs.path("can.log");
    let peak = |format: &str, times: usize| -> u64 {
        let mut python = peers::python("peak_memory.py");
        python.arg(BUSTAPE).arg("export").args(std::iter::repeat_n(&log, times));
        python.arg("--decode").arg(inputs.path("car.dbc")).args(["--format", format, "-o"]);
        spawn_quiet(python.arg(inputs.path(&format!("{format}{times}"))))
            .out
            .trim()
            .parse()
            .unwrap()
    };
    for format in ["parquet", "csv"] {
        let (small, large) = (peak(format, 5), peak(format, 15));
        assert!(large < 64 << 10, "{format}: {large} KiB");
        assert!(large < small + (16 << 10), "{format}: {small} KiB, then {large} KiB");
    }
}

#[test]
fn combinations_without_a_meaning_are_refused_before_anything_is_written() {
    let inputs = Inputs::new(7);
    for (more, sentence) in [
        (&["--format", "influx", "--shape", "long"][..], "has one shape"),
        (&["--format", "csv", "--decimal", "comma", "--separator", ","], "another --separator"),
        (&["--format", "csv", "--shape", "frames", "--signal", "x"], "raw frames"),
        (&["--format", "csv", "--start", "2024-01-01T00:00:00Z", "--end", "5"], "--start is later"),
        (&["--format", "csv", "--decode", "hmi-can"], "every CAN bus has a protocol already"),
        (&["--format", "csv", "--decode", "can1=nothing"], "is no protocol"),
        (&["--format", "csv", "--filter", "can0,123:7FF"], "--filter is about raw frames"),
        (&["--format", "csv", "--separator", "xy"], "give one of"),
    ] {
        let ran = inputs.export("out", more).expect(2);
        assert!(ran.err.contains(sentence), "{more:?}: {}", ran.err);
    }
    let log = inputs.path("can.log");
    let ran = bustape(args(&[&"export", &log, &"--format", &"csv", &"-o", &inputs.path("out")]));
    assert!(ran.expect(2).err.contains("--decode"));
    assert!(!inputs.path("out").exists() && !inputs.path("out.part").exists());
}
