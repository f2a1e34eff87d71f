//! Logs of other tools that are cut off, damaged, or made to do harm: in every format.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use bustape::import::{ImportError, Settings, format};

use super::hostile::{damage, limited};
use crate::support::bytes::Random;
use crate::support::process::{BUSTAPE, args, bustape};
use crate::support::several;

/// Change it to try other edits; `BUSTAPE_SOAK=N` tries N times as many, and every length of a file.
const SEED: u64 = 1;
const EDITS: usize = 40;

/// The formats with frames that may come from outside, and their endings.
const FORMATS: [(&str, &str); 9] = [
    ("candump", "log"),
    ("asc", "asc"),
    ("trc", "trc"),
    ("blf", "blf"),
    ("mf4", "mf4"),
    ("pcapng", "pcapng"),
    ("frames-csv", "csv"),
    ("python-can-csv", "python.csv"),
    ("hex", "txt"),
];

fn soak() -> Option<usize> {
    std::env::var("BUSTAPE_SOAK").ok()?.parse().ok()
}

/// Frames of all kinds on two buses; of a serial line where the format is one of those.
fn candump(lines: usize) -> String {
    let kinds = [
        "123#DEADBEEF R",
        "12345678#R4 T",
        "20000080#0000000000000000 R",
        "7FF##5000102030405060708090A0B R",
        "001#1122334455667788_C T",
        "000##4 R",
    ];
    let line = |n: usize| format!("(1700000000.{n:06}) can{} {}\n", n % 2, kinds[n % kinds.len()]);
    (0..lines).map(line).collect()
}

/// A small log in each format.
fn sound(folder: &Path, lines: usize) -> Vec<(String, Vec<u8>)> {
    let first = folder.join("first.log");
    fs::write(&first, candump(lines)).unwrap();
    let serial = folder.join("serial.txt");
    let bytes: String =
        (0..lines).map(|n| format!("(1700000000.{n:06}) rect rx  7E {n:02X} 7E\n")).collect();
    fs::write(&serial, bytes).unwrap();
    let export = |(format, end): &(&str, &str)| {
        let (from, out) = (if *format == "hex" { &serial } else { &first }, format!("sound.{end}"));
        let path = folder.join(&out);
        bustape(args(&[&"export", from, &"--format", format, &"-o", &path])).expect(0);
        ((*end).to_owned(), fs::read(path).unwrap())
    };
    FORMATS.iter().map(export).collect()
}

/// Reads a log to its end: how many frames it gives, and what it says was skipped.
fn read(path: &Path) -> Result<(usize, u64), ImportError> {
    let mut log = format::open(path, None, &Settings::default())?;
    let mut frames = Vec::new();
    while log.reader.read(&mut frames)? {}
    Ok((frames.len(), log.reader.skipped().count))
}

#[test]
fn a_log_cut_off_anywhere_gives_no_more_than_it_had() {
    let folder = tempfile::tempdir().unwrap();
    let step = if soak().is_some() { 1 } else { 5 };
    let lines = 60;
    several(sound(folder.path(), lines), |(end, bytes)| {
        let path = folder.path().join(format!("cut.{end}"));
        for length in (0..bytes.len()).step_by(step) {
            fs::write(&path, &bytes[..length]).unwrap();
            // Nothing at all, or too little to know the format, is an error with a sentence.
            let Ok((frames, skipped)) = read(&path) else { continue };
            assert!(frames <= lines, "{length} bytes of {end}: {frames} frames");
            // Text can end with any line and pcapng with any block; the others know how much they had.
            let knows = matches!(end.as_str(), "blf" | "mf4");
            assert!(!knows || frames == lines || skipped > 0, "{length} bytes of {end}: {frames}");
        }
        fs::write(&path, &bytes).unwrap();
        assert_eq!(read(&path).unwrap(), (lines, 0), "{end}");
    });
}

/// Imports or exports a log with little memory; it must end by itself, with a sentence.
fn survives(which: usize, log: &Path, about: &str) -> std::process::Output {
    let out = log.with_extension("out");
    let mut command = Command::new(BUSTAPE);
    match which % 3 {
        0 => command.args(["import", "-o"]).arg(&out),
        1 => command.args(["export", "--format", "candump", "-o"]).arg(&out),
        _ => command.args(["export", "--format", "mf4", "-o"]).arg(&out),
    };
    command.arg(log);
    let output = limited(command, log, about);
    fs::remove_file(&out).ok();
    output
}

#[test]
fn random_damage_to_a_log_never_crashes_its_reader_nor_takes_its_memory() {
    println!("seed {SEED}");
    let folder = tempfile::tempdir().unwrap();
    let edits = EDITS * soak().unwrap_or(1);
    several(sound(folder.path(), 60), |(end, sound)| {
        let log: PathBuf = folder.path().join(format!("edit.{end}"));
        for edit in 0..edits {
            let mut random = Random::new(SEED << 32 | edit as u64);
            let mut bytes = sound.clone();
            for _ in 0..=random.below(4) {
                damage(&mut bytes, &mut random);
            }
            // A few of them behind a compression that is sound.
            if random.below(8) == 0 {
                bytes = zstd::encode_all(&bytes[..], 1).unwrap();
            }
            fs::write(&log, bytes).unwrap();
            survives(random.below(3), &log, &format!("edit {edit} of {end}"));
        }
    });
}

#[test]
fn what_expands_to_gigabytes_stops_at_the_limit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let heads: Vec<(String, Vec<u8>)> = sound(folder.path(), 60);
    let head = |wanted: &str| heads.iter().find(|(end, _)| end == wanted).unwrap().1.clone();
    let zeros = vec![0; 1 << 20];
    for (name, head) in [("bomb.log", head("log")), ("bomb.blf", head("blf"))] {
        let mut zst = zstd::Encoder::new(Vec::new(), 1).unwrap();
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        let packers: [&mut dyn std::io::Write; 2] = [&mut zst, &mut gz];
        for out in packers {
            out.write_all(&head).unwrap();
            (0..600).for_each(|_| out.write_all(&zeros).unwrap());
        }
        for packed in [zst.finish().unwrap(), gz.finish().unwrap()] {
            let log = path(name);
            fs::write(&log, packed).unwrap();
            for which in [0, 1] {
                let output = survives(which, &log, name);
                let said = String::from_utf8(output.stderr).unwrap();
                assert_eq!(output.status.code(), Some(3), "{name}: {said}");
                assert!(said.contains("300 times its size"), "{name}: {said}");
            }
        }
    }
    // Compressed blocks of MDF that hold more, or less, than they say.
    let lines = candump(1).repeat(30_000);
    fs::write(path("many.log"), lines).unwrap();
    let many = path("many.mf4");
    bustape(args(&[&"export", &path("many.log"), &"--format", &"mf4", &"-o", &many])).expect(0);
    let whole = fs::read(&many).unwrap();
    let block = whole.windows(4).position(|id| id == b"##DZ").unwrap();
    for (field, claimed) in [
        (32, 64 << 20),
        (32, 1 << 40),
        (32, u64::MAX),
        (32, 1),
        (40, u64::MAX),
        (40, 1),
        (28, 1 << 31),
    ] {
        let mut bytes = whole.clone();
        bytes[block + field..block + field + 8].copy_from_slice(&u64::to_le_bytes(claimed));
        fs::write(&many, bytes).unwrap();
        for which in [0, 1] {
            let output = survives(which, &many, &format!("{claimed} at {field}"));
            let said = String::from_utf8(output.stderr).unwrap();
            // A block that only lies about its packed length is whole.
            let whole = field == 40 && said.contains("30,000 frames in = 30,000 written");
            let expected = if whole { Some(0) } else { Some(3) };
            assert_eq!(output.status.code(), expected, "{claimed} at {field}: {said}");
        }
    }
}
