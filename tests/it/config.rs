//! The configuration file: what it may say, what the command line overrules, what a recording keeps.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::mcap;
use crate::support::process::{BUSTAPE, Ran, args, bustape, spawn};

fn write(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("plant.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Runs `record --config FILE` with `more`.
fn configured(file: &Path, more: &[&str]) -> Ran {
    let mut all = args(&[&"record", &"--config", &file]);
    all.extend(more.iter().map(Into::into));
    bustape(all)
}

fn printed(file: &Path, more: &[&str]) -> toml::Table {
    let more: Vec<&str> = more.iter().copied().chain(["--print-config"]).collect();
    configured(file, &more).expect(0).out.parse().unwrap()
}

#[test]
fn a_recorder_works_from_its_configuration_alone_and_each_segment_says_how_it_was_made() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().to_str().unwrap();
    let file = write(
        folder.path(),
        &format!(
            "bus = [\"station=sim:hmi-can\"]\ndecode = [\"station=hmi-can\"]\ndir = \"{dir}\"\n\
             name = \"plant7\"\nlayout = \"batch\"\ncount = 400\nsplit-size = \"64KiB\"\n"
        ),
    );
    let ran = configured(&file, &["--json"]).expect(0);
    let files = ran.json()["files"].clone();
    assert!(!files.as_array().unwrap().is_empty());
    for path in files.as_array().unwrap() {
        let path = PathBuf::from(path.as_str().unwrap());
        assert!(path.file_name().unwrap().to_str().unwrap().starts_with("plant7_s0001_"));
        let segment = mcap::finished(&path);
        let recording = segment.facts("bustape.recording");
        assert_eq!(recording["layout"], "batch");
        assert_eq!(segment.facts("bustape.bus.station")["protocol"], "hmi-can");
        let attached = segment.attachments.iter().find(|a| a.name == "bustape.toml").unwrap();
        assert_eq!(attached.media_type, "application/toml");
        let text = String::from_utf8(attached.data.clone()).unwrap();
        let said: toml::Table = text.parse().unwrap();
        assert_eq!(said["count"].as_integer(), Some(400));
        assert_eq!(said["sync"].as_str(), Some("1s"), "defaults are said too");
        // Its checksum is that of the very bytes.
        let saved = folder.path().join("attached.toml");
        std::fs::write(&saved, &text).unwrap();
        let sum = spawn({
            let mut command = Command::new("sha256sum");
            command.arg(&saved);
            command
        });
        let sum = sum.wait().expect(0).out;
        assert_eq!(Some(recording["configuration.bustape.toml"].as_str()), sum.split(' ').next());
    }
}

#[test]
fn the_command_line_overrules_the_file_and_what_it_excludes() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(
        folder.path(),
        "bus = [\"a=sim:hmi-can\"]\ndecode = [\"a=hmi-can\"]\ndir = \"/nowhere\"\nkeep-size = \"4GiB\"\n\
         split-time = \"2h\"\nhardware-timestamps = true\n",
    );
    let all = printed(&file, &[]);
    assert_eq!(all["keep-size"].as_str(), Some("4GiB"));
    assert_eq!(all["hardware-timestamps"].as_bool(), Some(true));
    let one = printed(&file, &["--keep-size", "5GiB"]);
    assert_eq!(one["keep-size"].as_str(), Some("5GiB"));
    assert_eq!(one["split-time"].as_str(), Some("2h"));
    // Into one file nothing is deleted, and other buses are not decoded with what these need.
    let other = printed(&file, &["b=sim:hmi-can", "-o", "x.mcap", "--split-at", "day"]);
    assert_eq!(other["bus"].as_array().unwrap()[0].as_str(), Some("b=sim:hmi-can"));
    assert_eq!(other["decode"].as_array().unwrap().len(), 0);
    for gone in ["dir", "keep-size", "split-time"] {
        assert!(!other.contains_key(gone), "{gone}: {other}");
    }
}

#[test]
fn what_is_printed_can_be_fed_back() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(
        folder.path(),
        "bus = [\"a=sim:hmi-can\"]\ndir = \".\"\nname = \"007\"\ncount = 7\nkeep-time = \"720h\"\n",
    );
    let first = configured(&file, &["--print-config"]).expect(0).out;
    let again = write(folder.path(), &first);
    assert_eq!(configured(&again, &["--print-config"]).expect(0).out, first);
    assert!(first.contains("name = \"007\"") && first.contains("count = 7"), "{first}");
    // Every option is there, with what it means.
    let help = bustape(["record", "--help"]).out;
    let ours = ["config", "print-config", "json", "help"];
    for option in help.split_whitespace().filter_map(|word| word.strip_prefix("--")) {
        let option = option.trim_end_matches(|c: char| !c.is_alphanumeric());
        let known = first
            .lines()
            .any(|line| line.trim_start_matches("# ").starts_with(&format!("{option} = ")));
        assert!(known || ours.contains(&option), "{option} is missing:\n{first}");
    }
}

#[test]
fn without_a_bus_a_template_is_printed_that_needs_nothing_but_a_bus_and_a_place() {
    let folder = tempfile::tempdir().unwrap();
    let print = |text: &str| {
        let file = write(folder.path(), text);
        configured(&file, &["--print-config"]).expect(0).out
    };
    let template = print("");
    let table: toml::Table = template.parse().unwrap();
    assert_eq!(table["bus"].as_array().map(Vec::len), Some(0));
    assert!(template.contains("# [[trigger]]"), "{template}");
    let filled = template.replace("bus = []", "bus = [\"sim:hmi-can\"]");
    let filled =
        filled.replace("# dir = \"DIR\"", "dir = \".\"").replace("# count = \"N\"", "count = 20");
    assert_eq!(print(&filled), filled);
    // Also the trigger in it is one.
    let (_, trigger) = template.split_once("# [[trigger]]").unwrap();
    let trigger = format!("[[trigger]]{trigger}").replace("\n# ", "\n");
    let ready = format!("{}\n{}", filled.replace("sim:hmi-can", "a=sim:hmi-can"), trigger);
    let ready = ready.replace("decode = []", "decode = [\"a=hmi-can\"]");
    let table: toml::Table = print(&ready).parse().unwrap();
    assert_eq!(table["trigger"][0]["before"].as_str(), Some("60s"));
}

#[test]
fn the_user_s_file_is_found_and_overrules_nothing_that_was_typed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("bustape")).unwrap();
    let file = folder.path().join("bustape/bustape.toml");
    std::fs::write(file, "bus = [\"mine=sim:hmi-can\"]\ndir = \".\"\nsync = \"5s\"\n").unwrap();
    let mut command = Command::new(BUSTAPE);
    command.args(["record", "--print-config", "--name", "x"]);
    command.env("XDG_CONFIG_HOME", folder.path());
    let said: toml::Table = spawn(command).wait().expect(0).out.parse().unwrap();
    assert_eq!(said["bus"].as_array().unwrap()[0].as_str(), Some("mine=sim:hmi-can"));
    assert_eq!((said["sync"].as_str(), said["name"].as_str()), (Some("5s"), Some("x")));
}

#[test]
fn what_is_wrong_in_a_file_is_said_with_its_line_and_nothing_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let head = "bus = [\"a=sim:hmi-can\"]\noutput = \"never.mcap\"\n";
    for (text, sentence) in [
        (
            "splitsize = \"1GiB\"",
            "line 3: there is no key \"splitsize\"; did you mean \"split-size\"?",
        ),
        (
            "frobnicate = 1",
            "line 3: there is no key \"frobnicate\"; \"bustape record --print-config\"",
        ),
        ("json = true", "line 3: there is no key \"json\""),
        ("sync = \"soon\"", "line 3: invalid value 'soon' for '--sync <TIME>'"),
        ("layout = \"round\"", "possible values: frame, batch"),
        ("compression = 20", "line 3: invalid value '20' for '--compression <LEVEL>'"),
        ("count = [1]", "line 3: count must be a text or a number"),
        ("hardware-timestamps = \"yes\"", "line 3: hardware-timestamps must be true or false"),
        ("decode = \"a=hmi-can\"", "line 3: decode must be a list"),
        ("decode = [\"b=hmi-can\"]", "there is no bus b"),
        ("sync = \"1s\"\nsync = \"2s\"", "line 4: duplicate key"),
        ("sync = ", "line 3: "),
        ("bus = [\"-o\"]", "duplicate key"),
    ] {
        let file = write(folder.path(), &format!("{head}{text}\n"));
        let ran = configured(&file, &[]).expect(2);
        assert!(ran.err.contains(sentence), "{text}: {}", ran.err);
    }
    let file = write(folder.path(), "bus = [\"--output=x.mcap\"]\n");
    let ran = configured(&file, &[]).expect(2);
    assert!(ran.err.contains("line 1: bus must be a list of texts, none of which"), "{}", ran.err);
    let ran = configured(&folder.path().join("none.toml"), &[]).expect(1);
    assert!(ran.err.contains("cannot read the configuration"), "{}", ran.err);
}
