//! The simulated rectifier monitor and its master on a real line: a pair of pseudo-terminals.
//!
//! [`run_slave`] and [`run_master`] drive one end of any line, so that a recorder can be put
//! between them; [`SimulatedRectifier`] joins both and records what either end reads.

use std::cell::RefCell;
use std::io;
use std::time::Duration;

use tokio::time::{Instant, interval, sleep, sleep_until};

use super::line::Line;
use super::source::{Life, simulated};
use super::zhongheng::fault::LineFaults;
use super::zhongheng::{BAUD, Master, Slave};
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Frame, SerialBytes, Unit};
use crate::queue::Inlet;

/// How often the monitor's plant goes on.
const LIFE: Duration = Duration::from_secs(1);

/// Answers on `line` as `slave` until the other end is closed. `seen` gets what each read
/// returned, before it is acted on.
pub async fn run_slave(
    line: &Line,
    mut slave: Slave,
    mut seen: impl FnMut(&[u8]),
) -> io::Result<()> {
    let start = Instant::now();
    // Its plant goes on living while nobody asks; else the first answer would have to wait for all of it.
    let mut life = interval(LIFE);
    loop {
        let bytes = tokio::select! {
            bytes = line.read() => bytes?,
            _ = life.tick() => {
                slave.feed(&[], nanos(start));
                continue;
            }
        };
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
                    line.forget_unread()?;
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
    life: Life,
}

impl SimulatedRectifier {
    /// The plant of one life. The master calls the general address 0 and the slave answers as 1,
    /// as in the document's examples.
    pub fn new(life: Life, faults: LineFaults) -> Self {
        let slave = Slave::new(1, life.seed, life.time_scale).with_faults(faults);
        Self { master: Master::new(life.seed, 0), slave, life }
    }

    async fn play(self, inlet: Inlet, mut stop: Stop) -> io::Result<()> {
        let (device, host) = Line::pair(BAUD)?;
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
        let mut more = simulated(self.life);
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
    use crate::simulate::source::tests::record;
    use crate::simulate::zhongheng::fault::FAULTS;
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
        let source =
            SimulatedRectifier::new(Life { seed: 3, ..Life::default() }, LineFaults::none(FAULTS));
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
