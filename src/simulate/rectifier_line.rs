//! The simulated rectifier monitor and its master on a real line: a pair of pseudo-terminals.
//!
//! [`run_slave`] and [`run_master`] drive one end of any line, so that a recorder can be put
//! between them; [`SimulatedRectifier`] joins both and records what either end reads.

use std::cell::RefCell;
use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::sys::termios;
use tokio::io::Interest;
use tokio::time::{Instant, sleep, sleep_until};

use super::source::simulated;
use super::zhongheng::{BAUD, Master, Slave};
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Frame, SerialBytes, Unit};
use crate::record::Inlet;
use crate::sys::Waiting;

/// A UART hands over what it has received in pieces of about this size.
const PIECE: usize = 8;
/// Ten bits a byte: 8N1.
const NANOS_PER_BYTE: u64 = 10_000_000_000 / BAUD as u64;

/// One end of a line, raw and non-blocking.
pub struct Line(Waiting<OwnedFd>);

impl Line {
    /// Takes over a terminal: a serial port, or either end of a pseudo-terminal. Needs a tokio
    /// runtime.
    pub fn new(fd: OwnedFd) -> io::Result<Self> {
        let mut settings = termios::tcgetattr(&fd)?;
        termios::cfmakeraw(&mut settings);
        termios::tcsetattr(&fd, termios::SetArg::TCSANOW, &settings)?;
        let flags = OFlag::from_bits_truncate(fcntl(&fd, FcntlArg::F_GETFL)?);
        fcntl(&fd, FcntlArg::F_SETFL(flags | OFlag::O_NONBLOCK))?;
        Ok(Self(Waiting::new(fd, Interest::READABLE | Interest::WRITABLE)?))
    }

    /// Two ends of one line.
    pub fn pair() -> io::Result<(Self, Self)> {
        let pty = nix::pty::openpty(None, None)?;
        Ok((Self::new(pty.slave)?, Self::new(pty.master)?))
    }

    /// What one read returns; empty when the other end is closed.
    async fn read(&self) -> io::Result<Vec<u8>> {
        let mut bytes = [0; 512];
        loop {
            let read = |fd: &OwnedFd| Ok(nix::unistd::read(fd, &mut bytes)?);
            match self.0.act(Interest::READABLE, read).await {
                Ok(count) => return Ok(bytes[..count].to_vec()),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                // A pseudo-terminal says so when nobody has the other end open any more.
                Err(error) if error.raw_os_error() == Some(Errno::EIO as i32) => {
                    return Ok(Vec::new());
                }
                Err(error) => return Err(error),
            }
        }
    }

    async fn write_all(&self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            let write = |fd: &OwnedFd| Ok(nix::unistd::write(fd, bytes)?);
            match self.0.act(Interest::WRITABLE, write).await {
                Ok(count) => bytes = &bytes[count..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Sends `bytes` as fast as the line would carry them, in pieces as a UART hands them over.
    async fn send(&self, bytes: &[u8]) -> io::Result<()> {
        let start = Instant::now();
        let mut sent = 0;
        for piece in bytes.chunks(PIECE) {
            sent += piece.len() as u64;
            // A piece is there when its last byte is.
            sleep_until(start + Duration::from_nanos(sent * NANOS_PER_BYTE)).await;
            self.write_all(piece).await?;
        }
        Ok(())
    }
}

/// Answers on `line` as `slave` until the other end is closed. `seen` gets what each read
/// returned, before it is acted on.
pub async fn run_slave(
    line: &Line,
    mut slave: Slave,
    mut seen: impl FnMut(&[u8]),
) -> io::Result<()> {
    let start = Instant::now();
    loop {
        let bytes = line.read().await?;
        if bytes.is_empty() {
            return Ok(());
        }
        seen(&bytes);
        let answer = slave.feed(&bytes, nanos(start));
        if !answer.is_empty() {
            sleep(slave.think_time()).await;
            line.send(&answer).await?;
        }
    }
}

/// Polls on `line` as `master` until the other end is closed. `seen` gets what each read returned.
pub async fn run_master(
    line: &Line,
    mut master: Master,
    mut seen: impl FnMut(&[u8]),
) -> io::Result<()> {
    let start = Instant::now();
    loop {
        let due = start + Duration::from_nanos(master.due());
        tokio::select! {
            bytes = line.read() => {
                let bytes = bytes?;
                if bytes.is_empty() {
                    return Ok(());
                }
                seen(&bytes);
                master.feed(&bytes, nanos(start));
            }
            () = sleep_until(due) => {
                if let Some(request) = master.poll(nanos(start)) {
                    line.send(&request).await?;
                }
            }
        }
    }
}

fn nanos(start: Instant) -> u64 {
    u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

/// Master and slave on one line, both directions recorded (`sim:zhongheng-09`).
pub struct SimulatedRectifier {
    master: Master,
    slave: Slave,
    seed: u64,
    time_scale: f64,
}

impl SimulatedRectifier {
    /// The plant of `seed`, whose time runs `time_scale` times as fast as real time. The master
    /// calls the general address 0 and the slave answers as 1, as in the document's examples.
    pub fn new(seed: u64, time_scale: f64) -> Self {
        let (master, slave) = (Master::new(seed, 0), Slave::new(1, seed, time_scale));
        Self { master, slave, seed, time_scale }
    }

    async fn play(self, inlet: Inlet, mut stop: Stop) -> io::Result<()> {
        let (device, host) = Line::pair()?;
        let inlet = RefCell::new(inlet);
        let (full, mut satisfied) = tokio::sync::watch::channel(false);
        let record = |direction: Direction, bytes: &[u8]| {
            // Never borrowed across an await, so never borrowed twice.
            let mut inlet = inlet.borrow_mut();
            let time = inlet.timeline().now();
            let bytes = SerialBytes { direction, data: bytes.to_vec(), errors: Vec::new() };
            inlet.push_one(time, Frame::Serial(bytes));
            full.send_replace(inlet.satisfied());
        };
        tokio::select! {
            result = run_slave(&device, self.slave, |b| record(Direction::Tx, b)) => result,
            result = run_master(&host, self.master, |b| record(Direction::Rx, b)) => result,
            _ = satisfied.wait_for(|full| *full) => Ok(()),
            () = stop.requested() => Ok(()),
        }
    }
}

impl Source for SimulatedRectifier {
    fn facts(&self) -> BusFacts {
        let mut more = simulated(self.seed, self.time_scale);
        more.insert("settings".to_string(), format!("{BAUD},8N1"));
        BusFacts { unit: Some(Unit::Bytes), bitrate: Some(BAUD), data_bitrate: None, more }
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            self.play(inlet, stop).await.map_err(|error| {
                CaptureError(format!(
                    "cannot simulate a rectifier on a pseudo-terminal: {error}; \
                     check that /dev/ptmx can be opened"
                ))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::source::DEMO_TIME_SCALE;
    use crate::simulate::source::tests::record;
    use crate::simulate::zhongheng::frame::{Deframer, Frame as LineFrame};

    fn frames(recorded: &[crate::frame::Stamped<Frame>], wanted: Direction) -> Vec<LineFrame> {
        let mut deframer = Deframer::default();
        let mut found = Vec::new();
        for stamped in recorded {
            let Frame::Serial(bytes) = &stamped.value else { panic!("{stamped:?}") };
            assert!(!bytes.data.is_empty() && bytes.errors.is_empty());
            if bytes.direction == wanted {
                found.extend(bytes.data.iter().filter_map(|byte| deframer.push(*byte)));
            }
        }
        found
    }

    #[test]
    fn both_directions_are_recorded_and_every_request_has_its_answer() {
        let source = SimulatedRectifier::new(3, DEMO_TIME_SCALE);
        assert_eq!(source.facts().more["settings"], "19200,8N1");
        // `--count` counts reads here: 36 of them are some four requests with their answers.
        let recorded = record(Box::new(source), 36);
        let (asked, answered) =
            (frames(&recorded, Direction::Tx), frames(&recorded, Direction::Rx));
        assert!(asked.len() >= 3, "{} requests", asked.len());
        assert!(asked.len() - answered.len() <= 1, "{} answers", answered.len());
        assert_eq!((asked[0].control.0, answered[0].control.0), (0x40, 0x86));
        for (request, answer) in asked.iter().zip(&answered) {
            assert_eq!(request.control.sequence(), answer.control.sequence());
        }
        assert!(recorded.windows(2).all(|pair| pair[0].time <= pair[1].time));
    }
}
