//! What goes on beside the sources: signals, the clock, the writer's state, the status line.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::board::Board;
use super::patience::{Patience, Word};
use super::plan::Plan;
use super::service::Service;
use super::status_line::StatusLine;
use crate::clock::Timeline;
use crate::frame::{Level, Notice, Unit};
use crate::queue::{Allowance, Tally, Totals};
use crate::record::{Outcome, Progress};

/// Waits beside the sources and tells how things go.
pub struct Watch<'a> {
    /// What others on this machine see of the recording.
    pub board: Option<Board>,
    /// Who started this recorder as a service.
    pub service: Service,
    /// How long the writer has waited for the disk.
    pub patience: Patience,
    /// Names of the buses, and what is counted on them.
    pub buses: &'a [(String, Unit)],
    /// The recording's timeline.
    pub timeline: &'a Timeline,
    /// What the writer is doing.
    pub progress: &'a Progress,
    /// The books of each bus.
    pub tallies: &'a [Arc<Tally>],
    /// The writer's thread.
    pub writer: &'a std::thread::JoinHandle<Outcome>,
    /// The line on the terminal.
    pub status: StatusLine,
    /// Sources that ended with an error.
    pub errors: Vec<String>,
}

type SourceTask = Result<Result<(), String>, tokio::task::JoinError>;

impl Watch<'_> {
    /// Returns why the recording ends.
    pub async fn until_end(
        &mut self,
        sources: &mut tokio::task::JoinSet<Result<(), String>>,
        signals: &mut Signals,
        plan: &Plan,
        allowance: &Allowance,
    ) -> &'static str {
        let started = self.timeline.now();
        let mut tick = tokio::time::interval(Duration::from_millis(250));
        let end = async {
            match plan.duration {
                Some(duration) => tokio::time::sleep(duration).await,
                None => std::future::pending().await,
            }
        };
        tokio::pin!(end);
        loop {
            tokio::select! {
                asked = signals.next() => match asked {
                    Asked::Stop(name) => return name,
                    Asked::Split => self.progress.split(),
                },
                () = &mut end => return "duration",
                ended = sources.join_next() => match ended {
                    Some(ended) => self.note(ended),
                    None if allowance.used_up() => return "count",
                    None => return "all buses ended",
                },
                _ = tick.tick() => {
                    let state = self.progress.take();
                    tell(&mut self.status, &state.notices);
                    // A writer that panicked must not leave capture filling the queue for months.
                    if state.failed || self.writer.is_finished() {
                        return "write error";
                    }
                    if state.full {
                        return "disk full";
                    }
                    // Those that cannot tell by themselves wait for more: serial lines.
                    if allowance.used_up() {
                        return "count";
                    }
                    let totals: Vec<Totals> = self.tallies.iter().map(|t| t.totals()).collect();
                    let now = self.timeline.now();
                    self.status.show(started, now, &totals, &state);
                    self.service.go_on(&totals, &state);
                    self.tell_stall(state.rounds);
                    if let Some(board) = &mut self.board {
                        board.show(now, self.buses, &totals, &state);
                    }
                }
            }
        }
    }

    /// Says that the disk does not answer, and puts it into the file once that can be written.
    fn tell_stall(&mut self, rounds: u64) {
        match self.patience.look(rounds, Instant::now()) {
            None => {}
            Some(Word::Waiting(text)) => {
                self.status.say(&[Notice { level: Level::Warning, text }]);
            }
            Some(Word::Over(text)) => self.progress.remark(Level::Warning, text),
        }
    }

    /// Takes note of a source that has ended.
    pub fn note(&mut self, ended: SourceTask) {
        let error = match ended {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error,
            Err(error) => format!("a source has failed: {error}"),
        };
        self.status.say(&[Notice { level: Level::Warning, text: error.clone() }]);
        self.errors.push(error);
    }
}

/// Shows sentences, each once, as soon as the terminal takes them.
pub fn tell(status: &mut StatusLine, notices: &[Notice]) {
    status.say(notices);
}

/// The three ways a person or the system says stop.
pub struct Stops {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
}

impl Stops {
    /// Listens to all of them from now on.
    pub fn new() -> Result<Self> {
        Ok(Self {
            interrupt: listen(SignalKind::interrupt())?,
            terminate: listen(SignalKind::terminate())?,
            hangup: listen(SignalKind::hangup())?,
        })
    }

    /// Waits for one of them: its name.
    pub async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.interrupt.recv() => "SIGINT",
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.hangup.recv() => "SIGHUP",
        }
    }
}

fn listen(kind: SignalKind) -> Result<Signal> {
    signal(kind).context("cannot listen to signals")
}

/// What a running recording listens to.
pub struct Signals {
    stops: Stops,
    /// SIGUSR1: a new segment.
    split: Signal,
}

impl Signals {
    /// Listens to all of them from now on.
    pub fn new() -> Result<Self> {
        Ok(Self { stops: Stops::new()?, split: listen(SignalKind::user_defined1())? })
    }

    async fn next(&mut self) -> Asked {
        tokio::select! {
            name = self.stops.next() => Asked::Stop(name),
            _ = self.split.recv() => Asked::Split,
        }
    }
}

/// What a signal asks for.
enum Asked {
    /// To end, and the signal's name.
    Stop(&'static str),
    /// A new segment.
    Split,
}
