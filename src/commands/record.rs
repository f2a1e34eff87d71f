//! `bustape record`: sources, queue, writer, and the person who stops it.

use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use serde_json::json;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::LocalSet;

use super::status::StatusLine;
use super::{Ended, UsageError, output};
use crate::address::BusSpec;
use crate::capture::socketcan::CanOptions;
use crate::capture::{BusFacts, Source, Stop};
use crate::cli::RecordArgs;
use crate::clock::Timeline;
use crate::frame::{Level, Notice, Unit};
use crate::record::{
    Allowance, BusIndex, Inlet, Outcome, Pace, Progress, Queue, REASONS, RecordedBus, Recorder,
    Segments, Split, Tally, Target, Totals, reason_name, unit_name,
};
use crate::recording::container::Facts;
use crate::recording::disk::RealDisk;
use crate::recording::writer::WriterOptions;
use crate::sys::SystemClock;
use crate::text::{grouped, printable, printable_json, size};

/// Runs the command.
pub fn run(args: &RecordArgs) -> Result<Ended> {
    let specs = parse_buses(&args.buses)?;
    let plan = Plan::of(args);
    let runtime = runtime()?;
    let outcome = runtime.block_on(async {
        let can = CanOptions {
            receive_buffer: usize::try_from(args.receive_buffer)?,
            hardware_timestamps: args.hardware_timestamps,
            ..CanOptions::default()
        };
        let mut buses = Vec::new();
        for spec in &specs {
            let source = spec.open(&can)?;
            buses.push(Bus { name: spec.name.clone(), address: spec.text.clone(), source });
        }
        record(buses, &plan).await
    })?;
    report(&outcome, args.json)
}

/// The runtime of everything that waits: one thread, beside the writer's.
pub fn runtime() -> Result<tokio::runtime::Runtime> {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().context("cannot start the event loop")
}

fn parse_buses(texts: &[String]) -> Result<Vec<BusSpec>> {
    let mut specs: Vec<BusSpec> = Vec::new();
    for text in texts {
        let spec = BusSpec::parse(text).map_err(|e| UsageError(e.to_string()))?;
        if specs.iter().any(|other| other.name == spec.name) {
            bail!(UsageError(format!(
                "two buses are called {}; give one of them another name, as in NAME={}",
                spec.name, spec.text
            )));
        }
        specs.push(spec);
    }
    Ok(specs)
}

/// A bus that is open and about to be recorded.
pub struct Bus {
    /// What its topics begin with.
    pub name: String,
    /// The address, as it was written.
    pub address: String,
    /// Where its frames come from.
    pub source: Box<dyn Source>,
}

/// How to record.
pub struct Plan {
    /// Where to.
    pub target: Target,
    /// When a segment is full.
    pub split: Split,
    /// How a segment is written.
    pub writer: WriterOptions,
    /// When things reach the disk.
    pub pace: Pace,
    /// Bytes that may wait for the disk.
    pub queue: usize,
    /// When to stop by itself.
    pub duration: Option<Duration>,
    /// After how many frames to stop.
    pub count: Option<u64>,
}

impl Plan {
    fn of(args: &RecordArgs) -> Self {
        let (target, split) = match (&args.output, &args.dir) {
            (Some(file), _) => {
                (Target::File(file.clone()), Split { size: args.split_size, time: args.split_time })
            }
            (None, dir) => (
                Target::Folder(dir.clone().unwrap_or_else(|| ".".into()), args.name.clone()),
                Split {
                    size: Some(args.split_size.unwrap_or(1 << 30)),
                    time: Some(args.split_time.unwrap_or(Duration::from_secs(3600))),
                },
            ),
        };
        let chunk_nanos = u64::try_from(args.chunk_time.as_nanos()).unwrap_or(u64::MAX);
        Self {
            target,
            split,
            writer: WriterOptions {
                layout: args.layout,
                chunk_bytes: args.chunk_size,
                compression: args.compression,
                batch_nanos: chunk_nanos.min(WriterOptions::default().batch_nanos),
                ..WriterOptions::default()
            },
            pace: Pace { chunk: args.chunk_time, sync: args.sync },
            queue: usize::try_from(args.queue).unwrap_or(usize::MAX),
            duration: args.duration,
            count: args.count,
        }
    }
}

/// How a recording went.
pub struct Recorded {
    buses: Vec<(String, Unit)>,
    outcome: Outcome,
    /// Sources that ended with an error.
    errors: Vec<String>,
    reason: String,
}

impl Recorded {
    /// The files, in order.
    pub fn files(&self) -> &[std::path::PathBuf] {
        &self.outcome.files
    }
}

/// Records `buses` until something ends it. Must run on [`runtime`].
pub async fn record(buses: Vec<Bus>, plan: &Plan) -> Result<Recorded> {
    // Before anything is opened, so that Ctrl-C from here on ends with a finished file.
    let mut signals = Signals::new()?;
    let timeline = Timeline::start(Arc::new(SystemClock));
    let segments = Segments::new(Box::new(RealDisk), plan.target.clone(), plan.split, plan.writer)?;
    let recorded: Vec<RecordedBus> = buses.iter().map(recorded_bus).collect();
    let units: Vec<(String, Unit)> =
        recorded.iter().map(|bus| (bus.name.clone(), unit(&bus.facts))).collect();
    let tallies: Vec<Arc<Tally>> = recorded.iter().map(|bus| bus.tally.clone()).collect();
    let queue = Queue::new(plan.queue);
    let progress = Arc::new(Progress::default());
    let recorder = Recorder::start(
        queue.clone(),
        segments,
        recorded,
        timeline.clone(),
        plan.pace,
        about(),
        Vec::new(),
        progress.clone(),
    )?;
    let reason = Arc::new(Mutex::new(String::new()));
    let writer = {
        let reason = reason.clone();
        let ask = move || reason.lock().unwrap_or_else(PoisonError::into_inner).clone();
        std::thread::Builder::new()
            .name("writer".to_owned())
            .spawn(move || recorder.run(ask))
            .context("cannot start the writer's thread")?
    };

    let allowance = Allowance::new(plan.count);
    let (switch, stop) = Stop::new();
    let local = LocalSet::new();
    let mut sources = tokio::task::JoinSet::new();
    for (index, (bus, tally)) in buses.into_iter().zip(&tallies).enumerate() {
        let index = BusIndex::try_from(index).context("too many buses")?;
        let unit = units[usize::from(index)].1;
        let (queue, tally) = (queue.clone(), tally.clone());
        let inlet = Inlet::new(index, unit, queue, tally, allowance.clone(), timeline.clone());
        let (stop, name, source) = (stop.clone(), bus.name, bus.source);
        let run = async move { source.run(inlet, stop).await.map_err(|e| format!("{name}: {e}")) };
        sources.spawn_local_on(run, &local);
    }

    let mut watch = Watch {
        timeline: &timeline,
        progress: &progress,
        tallies: &tallies,
        status: StatusLine::new(),
        errors: Vec::new(),
    };
    let ended =
        local.run_until(watch.until_end(&mut sources, &mut signals, plan, &allowance)).await;
    ended.clone_into(&mut reason.lock().unwrap_or_else(PoisonError::into_inner));
    switch.send(true).ok();
    // Each takes what the kernel still holds. None of them may hold up the end for long.
    let drained = async {
        while let Some(ended) = sources.join_next().await {
            watch.note(ended);
        }
    };
    if tokio::time::timeout(Duration::from_secs(3), local.run_until(drained)).await.is_err() {
        watch.errors.push("a source did not stop within 3 s and was left behind".to_owned());
    }
    drop(sources);
    drop(local);
    queue.close();
    let outcome = tokio::task::spawn_blocking(move || writer.join()).await?;
    watch.tell(&progress.take().notices);
    watch.status.clear();
    let errors = watch.errors;
    let Ok(outcome) = outcome else { bail!("the writer has failed; the file is not finished") };
    Ok(Recorded { buses: units, outcome, errors, reason: ended.to_owned() })
}

fn recorded_bus(bus: &Bus) -> RecordedBus {
    RecordedBus {
        name: bus.name.clone(),
        address: bus.address.clone(),
        facts: bus.source.facts(),
        tally: Arc::default(),
    }
}

fn unit(facts: &BusFacts) -> Unit {
    facts.unit.unwrap_or(Unit::Frames)
}

/// What everybody will want to know about a file in a year.
fn about() -> Facts {
    let mut facts = Facts::from([
        ("format".to_owned(), "1".to_owned()),
        ("recorder".to_owned(), format!("bustape {}", env!("CARGO_PKG_VERSION"))),
    ]);
    let files = [
        ("session_id", "/proc/sys/kernel/random/uuid"),
        ("boot_id", "/proc/sys/kernel/random/boot_id"),
        ("host", "/proc/sys/kernel/hostname"),
        ("kernel", "/proc/sys/kernel/osrelease"),
    ];
    for (name, path) in files {
        // A sandbox may hide them; a recording is worth more than its description.
        if let Ok(text) = std::fs::read_to_string(path) {
            facts.insert(name.to_owned(), text.trim().to_owned());
        }
    }
    facts
}

/// Waits beside the sources and tells how things go.
struct Watch<'a> {
    timeline: &'a Timeline,
    progress: &'a Progress,
    tallies: &'a [Arc<Tally>],
    status: StatusLine,
    errors: Vec<String>,
}

type SourceTask = Result<Result<(), String>, tokio::task::JoinError>;

impl Watch<'_> {
    /// Returns why the recording ends.
    async fn until_end(
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
                name = signals.next() => return name,
                () = &mut end => return "duration",
                ended = sources.join_next() => match ended {
                    Some(ended) => self.note(ended),
                    None if allowance.used_up() => return "count",
                    None => return "all buses ended",
                },
                _ = tick.tick() => {
                    let state = self.progress.take();
                    self.tell(&state.notices);
                    if state.failed {
                        return "write error";
                    }
                    let totals: Vec<Totals> = self.tallies.iter().map(|t| t.totals()).collect();
                    self.status.show(started, self.timeline.now(), &totals, &state);
                }
            }
        }
    }

    fn tell(&mut self, notices: &[Notice]) {
        for notice in notices {
            self.status.clear();
            match notice.level {
                Level::Info => output::note(&notice.text),
                Level::Warning | Level::Error => output::warning(&notice.text),
            }
        }
    }

    fn note(&mut self, ended: SourceTask) {
        let error = match ended {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error,
            Err(error) => format!("a source has failed: {error}"),
        };
        self.status.clear();
        output::warning(&error);
        self.errors.push(error);
    }
}

/// The three ways a person or the system says stop.
struct Signals {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
}

impl Signals {
    fn new() -> Result<Self> {
        let listen = |kind| signal(kind).context("cannot listen to signals");
        Ok(Self {
            interrupt: listen(SignalKind::interrupt())?,
            terminate: listen(SignalKind::terminate())?,
            hangup: listen(SignalKind::hangup())?,
        })
    }

    async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.interrupt.recv() => "SIGINT",
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.hangup.recv() => "SIGHUP",
        }
    }
}

/// Prints the books, and says how it went.
pub fn report(recorded: &Recorded, as_json: bool) -> Result<Ended> {
    let mut out = output::stdout();
    if as_json {
        writeln!(out, "{}", printable_json(&report_json(recorded).to_string()))?;
    } else {
        report_text(&mut out, recorded)?;
    }
    out.flush()?;
    if let Some(error) = &recorded.outcome.error {
        bail!("{error}");
    }
    if !recorded.errors.is_empty() {
        return Ok(Ended::WithLoss);
    }
    let lost: u64 = recorded.outcome.totals.iter().map(Totals::lost).sum();
    Ok(if lost == 0 { Ended::Well } else { Ended::WithLoss })
}

fn report_text(out: &mut impl std::io::Write, recorded: &Recorded) -> Result<()> {
    for ((name, unit), totals) in recorded.buses.iter().zip(&recorded.outcome.totals) {
        write!(
            out,
            "{name}: received {} = written {} + dropped {} {}",
            grouped(totals.received),
            grouped(totals.written),
            grouped(totals.lost()),
            unit_name(*unit),
        )?;
        let reasons: Vec<String> = REASONS
            .into_iter()
            .filter(|reason| totals.lost_to(*reason) > 0)
            .map(|reason| format!("{} {}", reason_name(reason), grouped(totals.lost_to(reason))))
            .collect();
        if !reasons.is_empty() {
            write!(out, " ({})", reasons.join(", "))?;
        }
        writeln!(out)?;
    }
    for file in recorded.files() {
        let bytes = std::fs::metadata(file).map_or(0, |m| m.len());
        writeln!(out, "{} ({})", printable(&file.display().to_string()), size(bytes))?;
    }
    Ok(())
}

fn report_json(recorded: &Recorded) -> serde_json::Value {
    let buses =
        recorded.buses.iter().zip(&recorded.outcome.totals).map(|((name, unit), totals)| {
            let dropped = REASONS.into_iter().filter(|reason| totals.lost_to(*reason) > 0);
            let dropped: serde_json::Map<_, _> = dropped
                .map(|reason| (reason_name(reason).to_owned(), json!(totals.lost_to(reason))))
                .collect();
            json!({
                "bus": name,
                "unit": unit_name(*unit),
                "received": totals.received,
                "written": totals.written,
                "dropped": totals.lost(),
                "dropped_by_reason": dropped,
            })
        });
    json!({
        "reason": recorded.reason,
        "buses": buses.collect::<Vec<_>>(),
        "files": recorded.files(),
        "errors": recorded.errors,
    })
}
