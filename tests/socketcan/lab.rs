//! Recorders, senders and interfaces, as the tests use them.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// The program under test.
pub const BUSTAPE: &str = env!("CARGO_BIN_EXE_bustape");

/// Runs a shell line and returns what it printed; panics when it fails.
pub fn sh(line: &str) -> String {
    let output = Command::new("bash").args(["-c", line]).output().expect("bash runs");
    assert!(output.status.success(), "{line}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs bustape to its end.
pub fn bustape(args: &[&str]) -> Output {
    Command::new(BUSTAPE).args(args).output().expect("bustape runs")
}

/// What `bustape cat` prints of a recording, a line each.
pub fn cat(file: &Path, options: &[&str]) -> Vec<String> {
    let output = Command::new(BUSTAPE).arg("cat").arg(file).args(options).output();
    let output = output.expect("bustape runs");
    assert!(output.status.success(), "{}: {}", output.status, text(&output.stderr));
    text(&output.stdout).lines().map(str::to_owned).collect()
}

/// What `bustape info --json` says of a recording.
pub fn info(file: &Path) -> Value {
    let output = Command::new(BUSTAPE).args(["info", "--json"]).arg(file).output();
    let output = output.expect("bustape runs");
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("info prints JSON")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A recorder at work.
pub struct Recorder {
    child: Child,
    pub file: PathBuf,
    /// Holds the file, and goes with it.
    #[allow(dead_code, reason = "kept for its drop")]
    folder: tempfile::TempDir,
}

/// How a recording ended.
pub struct Recorded {
    pub code: Option<i32>,
    /// What `--json` printed.
    pub report: Value,
    pub stderr: String,
    pub file: PathBuf,
    /// Holds the file, and goes with it.
    #[allow(dead_code, reason = "kept for its drop")]
    folder: tempfile::TempDir,
}

impl Recorder {
    /// Starts recording, and returns once the file is there and frames are being read.
    pub fn start(args: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("recording.mcap");
        let child = Command::new(BUSTAPE)
            .args(["record", "--json", "-o"])
            .arg(&file)
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("bustape runs");
        let recorder = Self { child, file, folder };
        let part = recorder.file.with_extension("mcap.part");
        wait_until("the recording begins", || part.exists());
        // The sockets are bound before the file is made, so nothing sent from now on is missed.
        recorder
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// User and system time used so far, in clock ticks of 10 ms.
    pub fn cpu_ticks(&self) -> u64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.pid())).expect("stat");
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
        fields[11..13].iter().map(|field| field.parse::<u64>().unwrap_or(0)).sum()
    }

    pub fn signal(&self, signal: &str) {
        sh(&format!("kill -{signal} {}", self.pid()));
    }

    /// Stops with a signal and waits for the end.
    pub fn stop(self) -> Recorded {
        self.signal("INT");
        self.wait()
    }

    /// Waits for the end.
    pub fn wait(self) -> Recorded {
        let output = self.child.wait_with_output().expect("bustape ends");
        let stderr = text(&output.stderr);
        let report = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{error}: {} {stderr}", text(&output.stdout)));
        let code = output.status.code();
        Recorded { code, report, stderr, file: self.file, folder: self.folder }
    }
}

impl Recorded {
    /// A number of the books of bus number `bus`.
    pub fn count(&self, bus: usize, what: &str) -> u64 {
        self.report["buses"][bus][what].as_u64().unwrap_or_else(|| panic!("{}", self.report))
    }

    /// Fails unless the books of bus number `bus` balance.
    pub fn assert_balanced(&self, bus: usize) {
        let [received, written, dropped] =
            ["received", "written", "dropped"].map(|what| self.count(bus, what));
        assert_eq!(received, written + dropped, "{}", self.report);
    }

    /// The gaps `info` lists, with this reason.
    pub fn gaps(&self, reason: &str) -> Vec<Value> {
        let gaps = info(&self.file)["gaps"].as_array().cloned().unwrap_or_default();
        gaps.into_iter().filter(|gap| gap["reason"] == reason).collect()
    }
}

/// Frames the kernel has sent on an interface since it was made.
pub fn sent_on(interface: &str) -> u64 {
    let path = format!("/sys/class/net/{interface}/statistics/tx_packets");
    let text = std::fs::read_to_string(path).expect("the interface exists");
    text.trim().parse().expect("a number")
}

/// Waits for something that must happen. A minute is far more than any of it takes.
pub fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(60), "waited for a minute until {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
