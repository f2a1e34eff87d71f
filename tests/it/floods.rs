//! Lines on which nothing ends: bytes that are no frame, in any amount.

use std::io::Write as _;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::record::in_order;
use crate::support::process::{BUSTAPE, args, spawn};
use crate::support::terminal::open;
use crate::support::{mcap, messages, several};

/// Bytes that come again and again, and the definition of a protocol that gets nowhere with them.
pub struct Flood {
    pub name: &'static str,
    definition: &'static str,
    bytes: &'static [u8],
}

const LINES: &str = "framing = { kind = \"delimiter\", end = [10], max = 65536 }";
const SLIP: &str = "framing = { kind = \"slip\", max = 65536 }";
const COUNTED: &str = "framing = { kind = \"start_flag\", start = [0x55], length = { field = \"n\" } }\n\
                       header = [{ name = \"n\", type = \"u32\", byte_order = \"little\" }]";
const SILENCE: &str = "framing = { kind = \"silence\", gap_us = 50000, max = 65536 }";

pub const FLOODS: [Flood; 6] = [
    Flood { name: "a line that never ends", definition: LINES, bytes: b"and so on " },
    Flood { name: "escapes that escape nothing", definition: SLIP, bytes: &[0xDB] },
    Flood { name: "ends of nothing", definition: SLIP, bytes: &[0xC0] },
    Flood { name: "a frame of 4 GiB", definition: COUNTED, bytes: &[0x55, 0xFF, 0xFF, 0xFF, 0xFF] },
    Flood {
        name: "frames of every length",
        definition: COUNTED,
        bytes: &[0x55, 0x07, 0x01, 0x55, 0],
    },
    Flood { name: "no pause between frames", definition: SILENCE, bytes: b"0123456789" },
];

/// Bytes a second: more than any serial line has, and no more than a decoder takes to which every five bytes
/// are a broken frame.
pub const RATE: u64 = 4 << 20;

/// What a recorder may need beside what it has at the start, KiB: its queue, and a frame.
const MOST: u64 = 32 << 10;

/// A recorder that decodes the line records every byte of `count`, said at `rate` bytes a second; returns by how much its memory grew, KiB.
pub fn is_recorded(
    flood: &Flood,
    (count, rate): (usize, u64),
    program: &Path,
    folder: &Path,
) -> u64 {
    let (definition, out, tty) =
        (folder.join("flood.toml"), folder.join("out"), folder.join("tty"));
    std::fs::create_dir(&out).unwrap();
    let text = format!("name = \"flood\"\n{}\n", flood.definition);
    std::fs::write(&definition, text).unwrap();
    let (bus, decode) =
        (format!("line=pty:{}", tty.display()), format!("line={}", definition.display()));
    let mut command = Command::new(program);
    command.args(args(&[&"record", &bus, &"--decode", &decode, &"-d", &out, &"--json"]));
    command.args(["--split-size", "4MiB", "--layout", "batch"]);
    let running = spawn(command);
    let mut line = open(&tty);
    let base = resident(running.pid(), "VmRSS");
    let piece: Vec<u8> =
        flood.bytes.iter().copied().cycle().take(flood.bytes.len() << 12).collect();
    let started = Instant::now();
    let mut sent = 0;
    while sent < count {
        let now = &piece[..piece.len().min(count - sent)];
        line.write_all(now).unwrap();
        sent += now.len();
        let due = Duration::from_micros(sent as u64 * 1_000_000 / rate);
        std::thread::sleep(due.saturating_sub(started.elapsed()));
    }
    let grown = resident(running.pid(), "VmHWM").saturating_sub(base);
    let books = running.stop().expect(0).json()["buses"][0].clone();
    assert_eq!((&books["received"], &books["written"]), (&count.into(), &count.into()), "{books}");
    let mut said = flood.bytes.iter().copied().cycle().take(count);
    // One after the other: all of them together are more than this machine may have of memory.
    for name in crate::support::files(&out) {
        let file = mcap::finished(&out.join(name));
        in_order(&file, true);
        let recorded = messages::streams(&file, "line").0;
        let as_said = recorded.iter().all(|byte| Some(*byte) == said.next());
        assert!(as_said, "{}: other bytes were recorded", flood.name);
    }
    assert!(said.next().is_none(), "{}: the end is missing", flood.name);
    assert!(grown < MOST, "{}: memory grew by {grown} KiB", flood.name);
    grown
}

/// A field of `/proc/PID/status`, KiB.
fn resident(pid: u32, field: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(field)?.strip_prefix(':')).unwrap();
    line.trim_end_matches("kB").trim().parse().unwrap()
}

#[test]
fn bytes_that_never_become_a_frame_are_recorded_and_cost_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    several(FLOODS.iter().collect(), |flood: &Flood| {
        let folder = folder.path().join(flood.name);
        std::fs::create_dir(&folder).unwrap();
        is_recorded(flood, (8 << 20, RATE), BUSTAPE.as_ref(), &folder);
    });
}
