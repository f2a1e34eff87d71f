//! Every kind of frame is recorded as it was, in order, with the kernel's time.

use std::io::Read as _;
use std::process::{Command, Stdio};

use libtest_mimic::{Failed, Trial};

use crate::lab::{Recorder, bustape, cat, sent_on, sh, text, wait_until};
use crate::trial;

pub fn trials() -> Vec<Trial> {
    vec![
        trial("every_kind_of_frame_is_what_candump_saw", every_kind),
        trial("frames_sent_by_hand_keep_every_detail", by_hand),
        trial("two_interfaces_are_recorded_at_once_in_both_layouts", two_interfaces),
        trial("filters_are_candumps_and_work_in_the_kernel", filters),
        trial("recording_sends_nothing", sends_nothing),
        trial("an_ordinary_user_may_record", ordinary_user),
        trial("count_ends_after_exactly_so_many_frames", count),
        trial("ports_lists_interfaces_with_their_kind", ports),
    ]
}

/// candump beside the recorder, error frames included.
pub struct Candump {
    child: std::process::Child,
    log: std::path::PathBuf,
    _folder: tempfile::TempDir,
}

impl Candump {
    pub fn start(interfaces: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let log = folder.path().join("log");
        let sockets = || std::fs::read_to_string("/proc/net/can/rcvlist_all").unwrap_or_default();
        let before = sockets();
        let all = interfaces.iter().map(|name| format!("{name},0:0,#FFFFFFFF"));
        let child = Command::new("candump")
            .args(["-L", "-r", "33554432"])
            .args(all)
            .stdout(std::fs::File::create(&log).expect("a log file"))
            .stderr(Stdio::null())
            .spawn()
            .expect("candump runs");
        wait_until("candump listens", || sockets() != before);
        Self { child, log, _folder: folder }
    }

    pub fn lines(mut self, count: usize) -> Vec<String> {
        let mut log = std::fs::File::open(&self.log).expect("a log file");
        let mut text = String::new();
        wait_until("candump has it all", || {
            log.read_to_string(&mut text).expect("text");
            text.lines().count() >= count
        });
        sh(&format!("kill -INT {}", self.child.id()));
        self.child.wait().expect("candump ends");
        log.read_to_string(&mut text).expect("text");
        text.lines().map(str::to_owned).collect()
    }
}

/// Lines of one interface, in their order.
fn of(interface: &str, lines: &[String]) -> Vec<String> {
    let name = format!(" {interface} ");
    lines.iter().filter(|line| line.contains(&name)).cloned().collect()
}

fn every_kind() -> Result<(), Failed> {
    let recorder = Recorder::start(&["vcan0", "vcan1"]);
    let candump = Candump::start(&["vcan0", "vcan1"]);
    sh("cangen vcan0 -g 1 -n 300 & \
        cangen vcan0 -e -g 1 -n 300 & \
        cangen vcan0 -m -R -g 1 -n 300 & \
        cangen vcan1 -f -g 1 -n 300 & \
        cangen vcan1 -m -b -E -g 1 -n 300 & \
        for i in $(seq 20); do cansend vcan0 20000004#0020000000000000; done; wait");
    let seen = candump.lines(1520);
    let recorded = recorder.stop();
    assert_eq!(recorded.code, Some(0), "{}", recorded.stderr);
    let ours = cat(&recorded.file, &[]);
    assert_eq!((seen.len(), ours.len()), (1520, 1520));
    // Time to the microsecond, order, identifier, flags, length and data: the line says it all.
    for interface in ["vcan0", "vcan1"] {
        assert_eq!(of(interface, &ours), of(interface, &seen));
    }
    Ok(())
}

fn by_hand() -> Result<(), Failed> {
    let sent = [
        "000#",
        "7FF#0102030405060708",
        "00000000#",
        "1FFFFFFF#FF",
        "123#R",
        "123#R8",
        "12345678#R5",
        "123##0",
        "123##1AB",
        "123##2AB",
        "12345678##3",
    ];
    let long = "5A".repeat(64);
    let (long_plain, long_fast) = (format!("001##0{long}"), format!("001##1{long}"));
    let recorder = Recorder::start(&["vcan0"]);
    for frame in sent.iter().copied().chain([&*long_plain, &*long_fast]) {
        sh(&format!("cansend vcan0 {frame}"));
    }
    let recorded = recorder.stop();
    let got: Vec<String> = cat(&recorded.file, &[])
        .iter()
        .map(|line| line.rsplit(' ').next().unwrap_or("").to_owned())
        .collect();
    // Kernels since 6.1 set the FDF bit (4) in what they deliver.
    let expected: Vec<String> = sent
        .iter()
        .copied()
        .chain([&*long_plain, &*long_fast])
        .map(|frame| match frame.split_once("##") {
            Some((id, rest)) => {
                let flags = rest[..1].parse::<u8>().unwrap_or(0) | 4;
                format!("{id}##{flags}{}", &rest[1..])
            }
            None => frame.to_owned(),
        })
        .collect();
    assert_eq!(got, expected);
    // All of them were sent by this host, and are marked so.
    let marked = cat(&recorded.file, &["-x"]);
    assert!(marked.iter().all(|line| line.ends_with(" T")), "{marked:?}");
    Ok(())
}

fn two_interfaces() -> Result<(), Failed> {
    let frame = Recorder::start(&["vcan0", "vcan1"]);
    let batch = Recorder::start(&["vcan0", "vcan1", "--layout", "batch"]);
    sh("cangen vcan0 -g 0.2 -n 2000 & cangen vcan1 -m -g 0.2 -n 2000; wait");
    let (frame, batch) = (frame.stop(), batch.stop());
    for recorded in [&frame, &batch] {
        assert_eq!(recorded.code, Some(0), "{}", recorded.stderr);
        for bus in [0, 1] {
            recorded.assert_balanced(bus);
            assert_eq!(recorded.count(bus, "written"), 2000);
        }
    }
    let (frame, batch) = (cat(&frame.file, &["-N"]), cat(&batch.file, &["-N"]));
    for interface in ["vcan0", "vcan1"] {
        assert_eq!(of(interface, &frame), of(interface, &batch));
    }
    Ok(())
}

fn filters() -> Result<(), Failed> {
    let recorder = Recorder::start(&["vcan0,120:7F0,~123:7FF,j,#0"]);
    let mixed = Recorder::start(&["vcan0,12345678:DFFFFFFF,456:7FF,#0"]);
    sh("for f in 120#01 123#02 12F#03 130#04 12345678#05 456#06 20000004#0000000000000000; \
        do cansend vcan0 $f; done");
    let ids = |recorder: Recorder| -> Vec<String> {
        let recorded = recorder.stop();
        let lines = cat(&recorded.file, &[]);
        lines.iter().map(|l| l.rsplit(' ').next().unwrap_or("").to_owned()).collect()
    };
    assert_eq!(ids(recorder), ["120#01", "12F#03"]);
    assert_eq!(ids(mixed), ["12345678#05", "456#06"]);
    Ok(())
}

fn sends_nothing() -> Result<(), Failed> {
    let before = [sent_on("vcan0"), sent_on("vcan1")];
    let recorder = Recorder::start(&["vcan0", "vcan1"]);
    sh("cansend vcan0 123#01");
    recorder.stop();
    assert_eq!([sent_on("vcan0"), sent_on("vcan1")], [before[0] + 1, before[1]]);
    Ok(())
}

fn ordinary_user() -> Result<(), Failed> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("x.mcap");
    sh(&format!("chmod 777 {}", folder.path().display()));
    let line = format!(
        "setpriv --reuid 65534 --regid 65534 --clear-groups --no-new-privs {} record vcan0 \
         --count 10 -o {} & sleep 1; cangen vcan0 -g 10 -n 200; wait $!",
        crate::lab::BUSTAPE,
        file.display(),
    );
    sh(&line);
    assert_eq!(cat(&file, &[]).len(), 10);
    Ok(())
}

fn count() -> Result<(), Failed> {
    let recorder = Recorder::start(&["vcan0", "vcan1", "--count", "777"]);
    sh("cangen vcan0 -g 0 -n 1000 & cangen vcan1 -g 0 -n 1000; wait");
    let recorded = recorder.wait();
    assert_eq!((recorded.code, recorded.report["reason"].as_str()), (Some(0), Some("count")));
    assert_eq!(recorded.count(0, "written") + recorded.count(1, "written"), 777);
    assert_eq!(cat(&recorded.file, &[]).len(), 777);
    Ok(())
}

fn ports() -> Result<(), Failed> {
    sh("ip link add vx0 type vxcan peer name vx1");
    let output = bustape(&["ports", "--json"]);
    sh("ip link del vx0");
    let listed: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let kind_and_state = |name: &str| {
        let all = listed["can"].as_array().into_iter().flatten();
        let found = all.into_iter().find(|interface| interface["name"] == name);
        found.map(|i| (i["kind"].to_string(), i["state"].to_string()))
    };
    let quoted = |a: &str, b: &str| Some((format!("\"{a}\""), format!("\"{b}\"")));
    assert_eq!(kind_and_state("vcan0"), quoted("vcan", "UP"), "{}", text(&output.stdout));
    assert_eq!(kind_and_state("vx0"), quoted("vxcan", "DOWN"));
    Ok(())
}
