//! slcan capture against adapters made of pseudo-terminals.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::panic_in_result_fn,
    clippy::cast_possible_truncation,
    reason = "a test that cannot go on fails by panicking"
)]

mod rig;

use std::os::unix::fs::symlink;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bustape::capture::slcan::codec::encode;
use bustape::capture::slcan::{Slcan, SlcanAddress};
use bustape::frame::{CanFlags, CanFrame, Frame, GapReason, Stamped, Unit};
use rig::{Device, Recorder, gaps, notices};

fn open(address: &str) -> Result<Slcan, String> {
    Slcan::open(SlcanAddress::parse(address).unwrap().unwrap()).map_err(|e| e.to_string())
}

fn record(address: String) -> Recorder {
    Recorder::start(Unit::Frames, move || Box::new(open(&address).unwrap()))
}

fn frames(recorded: &[Stamped<Frame>]) -> Vec<CanFrame> {
    recorded
        .iter()
        .filter_map(|f| if let Frame::Can(c) = f.value { Some(c) } else { None })
        .collect()
}

/// An adapter that answers each command as `answer` says (`None`: silence) and keeps a log.
struct Adapter {
    device: Arc<Device>,
    heard: Arc<Mutex<Vec<String>>>,
    gone: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Adapter {
    fn new(answer: impl Fn(&str) -> Option<&'static str> + Send + 'static) -> Self {
        let device = Arc::new(Device::new());
        let heard = Arc::new(Mutex::new(Vec::new()));
        let gone = Arc::new(AtomicBool::new(false));
        let (its, log, end) = (Arc::clone(&device), Arc::clone(&heard), Arc::clone(&gone));
        let thread = std::thread::spawn(move || {
            let (mut line, mut buffer) = (String::new(), [0; 256]);
            while !end.load(Ordering::Relaxed) {
                let Ok(count) = its.0.read(&mut buffer) else {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                for &byte in &buffer[..count] {
                    if byte != b'\r' {
                        line.push(byte as char);
                        continue;
                    }
                    let command = std::mem::take(&mut line);
                    if let Some(text) = answer(&command) {
                        its.say(text.as_bytes());
                    }
                    log.lock().unwrap().push(command);
                }
            }
        });
        Self { device, heard, gone, thread: Some(thread) }
    }

    /// One that knows the commands of the CANUSB manual and acknowledges them.
    fn polite() -> Self {
        Self::new(|command| match command {
            "" | "C" | "O" | "L" | "Z1" => Some("\r"),
            "F" => Some("F00\r"),
            _ if command.starts_with(['S', 'Y']) => Some("\r"),
            _ => Some("\x07"),
        })
    }

    fn address(&self, rest: &str) -> String {
        format!("slcan:{}@{rest}", self.device.port())
    }

    fn heard(&self) -> Vec<String> {
        self.heard.lock().unwrap().clone()
    }

    fn wait_for(&self, command: &str) {
        self.wait_for_nth(1, command);
    }

    fn wait_for_nth(&self, nth: usize, command: &str) {
        let end = Instant::now() + rig::PATIENCE;
        while self.heard().iter().filter(|h| *h == command).count() < nth {
            assert!(Instant::now() < end, "{command} did not come: {:?}", self.heard());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Adapter {
    fn drop(&mut self) {
        self.gone.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// One frame of each kind, numbered.
fn some_frames(count: u32) -> Vec<CanFrame> {
    let kinds = [
        CanFlags::default(),
        CanFlags::EXTENDED,
        CanFlags::REMOTE,
        CanFlags::FD,
        CanFlags::FD | CanFlags::BRS | CanFlags::EXTENDED,
    ];
    let frame = |n: u32| {
        let flags = kinds[n as usize % kinds.len()];
        if flags.has(CanFlags::REMOTE) {
            return CanFrame::new(n & 0x7FF, flags, &[]).with_dlc((n % 9) as u8);
        }
        let length = if flags.has(CanFlags::FD) { 12 } else { 8 };
        let data: Vec<u8> = n.to_be_bytes().into_iter().cycle().take(length).collect();
        CanFrame::new(n & 0x7FF, flags, &data)
    };
    (0..count).map(frame).collect()
}

fn lines(frames: &[CanFrame]) -> String {
    frames.iter().map(|f| encode(f).unwrap()).collect()
}

#[test]
fn frames_are_recorded_and_the_adapter_is_never_asked_to_transmit() {
    let adapter = Adapter::polite();
    let recorder = record(adapter.address("500000/2000000,stamps"));
    adapter.wait_for("O");
    let sent = some_frames(50_000);
    adapter.device.say(lines(&sent).as_bytes());
    recorder.wait("all frames", |f| frames(f).len() == sent.len());
    adapter.wait_for("F");
    let recorded = recorder.finish();
    assert_eq!(recorded.result, Ok(()));
    assert!(frames(&recorded.frames) == sent);
    assert!(recorded.frames.is_sorted_by_key(|f| f.time));
    assert_eq!(gaps(&recorded.frames), []);
    assert_eq!(notices(&recorded.frames), [""; 0]);
    assert_eq!(recorded.totals.received, sent.len() as u64);

    adapter.wait_for_nth(2, "C");
    let heard: Vec<_> = adapter.heard().into_iter().filter(|h| h != "F").collect();
    assert_eq!(heard, ["", "C", "S6", "Y2", "Z1", "O", "C"]);
}

#[test]
fn an_adapter_that_never_answers_is_recorded_with_a_word_of_warning() {
    let adapter = Adapter::new(|_| None);
    let recorder = record(adapter.address("250000,listen"));
    adapter.wait_for("L");
    let sent = some_frames(100);
    adapter.device.say(lines(&sent).as_bytes());
    recorder.wait("all frames", |f| frames(f).len() == sent.len());
    std::thread::sleep(Duration::from_millis(1200));
    let recorded = recorder.finish();
    assert_eq!(recorded.result, Ok(()));
    assert!(notices(&recorded.frames)[0].contains("does not answer"));
    adapter.wait_for_nth(2, "C");
    assert_eq!(adapter.heard(), ["", "C", "S5", "L", "C"], "no questions to the deaf");
}

#[test]
fn a_refused_command_is_named() {
    let adapter = Adapter::new(|command| match command {
        "S8" => Some("\x07"),
        _ => Some("\r"),
    });
    let error = open(&adapter.address("1000000")).err().unwrap();
    assert!(error.contains("refused S8 (bit rate 1000000 bit/s)"), "{error}");

    let adapter = Adapter::new(|command| Some(if command == "L" { "\x07" } else { "\r" }));
    let recorder = record(adapter.address("500000,listen"));
    adapter.wait_for("L");
    std::thread::sleep(Duration::from_millis(200));
    let error = recorder.finish().result.unwrap_err();
    assert!(error.contains("refused L (open listening only); leave out `listen`"), "{error}");
}

#[test]
fn what_an_adapter_lost_is_a_gap() {
    let adapter = Adapter::new(|command| Some(if command == "F" { "F08\r" } else { "\r" }));
    let recorder = record(adapter.address("500000"));
    recorder.wait("the first gap", |f| !gaps(f).is_empty());
    adapter.device.say(b"e1o\r");
    recorder.wait("the error frame", |f| !frames(f).is_empty());
    let recorded = recorder.finish();
    let gaps = gaps(&recorded.frames);
    assert!(gaps.len() >= 2 && gaps.iter().all(|g| g.reason == GapReason::Adapter));
    assert!(gaps.iter().all(|g| g.count == 0 && g.unit == Unit::Frames && g.from <= g.to));
}

#[test]
fn an_adapter_without_status_is_asked_once() {
    let adapter = Adapter::new(|command| Some(if command == "F" { "\x07" } else { "\r" }));
    let recorder = record(adapter.address("500000"));
    std::thread::sleep(Duration::from_millis(3500));
    let recorded = recorder.finish();
    assert_eq!(adapter.heard().iter().filter(|h| *h == "F").count(), 1);
    assert_eq!(notices(&recorded.frames), [""; 0]);
}

#[test]
fn lines_that_are_not_slcan_are_counted_and_reported_once() {
    let adapter = Adapter::polite();
    let recorder = record(adapter.address("500000"));
    adapter.wait_for("O");
    adapter.device.say(b"\x1b[2Jhello\rt1001AA\rtWHAT\r\x07t1001BB\r");
    recorder.wait("both frames", |f| frames(f).len() == 2);
    let notices = notices(&recorder.finish().frames);
    assert_eq!(notices.len(), 2, "{notices:?}");
    assert!(notices[0].contains(r"sent `\x1b[2Jhello`, which is not slcan"), "{notices:?}");
    assert!(notices[1].starts_with("3 lines of the adapter"), "{notices:?}");
}

#[test]
fn an_adapter_that_comes_back_is_set_up_again() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("ttyACM0");
    let plug = |link: &Path| {
        let adapter = Adapter::polite();
        symlink(adapter.device.port(), link).unwrap();
        adapter
    };
    let adapter = plug(&link);
    let recorder = record(format!("slcan:{}@500000", link.display()));
    adapter.wait_for("O");
    adapter.device.say(b"t1001AA\rt100");
    recorder.wait("its frame", |f| frames(f).len() == 1);
    std::fs::remove_file(&link).unwrap();
    drop(adapter);
    std::thread::sleep(Duration::from_millis(300));
    let adapter = plug(&link);
    adapter.wait_for("O");
    assert_eq!(adapter.heard(), ["", "C", "S6", "O"]);
    adapter.device.say(b"t1001BB\r");
    recorder.wait("its second frame", |f| frames(f).len() == 2);
    let recorded = recorder.finish();
    let gaps = gaps(&recorded.frames);
    assert_eq!(gaps.len(), 1);
    assert_eq!((gaps[0].reason, gaps[0].unit), (GapReason::LinkDown, Unit::Frames));
    assert_eq!(frames(&recorded.frames)[1].data(), [0xBB]);
}
