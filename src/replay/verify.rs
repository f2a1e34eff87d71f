//! Listens to a target while it is played to, and compares what arrives with what was sent.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::os::fd::AsFd as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::ReplayError;
use super::lateness::Lateness;
use crate::capture::socketcan::decode_stamped;
use crate::clock::{Stamper, Timeline};
use crate::frame::{CanFlags, CanFrame, Frame};
use crate::sys::link::Link;
use crate::sys::timing::steady_nanos;
use crate::sys::{CanBatch, CanSocket, SystemClock};

/// What was sent arrives at once, on one machine; after so long it does not arrive any more.
const PATIENCE: Duration = Duration::from_secs(1);
/// Sent but not compared yet; a sender that is ahead by more waits.
const AHEAD: usize = 1024;
/// Receive buffer in the kernel, bytes: more than [`AHEAD`] frames.
const RECEIVE_BUFFER: usize = 4 << 20;
/// After the last frame, how long something else may still come that nobody sent.
const AFTER: Duration = Duration::from_millis(100);

/// What comparing has shown.
#[derive(Debug, Default)]
pub struct Verdict {
    /// Frames (or bytes of a serial line) that were compared and are the same.
    pub same: u64,
    /// How far from its moment each arrived, nanoseconds, early or late.
    pub error: Lateness,
    /// The first difference, in a sentence.
    pub difference: Option<String>,
}

/// Something that was sent.
struct Sent {
    /// When it was due, on the steady clock, if it was timed.
    due: Option<u64>,
    frame: Frame,
}

/// A listener on a thread of its own.
pub struct Witness {
    sent: SyncSender<Sent>,
    thread: JoinHandle<Verdict>,
}

impl Witness {
    /// Listens to a CAN interface.
    pub fn of_can(link: &Link) -> Result<Self, ReplayError> {
        let open = || -> io::Result<CanSocket> {
            let socket = CanSocket::new()?;
            socket.receive_fd_frames()?;
            socket.stamp()?;
            socket.set_receive_buffer(RECEIVE_BUFFER)?;
            socket.bind(link.index)?;
            Ok(socket)
        };
        let socket = open().map_err(|error| {
            ReplayError(format!("cannot listen to {} to compare: {error}", link.name))
        })?;
        let (name, timeline) = (link.name.clone(), Timeline::start(Arc::new(SystemClock)));
        // What lies between the timeline and the clock that frames are due by.
        let offset = i128::from(timeline.now().nanos()) - i128::from(steady_nanos());
        let stamper = timeline.stamper();
        Self::start(move |sent| {
            let (batch, frames) = (CanBatch::new(), Vec::new());
            compare_frames(CanEars { name, socket, batch, stamper, offset, frames }, sent)
        })
    }

    /// Opens a pseudo-terminal as a reader and listens.
    pub fn of_pty(path: &Path) -> Result<Self, ReplayError> {
        let reader = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(path);
        let reader = reader.map_err(|error| {
            ReplayError(format!("cannot open {} to compare: {error}", path.display()))
        })?;
        let name = path.display().to_string();
        Self::start(move |sent| compare_bytes(&name, reader, sent))
    }

    fn start(
        compare: impl FnOnce(&Receiver<Sent>) -> Verdict + Send + 'static,
    ) -> Result<Self, ReplayError> {
        let (sent, arrived) = sync_channel::<Sent>(AHEAD);
        let run = move || {
            let verdict = compare(&arrived);
            // Whoever sends on after a difference must not be held up.
            while arrived.recv().is_ok() {}
            verdict
        };
        let thread = std::thread::Builder::new().name("verify".to_owned()).spawn(run);
        let thread =
            thread.map_err(|error| ReplayError(format!("cannot start to compare: {error}")))?;
        Ok(Self { sent, thread })
    }

    /// This was sent.
    pub fn note(&self, due: Option<u64>, frame: Frame) {
        // The thread takes everything as long as it lives; its end is seen in `finish`.
        let _ = self.sent.send(Sent { due, frame });
    }

    /// Nothing more is sent: waits for the rest to arrive.
    pub fn finish(self) -> Verdict {
        drop(self.sent);
        self.thread.join().unwrap_or_else(|_| Verdict {
            difference: Some("the comparison has failed".to_owned()),
            ..Verdict::default()
        })
    }
}

/// Receives the frames of an interface.
struct CanEars {
    name: String,
    socket: CanSocket,
    batch: CanBatch,
    stamper: Stamper,
    offset: i128,
    /// Received, the earliest last, with their times on the steady clock.
    frames: Vec<(CanFrame, i128)>,
}

impl CanEars {
    fn next(&mut self, patience: Duration) -> io::Result<Option<(CanFrame, i128)>> {
        let end = Instant::now() + patience;
        loop {
            if let Some(frame) = self.frames.pop() {
                return Ok(Some(frame));
            }
            match self.socket.receive(&mut self.batch) {
                Ok(_) => self.take(),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    let left = end.saturating_duration_since(Instant::now());
                    if left.is_zero() {
                        return Ok(None);
                    }
                    let timeout = PollTimeout::try_from(left).unwrap_or(PollTimeout::MAX);
                    poll(&mut [PollFd::new(self.socket.as_fd(), PollFlags::POLLIN)], timeout)?;
                }
                Err(error) => return Err(error),
            }
        }
    }

    fn take(&mut self) {
        let now = self.stamper.begin_read();
        for (frame, wall) in self.batch.messages().filter_map(decode_stamped) {
            let time = wall.map_or(now, |wall| self.stamper.stamp(wall));
            self.frames.push((frame, i128::from(time.nanos()) - self.offset));
        }
        self.frames.reverse();
    }
}

fn compare_frames(mut ears: CanEars, sent: &Receiver<Sent>) -> Verdict {
    let mut verdict = Verdict::default();
    let name = ears.name.clone();
    let differ = |number: u64, what: String| Some(format!("{name}, frame {number}: {what}"));
    loop {
        let Sent { due, frame } = match sent.recv_timeout(Duration::from_secs(1)) {
            Ok(sent) => sent,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let Frame::Can(expected) = frame else { continue };
        let number = verdict.same + 1;
        let (found, time) = match ears.next(PATIENCE) {
            Ok(Some(found)) => found,
            Ok(None) => {
                let what = format!("{} was sent and did not arrive", text(&expected));
                verdict.difference = differ(number, what);
                return verdict;
            }
            Err(error) => {
                verdict.difference = differ(number, format!("listening failed: {error}"));
                return verdict;
            }
        };
        if without_tx(found) != without_tx(expected) {
            let what = format!("{} was sent, {} arrived", text(&expected), text(&found));
            verdict.difference = differ(number, what);
            return verdict;
        }
        verdict.same += 1;
        if let Some(due) = due {
            let error = (time - i128::from(due)).unsigned_abs();
            verdict.error.add(u64::try_from(error).unwrap_or(u64::MAX));
        }
    }
    if let Ok(Some((found, _))) = ears.next(AFTER) {
        let what = format!("{} arrived and was not sent", text(&found));
        verdict.difference = differ(verdict.same + 1, what);
    }
    verdict
}

/// Whether this host has sent a frame is the listener's view of it, not the frame's own.
fn without_tx(mut frame: CanFrame) -> CanFrame {
    frame.flags = CanFlags(frame.flags.0 & !CanFlags::TX.0);
    frame
}

fn text(frame: &CanFrame) -> String {
    let mut text = Vec::new();
    crate::text::candump::put(&mut text, frame);
    String::from_utf8_lossy(&text).into_owned()
}

fn compare_bytes(name: &str, mut reader: File, sent: &Receiver<Sent>) -> Verdict {
    let mut verdict = Verdict::default();
    let mut buffer = vec![0; 64 << 10];
    loop {
        let Sent { due, frame } = match sent.recv_timeout(Duration::from_secs(1)) {
            Ok(sent) => sent,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        let Frame::Serial(expected) = frame else { continue };
        let mut rest = expected.data.as_slice();
        while !rest.is_empty() {
            let most = rest.len().min(buffer.len());
            let length = read(&mut reader, &mut buffer[..most], PATIENCE);
            let number = verdict.same + 1;
            let Some(found) = buffer.get(..length).filter(|found| !found.is_empty()) else {
                let byte = rest[0];
                verdict.difference =
                    Some(format!("{name}, byte {number}: {byte:02X} was sent and did not arrive"));
                return verdict;
            };
            if let Some(at) = found.iter().zip(rest).position(|(found, sent)| found != sent) {
                let (number, found, sent) = (number + at as u64, found[at], rest[at]);
                let what = format!("{sent:02X} was sent, {found:02X} arrived");
                verdict.difference = Some(format!("{name}, byte {number}: {what}"));
                return verdict;
            }
            if let Some(due) = due.filter(|_| rest.len() == expected.data.len()) {
                verdict.error.add(steady_nanos().abs_diff(due));
            }
            verdict.same += length as u64;
            rest = &rest[length..];
        }
    }
    if read(&mut reader, &mut buffer[..1], AFTER) == 1 {
        let (number, byte) = (verdict.same + 1, buffer[0]);
        verdict.difference =
            Some(format!("{name}, byte {number}: {byte:02X} arrived and was not sent"));
    }
    verdict
}

/// Reads what is there, or what comes within `patience`; 0 if nothing.
fn read(reader: &mut File, buffer: &mut [u8], patience: Duration) -> usize {
    let end = Instant::now() + patience;
    loop {
        match reader.read(buffer) {
            Ok(length) => return length,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(_) => return 0,
        }
        let left = end.saturating_duration_since(Instant::now());
        let timeout = PollTimeout::try_from(left).unwrap_or(PollTimeout::MAX);
        let mut ready = [PollFd::new(reader.as_fd(), PollFlags::POLLIN)];
        if left.is_zero() || poll(&mut ready, timeout).is_err() {
            return 0;
        }
    }
}
