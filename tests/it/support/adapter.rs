//! CAN adapters that speak the Lawicel ASCII protocol, without hardware.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::terminal::{Device, wait};

/// Two adapters on one bus: what a program has the one send, the other has received.
pub struct Adapters {
    sender: PathBuf,
    receiver: PathBuf,
    open: Arc<AtomicBool>,
    end: Arc<AtomicBool>,
    bus: Option<JoinHandle<()>>,
}

impl Adapters {
    pub fn new() -> Self {
        let [mut sender, mut receiver] = [Adapter::new(), Adapter::new()];
        let ports = [&sender, &receiver].map(|adapter| adapter.device.port().to_owned());
        let [sends, receives] = ports;
        let end = Arc::new(AtomicBool::new(false));
        let open = Arc::new(AtomicBool::new(false));
        let (ended, is_open) = (Arc::clone(&end), Arc::clone(&open));
        let bus = std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                wait([&sender.device, &receiver.device], Duration::from_millis(20));
                let frames = sender.obey();
                if receiver.open && !frames.is_empty() {
                    receiver.device.say(&frames);
                }
                // Last, so that it has received everything before it closes its channel.
                receiver.obey();
                is_open.store(receiver.open, Ordering::Relaxed);
            }
        });
        Self { sender: sends, receiver: receives, open, end, bus: Some(bus) }
    }

    /// The port of the one that sends.
    pub fn sender(&self) -> &Path {
        &self.sender
    }

    /// True while the receiving one has its channel open: then it misses nothing.
    pub fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }

    /// The port of the one that receives.
    pub fn receiver(&self) -> &Path {
        &self.receiver
    }
}

impl Drop for Adapters {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let ended = self.bus.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || ended.is_some_and(|ended| ended.is_ok()));
    }
}

struct Adapter {
    device: Device,
    /// What has come of a line.
    line: Vec<u8>,
    open: bool,
}

impl Adapter {
    fn new() -> Self {
        Self { device: Device::new(), line: Vec::new(), open: false }
    }

    /// Does what it was told, and returns the lines of the frames among that.
    fn obey(&mut self) -> Vec<u8> {
        let mut buffer = [0; 4096];
        let length = self.device.hear(&mut buffer).unwrap_or(0);
        let (mut answers, mut frames) = (Vec::new(), Vec::new());
        for byte in &buffer[..length] {
            self.line.push(*byte);
            if *byte != b'\r' {
                continue;
            }
            let line = std::mem::take(&mut self.line);
            match line[0] {
                b't' | b'r' | b'd' | b'b' | b'T' | b'R' | b'D' | b'B' => {
                    answers.extend(if line[0].is_ascii_uppercase() { b"Z\r" } else { b"z\r" });
                    frames.extend(line);
                }
                b'F' => answers.extend(b"F00\r"),
                command => {
                    self.open = command == b'O' || self.open && command != b'C';
                    answers.push(b'\r');
                }
            }
        }
        if !answers.is_empty() {
            self.device.say(&answers);
        }
        frames
    }
}
