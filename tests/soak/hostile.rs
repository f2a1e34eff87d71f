//! What the edits begin with, and the commands that read them.

use std::path::Path;
use std::process::Command;

use super::fuzz::Kind;
use super::hostile_tests::{damage, sound};
use crate::support::bytes::{Random, noise};
use bustape::recording::writer::Layout;

/// The name of an edited recording.
pub const RECORDING: &str = "edited.mcap";

/// Puts what is to be edited into a folder.
pub fn originals(kind: Kind, folder: &Path, program: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if kind == Kind::Definitions {
        let mut files = vec![root.join("tests/it/support/decoded.dbc")];
        let built_in = |entry: std::io::Result<std::fs::DirEntry>| entry.map(|e| e.path()).ok();
        for at in ["schemas", "schemas/protocols"] {
            files.extend(
                std::fs::read_dir(root.join(at)).into_iter().flatten().filter_map(built_in),
            );
        }
        files.retain(|path| path.extension().is_some_and(|e| e == "dbc" || e == "toml"));
        assert!(files.len() > 2, "{files:?}");
        for file in files {
            std::fs::copy(&file, folder.join(file.file_name().expect("a name"))).expect("a copy");
        }
        return;
    }
    for layout in [Layout::Frame, Layout::Batch] {
        sound(folder, layout);
        let path = folder.join(format!("decoded-{}.mcap", layout.name()));
        let mut command = Command::new(program);
        command.args(["record", "can0=sim:hmi-can", "rect=sim:zhongheng-09", "--count", "40"]);
        command.args(["--decode", "can0=hmi-can", "--decode", "rect=zhongheng-09", "-o"]).arg(path);
        let status = command.args(["--layout", layout.name()]).output().expect("it records").status;
        assert!(status.success(), "{status}");
    }
    let whole = std::fs::read(folder.join("decoded-batch.mcap")).expect("just made");
    std::fs::write(folder.join("unfinished.mcap"), &whole[..whole.len() / 2]).expect("room");
}

/// Everything in a folder by its name.
pub fn read(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries =
        std::fs::read_dir(folder).expect("originals").map(|e| e.expect("an entry").path());
    let mut files: Vec<(String, Vec<u8>)> = entries
        .map(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            (name, std::fs::read(&path).expect("an original"))
        })
        .collect();
    files.sort();
    files
}

/// An original with 1 to 4 edits, and the name it gets.
pub fn edited(name: &str, bytes: &[u8], random: &mut Random) -> (&'static str, Vec<u8>) {
    let mut bytes = bytes.to_vec();
    let name = match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("dbc") => "edited.dbc",
        Some("toml") => "edited.toml",
        _ => RECORDING,
    };
    for _ in 0..=random.below(4) {
        if name != RECORDING && random.below(2) == 0 {
            edit_text(&mut bytes, random);
        } else {
            damage(&mut bytes, random);
        }
    }
    (name, bytes)
}

/// A number that is too large, a line twice, a line less, a word elsewhere.
fn edit_text(bytes: &mut Vec<u8>, random: &mut Random) {
    let lines: Vec<&[u8]> = bytes.split_inclusive(|b| *b == b'\n').collect();
    let mut lines: Vec<Vec<u8>> = lines.into_iter().map(<[u8]>::to_vec).collect();
    if lines.is_empty() {
        return;
    }
    let at = random.below(lines.len());
    match random.below(4) {
        0 => {
            const ODD: [&str; 12] = [
                "-1",
                "0",
                "64",
                "65",
                "513",
                "255",
                "4294967296",
                "18446744073709551616",
                "1e999",
                "nan",
                "-0.0000000000000000001",
                "2147483648",
            ];
            let text = String::from_utf8_lossy(&lines[at]).into_owned();
            let words: Vec<&str> =
                text.split_inclusive([' ', '|', '@', '(', ',', ')', ':', '=']).collect();
            let word = random.below(words.len());
            let mut new = String::new();
            for (index, text) in words.iter().enumerate() {
                match text.chars().next_back().filter(|_| index == word) {
                    Some(end) => new.extend([ODD[random.below(ODD.len())], &end.to_string()]),
                    None => new.push_str(text),
                }
            }
            lines[at] = new.into_bytes();
        }
        1 => {
            let again = lines[at].clone();
            lines.insert(random.below(lines.len()), again);
        }
        2 => drop(lines.remove(at)),
        _ => {
            let text = noise(random.next(), random.below(20));
            let to = random.below(lines[at].len());
            lines[at].splice(to..to, text);
        }
    }
    *bytes = lines.concat();
}

/// The command lines that read an edited file in `folder`.
pub fn commands(kind: Kind, folder: &Path) -> Vec<Vec<String>> {
    let lines: &[&str] = match kind {
        Kind::Definitions => &[
            "protocols check F.dbc",
            "protocols check F.toml",
            "protocols show F.dbc",
            "protocols show F.toml",
            "explain --json --decode F.dbc 123#DEADBEEF 00030002#35DBA94107530AC3 100##1DEADBEEFDEADBEEFDEADBEEF",
            "explain --decode F.dbc:j1939 00030002#35DBA94107530AC3 18FEF100#0102030405060708 7FF#R",
            "explain --json --decode F.toml 7E000185020013015B1C7E7E00018501000000",
            "explain --decode F.toml 7E0001850200137E7D5E7D5D7E",
        ],
        _ => &[
            "info F.mcap",
            "info --json F.mcap",
            "cat F.mcap",
            "cat --json --topics * F.mcap",
            "convert --layout batch -o O.mcap F.mcap",
            "convert --layout frame -o O.mcap F.mcap",
            "recover -o O.mcap F.mcap",
            "recover -o O.mcap F.mcap",
            "retime --offset=+1h -o O.mcap F.mcap",
            "decode --decode can0=hmi-can --decode rect=zhongheng-09 -o O.mcap F.mcap",
            "replay --rate max --to can0=trace: --to rect=trace: F.mcap",
            "export --format csv -o O F.mcap",
            "export --format parquet -o O F.mcap",
            "export --format jsonl --shape long -o O.jsonl F.mcap",
            "export --format blf -o O.blf F.mcap",
            "export --format mf4 -o O.mf4 F.mcap",
            "export --format pcapng -o O.pcapng F.mcap",
            "export --format candump -o O.log F.mcap",
        ],
    };
    let place = |word: &str| {
        let folder = folder.display();
        match word.split_once('.').unwrap_or((word, "")) {
            ("F", rest) => format!("{folder}/edited.{rest}"),
            ("O", "") => format!("{folder}/out"),
            ("O", rest) => format!("{folder}/out.{rest}"),
            _ => word.to_owned(),
        }
    };
    let line = |text: &&str| {
        std::iter::once("bustape".to_owned()).chain(text.split(' ').map(place)).collect()
    };
    lines.iter().map(line).collect()
}
