//! `bustape explain` and `bustape protocols`, run as a person runs them.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::Write as _;
use std::process::{Command, Output, Stdio};

use serde_json::{Value, json};

fn bustape(args: &[&str], stdin: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_bustape"))
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(stdin.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

fn lines(output: &Output) -> Vec<Value> {
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_short_frame_says_what_it_has_and_what_is_absent() {
    let output = bustape(&["explain", "--decode", "hmi-can", "--json", "00030002#F566B241"], "");
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(
        lines(&output),
        [json!({
            "time": null, "bus": null, "id": "0x00030002", "ext": true, "rtr": false,
            "message": "BATMON_2", "dir": "ctrl-to-hmi", "check": "short",
            "signals": { "voltage": 22.300_271_987_915_04 }, "labels": {}, "absent": ["current"],
            "extra": "", "data": "f566b241",
        })]
    );
}

#[test]
fn lines_of_candump_are_read_in_all_its_formats() {
    let stdin = "(1782097200.123456) can0 00070000#01\n\
        (1782097200.123456) can0 00070000#01 T\n\
        \x20 can0  00070000   [1]  01\n\
        \x20(2026-06-22 03:00:00.123456)  can0  00070000   [1]  01\n\
        # a comment\n\n\
        \x20 can0  00130000   [0]  remote request\n\
        123##1AABB\n\
        20000004#0000000000000000\n";
    let output = bustape(&["explain", "--decode", "hmi-can", "--json"], stdin);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let all = lines(&output);
    assert_eq!(all.len(), 7);
    for line in &all[..4] {
        assert_eq!(line["labels"], json!({ "InvCtrlCmnd": "On" }));
        assert_eq!(line["dir"], "hmi-to-ctrl");
        assert_eq!(line["bus"], "can0");
    }
    for line in [&all[0], &all[1], &all[3]] {
        assert_eq!(line["time"], "2026-06-22T03:00:00.123456000Z");
    }
    assert_eq!((&all[4]["rtr"], &all[4]["message"]), (&json!(true), &json!("CONFIG_REQUEST")));
    assert_eq!((&all[5]["id"], &all[5]["data"]), (&json!("0x123"), &json!("aabb")));
    assert_eq!((&all[6]["error"], &all[6]["message"]), (&json!(true), &Value::Null));
}

#[test]
fn what_is_no_frame_is_said_and_skipped() {
    let stdin = "nonsense\n00070000#01\n12345#00\n123#0\n123#001122334455667788\n";
    let output = bustape(&["explain", "--decode", "hmi-can", "--json"], stdin);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(lines(&output).len(), 1);
    let said = String::from_utf8(output.stderr).unwrap();
    for line in [1, 3, 4, 5] {
        assert!(said.contains(&format!("line {line} of stdin is no frame")), "{said}");
    }
    let typed = bustape(&["explain", "--decode", "hmi-can", "nonsense"], "");
    assert_eq!(typed.status.code(), Some(2));
}

#[test]
fn check_lists_oddities_and_its_status_says_whether_all_was_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.dbc");
    let check = |text: &str| {
        std::fs::write(&path, text).unwrap();
        bustape(&["protocols", "check", path.to_str().unwrap()], "")
    };
    let good = "BO_ 16 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n";
    assert_eq!(check(good).status.code(), Some(0));
    let lossy = check(&format!("{good} SG_ bad : 0|0@1+ (1,0) [0|0] \"\" Y\n"));
    assert_eq!(lossy.status.code(), Some(3));
    assert!(String::from_utf8(lossy.stdout).unwrap().contains("odd.dbc:3: SG_: signal \"bad\""));
    assert_eq!(check("no database").status.code(), Some(1));
    assert_eq!(bustape(&["protocols", "check", "what"], "").status.code(), Some(2));
    assert_eq!(bustape(&["protocols", "check", "hmi-can"], "").status.code(), Some(0));
}
