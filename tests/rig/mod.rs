//! What the tests of capture share: a recorder on a thread of its own, and devices made of
//! pseudo-terminals.
#![allow(dead_code, reason = "each test binary uses its part")]

use std::os::fd::AsFd;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bustape::capture::{Source, Stop};
use bustape::clock::{Clock, Reading, Timeline};
use bustape::frame::{Direction, Frame, Gap, Stamped, Unit};
use bustape::queue::{Allowance, Inlet, Item, Queue, Tally, Totals};
use bustape::sys::pty::Pty;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

pub const PATIENCE: Duration = Duration::from_secs(20);

struct MachineClock(Instant);

impl Clock for MachineClock {
    fn read(&self) -> Reading {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64;
        Reading { wall, steady: self.0.elapsed().as_nanos() as u64 }
    }
}

/// A source at work on a current-thread runtime, as in the program.
pub struct Recorder {
    switch: tokio::sync::watch::Sender<bool>,
    capture: JoinHandle<(Result<(), String>, Duration)>,
    writer: JoinHandle<()>,
    queue: Arc<Queue>,
    tally: Arc<Tally>,
    pub taken: Arc<Mutex<Vec<Stamped<Frame>>>>,
    started: Instant,
}

pub struct Recorded {
    pub frames: Vec<Stamped<Frame>>,
    pub result: Result<(), String>,
    /// CPU time of the capture thread, and how long it ran.
    pub cpu: Duration,
    pub wall: Duration,
    pub totals: Totals,
}

impl Recorder {
    /// Opens the source on its thread and starts it.
    pub fn start<F>(unit: Unit, open: F) -> Self
    where
        F: FnOnce() -> Box<dyn Source> + Send + 'static,
    {
        let queue = Queue::new(256 << 20);
        let tally = Arc::new(Tally::default());
        let (switch, stop) = Stop::new();
        let taken = Arc::new(Mutex::new(Vec::new()));
        let inlet = Inlet::new(
            0,
            unit,
            Arc::clone(&queue),
            Arc::clone(&tally),
            Allowance::new(None),
            Timeline::start(Arc::new(MachineClock(Instant::now()))),
        );
        let (ready, opened) = std::sync::mpsc::channel();
        let closing = Arc::clone(&queue);
        let capture = std::thread::spawn(move || {
            let source = open();
            let runtime =
                tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            ready.send(()).unwrap();
            let before = thread_cpu();
            let result = runtime.block_on(source.run(inlet, stop)).map_err(|e| e.to_string());
            closing.close();
            (result, thread_cpu().checked_sub(before).unwrap())
        });
        opened.recv().expect("the source opens");
        let (from, into) = (Arc::clone(&queue), Arc::clone(&taken));
        let writer = std::thread::spawn(move || {
            let mut items: Vec<Item> = Vec::new();
            while from.take(&mut items, 4096, Duration::from_millis(5)) {
                into.lock().unwrap().extend(items.drain(..).map(|i| i.frame));
            }
        });
        Self { switch, capture, writer, queue, tally, taken, started: Instant::now() }
    }

    /// Waits until `enough` of what was recorded so far.
    pub fn wait(&self, what: &str, mut enough: impl FnMut(&[Stamped<Frame>]) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !enough(&self.taken.lock().unwrap()) {
            if Instant::now() > end || self.capture.is_finished() {
                let frames = self.taken.lock().unwrap();
                let last: Vec<_> = frames.iter().rev().take(5).collect();
                panic!("{what} did not happen; {} frames, last: {last:?}", frames.len());
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub fn finish(self) -> Recorded {
        let wall = self.started.elapsed();
        // A source that has already failed listens no more.
        self.switch.send(true).ok();
        let (result, cpu) = self.capture.join().unwrap();
        self.writer.join().unwrap();
        let frames = std::mem::take(&mut *self.taken.lock().unwrap());
        Recorded { frames, result, cpu, wall, totals: self.tally.totals() }
    }
}

impl Recorded {
    /// Share of one core.
    pub fn cpu_share(&self) -> f64 {
        self.cpu.as_secs_f64() / self.wall.as_secs_f64()
    }
}

fn thread_cpu() -> Duration {
    nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID.now().unwrap().into()
}

/// All bytes of one direction.
pub fn bytes(frames: &[Stamped<Frame>], direction: Direction) -> Vec<u8> {
    let mut all = Vec::new();
    for frame in frames {
        if let Frame::Serial(serial) = &frame.value
            && serial.direction == direction
        {
            all.extend_from_slice(&serial.data);
        }
    }
    all
}

pub fn count_bytes(frames: &[Stamped<Frame>], direction: Direction) -> usize {
    frames
        .iter()
        .map(|f| match &f.value {
            Frame::Serial(s) if s.direction == direction => s.data.len(),
            _ => 0,
        })
        .sum()
}

pub fn gaps(frames: &[Stamped<Frame>]) -> Vec<Gap> {
    frames.iter().filter_map(|f| if let Frame::Gap(g) = f.value { Some(g) } else { None }).collect()
}

pub fn notices(frames: &[Stamped<Frame>]) -> Vec<String> {
    let text = |f: &Stamped<Frame>| match &f.value {
        Frame::Notice(n) => Some(n.text.clone()),
        _ => None,
    };
    frames.iter().filter_map(text).collect()
}

/// The far end of a serial port: what we write the port receives.
pub struct Device(pub Pty);

impl Device {
    pub fn new() -> Self {
        Self(Pty::new().unwrap())
    }

    pub fn port(&self) -> String {
        self.0.path().to_str().unwrap().to_owned()
    }

    pub fn say(&self, mut bytes: &[u8]) {
        let end = Instant::now() + PATIENCE;
        while !bytes.is_empty() {
            match self.0.write(bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => {
                    assert!(Instant::now() < end, "{} bytes were not taken", bytes.len());
                    wait_for(&self.0, PollFlags::POLLOUT);
                }
                Err(e) => panic!("the device cannot write: {e}"),
            }
        }
    }

    /// Hears exactly `count` bytes.
    pub fn hear(&self, count: usize) -> Vec<u8> {
        let mut all = Vec::new();
        let end = Instant::now() + PATIENCE;
        while all.len() < count {
            let mut buffer = vec![0; (count - all.len()).min(65536)];
            match self.0.read(&mut buffer) {
                Ok(n) => all.extend_from_slice(&buffer[..n]),
                Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => {
                    assert!(Instant::now() < end, "heard {} of {count} bytes", all.len());
                    wait_for(&self.0, PollFlags::POLLIN);
                }
                Err(e) => panic!("the device cannot read: {e}"),
            }
        }
        all
    }
}

fn wait_for(fd: &impl AsFd, flags: PollFlags) {
    poll(&mut [PollFd::new(fd.as_fd(), flags)], PollTimeout::from(50_u16)).unwrap();
}

/// Bytes that repeat late and contain every value: a xorshift generator.
pub fn noise(seed: u64, count: usize) -> Vec<u8> {
    let mut state = seed | 1;
    let mut bytes = Vec::with_capacity(count + 8);
    while bytes.len() < count {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        bytes.extend_from_slice(&state.to_le_bytes());
    }
    bytes.truncate(count);
    bytes
}
