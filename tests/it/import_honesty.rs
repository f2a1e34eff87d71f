//! `bustape import`: nothing is made up, cut short, moved or joined without a word.

use std::fs;
use std::path::PathBuf;

use crate::support::capture::{CAN, Capture, Mdf, SERIAL, can, serial};
use crate::support::mcap;
use crate::support::process::{Ran, args, bustape};

struct Logs(tempfile::TempDir);

impl Logs {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Imports logs with these contents as `out.mcap`.
    fn import(&self, logs: &[&[u8]]) -> Ran {
        fs::remove_file(self.path("out.mcap")).ok();
        let mut all = args(&[&"import", &"-o", &self.path("out.mcap")]);
        for (number, content) in logs.iter().enumerate() {
            fs::write(self.path(&number.to_string()), content).unwrap();
            all.push(self.path(&number.to_string()).into());
        }
        bustape(all)
    }

    fn cat(&self) -> String {
        bustape(args(&[&"cat", &self.path("out.mcap")])).expect(0).out
    }
}

/// 21 bytes a record, blocks of 1000 bytes, of which the second cannot be read.
fn with_a_hole() -> Vec<u8> {
    let mut file = Mdf::new();
    let mut first = file.channel(0, "CAN_DataFrame.DataBytes", (0, 10, 13, 64));
    first = file.channel(first, "CAN_DataFrame.DataLength", (0, 0, 12, 8));
    first = file.channel(first, "CAN_DataFrame.ID", (0, 0, 8, 32));
    first = file.channel(first, "Timestamp", (2, 0, 0, 64));
    let mut about = [0_u64, 200].map(u64::to_le_bytes).concat();
    about.extend([0; 8]);
    about.extend([21_u32, 0].iter().flat_map(|size| size.to_le_bytes()));
    let group = file.add(b"##CG", &[0, first, 0, 0, 0, 0], &about);
    let record = |number: u64| {
        let mut record = number.to_le_bytes().to_vec();
        record.extend((0x100 + number as u32).to_le_bytes());
        record.push(8);
        record.extend([number as u8; 8]);
        record
    };
    let records: Vec<u8> = (0..200).flat_map(record).collect();
    let blocks: Vec<u64> =
        records.chunks(1000).map(|piece| file.add(b"##DT", &[], piece)).collect();
    file.0[blocks[1] as usize..][..4].copy_from_slice(b"##XX");
    let mut about = vec![0; 4];
    about.extend((blocks.len() as u32).to_le_bytes());
    about.resize(8 + 8 * blocks.len(), 0);
    let list = file.add(b"##DL", &[&[0][..], &blocks].concat(), &about);
    let data_group = file.add(b"##DG", &[0, group, list, 0], &[0; 8]);
    file.finish(data_group)
}

#[test]
fn behind_a_block_of_mdf_that_cannot_be_read_no_frames_are_made_up() {
    let logs = Logs::new();
    let ran = logs.import(&[&with_a_hole()]).expect(3);
    assert!(ran.err.contains("records that are announced are missing"), "{}", ran.err);
    // 47 records are whole in the first 1000 bytes.
    let text = logs.cat();
    assert_eq!(text.lines().count(), 47, "{text}");
    for (number, line) in text.lines().enumerate() {
        let wanted = format!("{:03X}#{}", 0x100 + number, format!("{number:02X}").repeat(8));
        assert!(line.ends_with(&wanted), "{line}");
    }
}

#[test]
fn buses_of_different_names_stay_apart() {
    let logs = Logs::new();
    let log = "(1700000000.000000) é 123#11\n(1700000000.100000) è 123#22\n\
               (1700000000.200000) _ 123#33\n(1700000000.300000) é 123#44\n";
    let ran = logs.import(&[log.as_bytes()]).expect(0);
    assert!(ran.err.contains("bus \"è\" is named __2"), "{}", ran.err);
    let buses: Vec<String> =
        logs.cat().lines().map(|line| line.split(' ').nth(1).unwrap().to_owned()).collect();
    assert_eq!(buses, ["_", "__2", "__3", "_"]);
}

const CSV: &str = "time,bus,id,ext,rtr,error,fd,brs,esi,dir,dlc,data\n";

#[test]
fn a_name_of_any_length_becomes_one_of_64_characters() {
    let logs = Logs::new();
    let row = format!("1700000000.1,{},123,0,0,0,0,0,0,rx,1,11\n", "n".repeat(5000));
    logs.import(&[format!("{CSV}{row}").as_bytes()]).expect(0);
    assert!(logs.cat().contains(&format!(" {} ", "n".repeat(64))));
}

#[test]
fn a_row_whose_data_are_shorter_than_it_says_is_no_frame() {
    let logs = Logs::new();
    let rows = "1700000000.1,can0,123,0,0,0,0,0,0,rx,8,1122\n\
                1700000000.2,can0,124,0,0,0,1,0,0,rx,12,112233445566778899AABBCC\n\
                1700000000.3,can0,125,0,0,0,1,0,0,rx,9,112233445566778899AABBCC\n\
                1700000000.4,can0,126,0,0,0,0,0,0,rx,12,1122334455667788\n\
                1700000000.5,can0,127,0,0,0,0,0,0,rx,2,112233\n";
    let ran = logs.import(&[format!("{CSV}{rows}").as_bytes()]).expect(3);
    assert!(ran.err.contains("line 2: it has 2 bytes of data, but its length is 8"), "{}", ran.err);
    assert!(ran.err.contains("line 6: it has 3 bytes of data, but its length is 2"), "{}", ran.err);
    assert_eq!(logs.cat().lines().count(), 3);
}

#[test]
fn a_last_line_without_an_end_is_taken_and_told() {
    let logs = Logs::new();
    let whole = "(1700000000.000000) can0 123#1122\n";
    for last in ["(1700000000.100000) can0 123#11", "(1700000000.100000) can0 123##1AB"] {
        let ran = logs.import(&[format!("{whole}{last}").as_bytes()]).expect(0);
        assert!(ran.err.contains("may have been cut off in it"), "{last}: {}", ran.err);
        assert_eq!(logs.cat().lines().count(), 2, "{last}");
    }
    // Half a byte is none.
    let ran =
        logs.import(&[format!("{whole}(1700000000.100000) can0 123#111").as_bytes()]).expect(3);
    assert!(ran.err.contains("line 2"), "{}", ran.err);
}

#[test]
fn the_first_row_says_for_all_what_times_mean() {
    let logs = Logs::new();
    let rows = "1700000000.1,can0,123,0,0,0,0,0,0,rx,1,11\n5.0,can0,123,0,0,0,0,0,0,rx,1,22\n";
    let log = format!("{CSV}{rows}");
    fs::write(logs.path("a.csv"), log).unwrap();
    let out = logs.path("out.mcap");
    let start = "2026-11-22T03:15:00Z";
    let ran =
        bustape(args(&[&"import", &logs.path("a.csv"), &"--start", &start, &"-o", &out])).expect(0);
    assert!(!ran.err.contains("are no dates"), "{}", ran.err);
    assert!(logs.cat().contains("(1700000000.100000) can0 123#11"), "{}", logs.cat());
}

#[test]
fn times_of_a_capture_before_their_offset_are_before_it() {
    let logs = Logs::new();
    let log = Capture::new().interface(CAN, "can0", &[(14, &(-100_i64).to_le_bytes())]).packet(
        0,
        1_700_000_100_000_000_000,
        &can(0x123, &[1]),
        9,
    );
    logs.import(&[&log.0]).expect(0);
    assert_eq!(logs.cat(), "(1700000000.000000) can0 123#01\n");
}

#[test]
fn packets_without_a_time_are_told() {
    let logs = Logs::new();
    let log = Capture::new().interface(CAN, "can0", &[]).simple(&can(0x123, &[1, 2, 3]));
    let ran = logs.import(&[&log.0]).expect(0);
    assert!(ran.err.contains("1 packet(s) have no time"), "{}", ran.err);
}

#[test]
fn a_serial_packet_that_was_captured_in_part_is_counted() {
    let logs = Logs::new();
    let log = Capture::new()
        .interface(SERIAL, "rect", &[])
        .packet(0, 1_700_000_000_000_000_000, &serial(&[1, 2]), 14)
        .packet(0, 1_700_000_001_000_000_000, &serial(&[3, 4]), 200);
    let ran = logs.import(&[&log.0]).expect(3);
    assert!(ran.err.contains("not all of it was captured"), "{}", ran.err);
    assert!(logs.cat().contains("01 02") && !logs.cat().contains("03 04"));
}

/// What a log calls remote and CAN FD at once: without data it is a remote frame, else it is none.
#[test]
fn of_remote_frames_of_can_fd_all_logs_make_the_same() {
    let logs = Logs::new();
    let fd_remote = |data: &[u8]| {
        let mut packet = can(0x4000_0123, data);
        packet[5] = 4;
        packet
    };
    let log = Capture::new()
        .interface(CAN, "can0", &[])
        .packet(0, 1_700_000_000_000_000_000, &fd_remote(&[]), 8)
        .packet(0, 1_700_000_001_000_000_000, &fd_remote(&[0xAB]), 9);
    logs.import(&[&log.0]).expect(0);
    let wanted = "(1700000000.000000) can0 123#R\n(1700000001.000000) can0 123##4AB\n";
    assert_eq!(logs.cat(), wanted);
    let rows =
        "1700000000.0,can0,123,0,1,0,1,0,0,rx,0,\n1700000001.0,can0,123,0,1,0,1,0,0,rx,1,AB\n";
    logs.import(&[format!("{CSV}{rows}").as_bytes()]).expect(0);
    assert_eq!(logs.cat(), wanted);
}

#[test]
fn a_report_that_cannot_be_printed_is_an_error_and_no_crash() {
    let logs = Logs::new();
    fs::write(logs.path("a.log"), "(1700000000.000000) can0 123#11\n").unwrap();
    fs::write(logs.path("a.dbc"), "BO_ 291 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n").unwrap();
    let run = |command: &[&str], out: &str| {
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", "exec \"$0\" \"$@\" >/dev/full", crate::support::process::BUSTAPE]);
        shell.args(command).arg(logs.path("a.log")).arg("-o").arg(logs.path(out));
        crate::support::process::spawn(shell).wait()
    };
    let dbc = logs.path("a.dbc");
    let tables = ["export", "--json", "--format", "jsonl", "--decode", dbc.to_str().unwrap()];
    for (command, out) in [
        (&["import", "--json"][..], "a.mcap"),
        (&tables, "a.jsonl"),
        (&["export", "--json", "--format", "asc"], "a.asc"),
    ] {
        let ran = run(command, out).expect(1);
        assert!(ran.err.contains("cannot write to stdout"), "{command:?}: {}", ran.err);
    }
}

#[test]
fn copies_of_a_recording_tell_what_it_was_imported_from() {
    let logs = Logs::new();
    logs.import(&[b"(1700000000.000000) can0 123#11\n"]).expect(0);
    let (from, copy, decoded) =
        (logs.path("out.mcap"), logs.path("copy.mcap"), logs.path("decoded.mcap"));
    bustape(args(&[&"convert", &from, &"-o", &copy])).expect(0);
    bustape(args(&[&"decode", &from, &"--decode", &"can0=hmi-can", &"-o", &decoded]));
    for path in [from, copy, decoded] {
        assert_eq!(mcap::finished(&path).facts("bustape.import")["1.format"], "candump");
    }
}
