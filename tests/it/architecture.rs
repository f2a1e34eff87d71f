//! The arrows between the parts of the source.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// For each part what it may use: all that there is to know about where a change can have effects.
const ARROWS: &[(&str, &[&str])] = &[
    ("frame", &[]),
    ("clock", &["frame"]),
    ("text", &["frame"]),
    // System calls know nothing of what they are for.
    ("sys", &["clock"]),
    // Between capture and the writer.
    ("queue", &["frame", "clock"]),
    // Capture never touches the disk.
    ("capture", &["frame", "clock", "sys", "queue"]),
    ("recording", &["frame"]),
    ("record", &["frame", "clock", "text", "queue", "recording", "capture", "channels", "trigger"]),
    // Devices that speak do so with a permit.
    ("simulate", &["frame", "clock", "sys", "queue", "permit", "capture"]),
    // What frames mean: no files, no buses.
    // Fields of messages of several frames are written as those of serial lines.
    ("decode", &["frame", "protocol"]),
    ("protocol", &["frame"]),
    // Logs of other tools become frames; what a recording is does not matter here.
    ("import", &["frame", "text"]),
    // Tables and logs for other tools; where the frames come from does not matter here.
    ("export", &["decode", "frame", "recording", "text"]),
    // What frames mean, as messages of a recording.
    ("channels", &["frame", "decode", "protocol", "recording"]),
    // What is waited for, and what is done then.
    ("trigger", &["frame", "decode", "protocol", "recording", "text"]),
    ("address", &["capture", "frame", "simulate"]),
    // Sends what was recorded: with the addresses, ports and codecs that capture has.
    (
        "replay",
        &["frame", "clock", "text", "sys", "permit", "capture", "recording", "decode", "protocol"],
    ),
    // Where something may be sent.
    ("permit", &["sys"]),
    ("cli", &["text", "import", "record", "recording", "replay", "simulate"]),
    (
        "commands",
        &[
            "address",
            "capture",
            "channels",
            "cli",
            "clock",
            "decode",
            "export",
            "frame",
            "import",
            "permit",
            "protocol",
            "queue",
            "record",
            "recording",
            "replay",
            "simulate",
            "sys",
            "text",
            "trigger",
        ],
    ),
    ("lib", &[]),
    // Which reaches the rest as a program would that uses the library.
    ("main", &[]),
];

/// Where an arrow is there for the sake of these names only.
const ONLY: [(&str, &str, &[&str]); 3] = [
    // Sources push; what becomes of it is not theirs.
    ("capture", "queue", &["Inlet", "{Controller"]),
    ("record", "capture", &["BusFacts"]),
    // Decoded channels are messages of a recording.
    ("export", "recording", &["wire::{Field", "descriptor"]),
];

/// The source files without their tests and comments, by path below `src`.
fn sources() -> BTreeMap<PathBuf, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut sources = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                sources.insert(path.strip_prefix(&root).unwrap().to_owned(), text);
            }
        }
    }
    let mut of_tests = Vec::new();
    for (path, text) in &mut sources {
        let (code, modules) = without_tests(text);
        *text = code;
        let folder = path.parent().unwrap();
        let own = folder.join(path.file_stem().unwrap());
        for module in modules {
            of_tests.extend([folder.join(&module), own.join(&module)]);
        }
    }
    // With a test module go the modules below it.
    sources.retain(|path, _| {
        !of_tests.iter().any(|test| path == test || path.starts_with(test.with_extension("")))
    });
    assert!(sources.len() > 50, "{} source files", sources.len());
    sources
}

/// The code without comments and test modules, and the files that are test modules.
fn without_tests(text: &str) -> (String, Vec<String>) {
    let (mut code, mut files) = (String::new(), Vec::new());
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let indent = &line[..line.len() - line.trim_start().len()];
        if line.trim_start().starts_with("//") {
            continue;
        }
        if line.trim() != "#[cfg(test)]" {
            code.push_str(line);
            code.push('\n');
            continue;
        }
        let mut file = None;
        let end = format!("{indent}}}");
        for item in lines.by_ref() {
            let module = item.trim_start().strip_prefix("mod ");
            if let Some(path) = item.trim().strip_prefix("#[path = \"") {
                file = path.strip_suffix("\"]").map(str::to_owned);
            } else if let Some(name) = module.and_then(|m| m.strip_suffix(';')) {
                files.push(file.unwrap_or_else(|| format!("{name}.rs")));
                break;
            } else if item == end || item.starts_with(indent) && item.ends_with("; }") {
                break;
            }
        }
    }
    (code, files)
}

fn part(path: &Path) -> String {
    let first = path.components().next().unwrap().as_os_str().to_str().unwrap();
    first.trim_end_matches(".rs").to_owned()
}

/// Each `crate::a::b` in the code, as `a` and what follows it.
fn paths_of(code: &str) -> impl Iterator<Item = (&str, &str)> {
    code.split("crate::").skip(1).map(|rest| {
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        let (name, rest) = rest.split_at(end);
        let rest = rest.strip_prefix("::").unwrap_or("");
        (name, &rest[..rest.find([';', ')', '(', ' ', '\n', '>', ',']).unwrap_or(rest.len())])
    })
}

#[test]
fn every_arrow_between_parts_is_one_of_those_drawn() {
    for (path, code) in sources() {
        let part = part(&path);
        let arrows = ARROWS.iter().find(|(name, _)| *name == part);
        let (_, allowed) = arrows.unwrap_or_else(|| panic!("{part} has no place in ARROWS"));
        for (used, what) in paths_of(&code) {
            let macros_own = used == "Cli" || used.is_empty();
            assert!(!macros_own, "{}: write the path in full", path.display());
            let fits = used == part || allowed.contains(&used);
            assert!(fits, "{} uses {used}, which {part} may not", path.display());
            let only = ONLY.iter().find(|(from, to, _)| (*from, *to) == (part.as_str(), used));
            let fits = only.is_none_or(|(_, _, names)| names.contains(&what));
            assert!(fits, "{} uses {used}::{what}", path.display());
        }
    }
}

#[test]
fn arrows_point_one_way() {
    let mut left: Vec<_> = ARROWS.to_vec();
    // What uses nothing that is left is taken away; what then never goes is in a circle.
    while !left.is_empty() {
        let names: Vec<_> = left.iter().map(|(name, _)| *name).collect();
        left.retain(|(_, used)| used.iter().any(|name| names.contains(name)));
        let circle: Vec<_> = left.iter().map(|(name, _)| *name).collect();
        assert!(left.len() < names.len(), "in a circle or above one: {circle:?}");
    }
}

#[test]
fn unsafe_code_stands_in_one_folder() {
    for (path, code) in sources().iter().filter(|(path, _)| part(path) != "sys") {
        let word = |text: &str| {
            text.split(|c: char| !c.is_alphanumeric() && c != '_').any(|w| w == "unsafe")
        };
        let line = code.lines().find(|line| word(line));
        assert_eq!(line, None, "in {}", path.display());
    }
}

#[test]
fn nothing_outside_of_tests_panics_on_purpose() {
    for (path, code) in sources() {
        for call in
            [".unwrap()", ".expect(", "panic!(", "unreachable!(", "todo!(", "unimplemented!("]
        {
            let line = code.lines().find(|line| line.contains(call));
            assert_eq!(line, None, "in {}", path.display());
        }
    }
}

#[test]
fn the_rules_find_what_breaks_them() {
    let text = "use crate::a::B;\n// crate::c\n#[cfg(test)]\nmod tests {\n    use crate::d;\n}\n\
                #[cfg(test)]\n#[path = \"x_tests.rs\"]\nmod tests;\nfn f() { crate::e::g(1) }\n";
    let (code, files) = without_tests(text);
    assert_eq!(files, ["x_tests.rs"]);
    assert_eq!(paths_of(&code).collect::<Vec<_>>(), [("a", "B"), ("e", "g")]);
}
