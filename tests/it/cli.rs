//! The command line: what it refuses, and what its help says.

use std::ffi::OsString;

use bustape::frame::{CanFlags, CanFrame, Frame};
use bustape::recording::writer::Layout;

use crate::support::make::{at, make};
use crate::support::process::{BUSTAPE, args, bustape, spawn};

const COMMANDS: &[&str] = &[
    "record", "info", "cat", "convert", "recover", "retime", "keep", "ports", "demo", "export",
    "import", "replay", "mark", "status",
];

#[test]
fn wrong_usage_is_refused_with_a_sentence_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let out = out.to_str().unwrap();
    let sim = "sim:hmi-can";
    for (args, sentence) in [
        (&["record", "-o", out][..], "<BUS>"),
        (&["record", sim], "<--output <FILE>|--dir <DIR>>"),
        (&["record", sim, "-o", out, "-d", "."], "cannot be used with"),
        (&["record", "sim:toaster", "-o", out], "there are sim:hmi-can and sim:zhongheng-09"),
        (&["record", "a/b=can0", "-o", out], "bus \"a/b=can0\": "),
        (&["record", "bustape=can0", "-o", out], "\"bustape\" is taken"),
        (&["record", "=can0", "-o", out], "cannot be a name"),
        (&["record", "can0@fast", "-o", out], "bus \"can0@fast\": "),
        (&["record", "/dev/ttyUSB0", "-o", out], "write it as /dev/ttyUSB0,19200,8N1"),
        (&["record", "/dev/ttyUSB0,19200,9N1", "-o", out], "`9N1`"),
        (&["record", "tap:/dev/ttyUSB0,9600", "-o", out], "needs two ports"),
        (&["record", "slcan:/dev/ttyACM0", "-o", out], "bus \"slcan:/dev/ttyACM0\": "),
        (&["record", "", "-o", out], "bus \"\": "),
        (
            &["record", sim, sim, "-o", out],
            "two buses are called hmi-can; give one of them another",
        ),
        (&["record", "a=sim:hmi-can", "a=sim:zhongheng-09", "-o", out], "two buses are called a"),
        (
            &["record", sim, "-o", out, "--duration", "soon"],
            "write it like 200ms, 90s, 1m30s or 8h",
        ),
        (&["record", sim, "-o", out, "--duration=-5s"], "write it like 200ms"),
        (&["record", sim, "-o", out, "--count", "0"], "0 is not in 1.."),
        (&["record", sim, "-o", out, "--chunk-time", "0"], "the least is 1ms"),
        (&["record", sim, "-o", out, "--split-time", "10us"], "the least is 1ms"),
        (&["record", sim, "-o", out, "--chunk-size", "1KiB"], "not between 4KiB and 16MiB"),
        (
            &["record", sim, "-o", out, "--split-size", "much"],
            "write it like 512KiB, 64MiB or 1GiB",
        ),
        (&["record", sim, "-o", out, "--split-size", "1KiB"], "the least is 64KiB"),
        (&["record", sim, "-o", out, "--queue=-1"], "is not a size"),
        (&["record", sim, "-o", out, "--receive-buffer", "2GiB"], "the most is 1GiB"),
        (&["record", sim, "-o", out, "--compression", "20"], "1..=19"),
        (&["record", sim, "-o", out, "--layout", "round"], "possible values: frame, batch"),
        (&["record", sim, "-d", ".", "--name", "a/b"], "letters, digits"),
        (&["record", sim, "-o", out, "--keep-size", "1GiB"], "cannot be used with"),
        (&["record", sim, "-o", out, "--when-full", "ring"], "cannot be used with"),
        (&["record", sim, "-d", ".", "--keep-size", "1MiB"], "the least is 4MiB"),
        (&["record", sim, "-d", ".", "--min-free", "0"], "the least is 1MiB"),
        (&["record", sim, "-d", ".", "--split-at", "week"], "possible values: hour, day"),
        (&["record", sim, "-d", ".", "--split-at", "day", "--split-time", "1h"], "cannot be used"),
        (
            &["record", sim, "-d", ".", "--keep-size", "8MiB", "--split-size", "4MiB"],
            "less than 3 segments of --split-size",
        ),
        (&["recover", "a.mcap"], "--output <OUT>|--dir <DIR>|--in-place"),
        (&["recover", "a.mcap", "-o", out, "--in-place"], "cannot be used with"),
        (&["recover", "a.mcap", "b.mcap", "-o", out], "-o takes the copy of one file"),
        (&["retime", "a.mcap"], "--output <OUT>|--dir <DIR>|--dry-run"),
        (&["retime", "a.mcap", "-o", out, "--offset", "1h", "--from-clock"], "cannot be used with"),
        (&["keep"], "<FILE>"),
        (&["info"], "<FILE>"),
        (&["cat"], "<FILE>"),
        (&["convert", "a.mcap"], "--output <FILE>"),
        (&["convert", "-o", "b.mcap"], "<FILE>"),
        (&["demo", "--duration", "0"], "the least is 1ms"),
        (&["play"], "unrecognized subcommand"),
        (&[], "Usage: bustape"),
        (&["info", "--fast", "a.mcap"], "unexpected argument"),
    ] {
        let ran = bustape(args).expect(2);
        assert!(ran.err.contains(sentence), "{args:?}: {}", ran.err);
        assert_eq!(ran.out, "", "{args:?}");
        assert!(ran.err.starts_with("error: ") || args.is_empty(), "{args:?}: {}", ran.err);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_bus_that_cannot_be_opened_is_said_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    for (bus, sentence) in [
        // Some kernels have no CAN at all.
        ("nosuchcan7", "can"),
        ("/dev/ttyNONE7,9600", "cannot open serial port /dev/ttyNONE7: there is no such device"),
        ("pty:/nowhere/at/all", "its folder does not exist"),
        ("slcan:/dev/ttyNONE7@500000", "/dev/ttyNONE7"),
    ] {
        // The one that works must not begin either.
        let ran = bustape(args(&[&"record", &"sim:hmi-can", &bus, &"-o", &out])).expect(1);
        assert!(ran.err.starts_with("error: ") && ran.err.contains(sentence), "{}", ran.err);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_protocol_of_the_other_kind_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    for (bus, protocol, sentence) in [
        ("hmi-can", "zhongheng-09", "is a CAN bus, and that is a serial protocol"),
        ("zhongheng-09", "hmi-can", "is a serial line, and that is a protocol of CAN"),
    ] {
        let (address, decode) = (format!("x=sim:{bus}"), format!("x={protocol}"));
        let command = [&"record" as &dyn AsRef<_>, &address, &"--decode", &decode, &"-o", &out];
        let ran = bustape(args(&command)).expect(2);
        assert!(ran.err.contains(&format!("--decode {decode}: x {sentence}")), "{}", ran.err);
        // So it is for what was recorded without.
        let raw = folder.path().join(format!("{bus}.mcap"));
        bustape(args(&[&"record", &address, &"-o", &raw, &"--count", &"1"])).expect(0);
        let ran = bustape(args(&[&"decode", &raw, &"--decode", &decode, &"-o", &out])).expect(2);
        assert!(ran.err.contains(&format!("--decode {decode}: x {sentence}")), "{}", ran.err);
    }
    assert!(!out.exists());
}

#[test]
fn a_full_disk_behind_stdout_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let (file, tty) = (folder.path().join("a.mcap"), folder.path().join("tty"));
    let frame = CanFrame::new(1, CanFlags::default(), &[]);
    make(&file, Layout::Frame, &["can0", "line"], &[(0, at(0, Frame::Can(frame)))]);
    let to = ["--to", &format!("line=pty:{}", tty.display())];
    for more in [
        &["info"][..],
        &["info", "--json"],
        &["replay", to[0], to[1]],
        &["replay", to[0], to[1], "--json"],
        &["replay", to[0], to[1], "--dry-run"],
        &["replay", to[0], to[1], "--dry-run", "--json"],
    ] {
        let mut command = std::process::Command::new("sh");
        command.args(["-c", "exec \"$0\" \"$@\" >/dev/full", BUSTAPE]).args(more).arg(&file);
        let ran = spawn(command).wait().expect(1);
        let said = ran.err.lines().last().unwrap_or_default();
        assert!(said.starts_with("error: ") && said.contains("No space left"), "{more:?}: {said}");
    }
}

fn help(command: &str) -> String {
    let help: Vec<OsString> = match command {
        "" => args(&[&"--help"]),
        command => args(&[&command, &"--help"]),
    };
    let ran = bustape(help).expect(0);
    assert_eq!(ran.err, "");
    ran.out
}

#[test]
fn the_help_is_as_it_was_read_last() {
    for command in [""].iter().chain(COMMANDS) {
        let name = if command.is_empty() { "bustape" } else { command };
        insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
            insta::assert_snapshot!(format!("help-{name}"), help(command));
        });
    }
}

#[test]
fn the_help_tells_the_default_and_the_unit_of_every_option() {
    for command in COMMANDS {
        let text = help(command);
        let (_, options) = text.split_once("\nOptions:\n").unwrap();
        let mut blocks: Vec<String> = Vec::new();
        for line in options.lines().take_while(|line| line.is_empty() || line.starts_with(' ')) {
            // Possible values stand deeper, each behind a dash.
            if line.trim_start().starts_with('-') && !line.starts_with("        ") {
                blocks.push(line.to_owned());
            } else {
                blocks.last_mut().unwrap().push_str(line);
            }
        }
        assert!(blocks.len() > 1, "{text}");
        for block in blocks.iter().filter(|block| block.contains(" <")) {
            let selects =
                ["--topics", "--start", "--end", "--filter", "--bus", "--message", "--signal"];
            let target = ["--output", "--dir", "--in-place", "--format", "--to "];
            let free = selects.iter().chain(&target).any(|option| block.contains(option));
            assert!(free || block.contains("[default: "), "{command}: no default in {block}");
            let units = ["<TIME>", "<SIZE>"].iter().any(|value| block.contains(value));
            let unit = ["ms", "s]", "s,", "MiB", "RFC 3339", "this time"].iter();
            assert!(
                !units || unit.clone().any(|u| block.contains(u)),
                "{command}: no unit in {block}"
            );
        }
    }
}

#[test]
fn the_version_is_the_package_s() {
    let ran = bustape(["--version"]).expect(0);
    assert_eq!(ran.out, format!("bustape {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn more_digits_than_are_taken_from_stdin_are_refused() {
    let mut shell = std::process::Command::new("sh");
    let line = "head -c 67108866 /dev/zero | tr '\\0' 0 | \"$0\" explain --decode zhongheng-09";
    shell.args(["-c", line, BUSTAPE]);
    let ran = spawn(shell).wait().expect(2);
    assert!(ran.err.contains("stdin has more than 64 MiB"), "{}", ran.err);
}
