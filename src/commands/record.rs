//! `bustape record`: sources, queue, writer, and the person who stops it.

pub(super) mod about;
mod board;
mod leftovers;
mod patience;
mod plan;
mod report;
mod service;
mod status_line;
mod watch;

use std::io::Write as _;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use clap::ArgMatches;
use tokio::task::{JoinSet, LocalSet};

pub use plan::Plan;
pub use report::report;

use super::configuration::{self, Configured};
use super::definitions::{self, Definitions};
use super::{Ended, UsageError, output};
use crate::address::BusSpec;
use crate::capture::socketcan::CanOptions;
use crate::capture::{BusFacts, Source, Stop};
use crate::channels::Stream;
use crate::cli::{Missing, RecordArgs};
use crate::clock::Timeline;
use crate::frame::{Level, Unit};
use crate::queue::{Allowance, BusIndex, Inlet, Queue, Tally};
use crate::record::{
    Keeping, LEAST_FREE, Open, Outcome, Progress, RecordedBus, Recorder, Segments, Session, Tape,
    Windows,
};
use crate::recording::disk::RealDisk;
use crate::sys::SystemClock;
use crate::trigger::Triggers;
use board::Board;
use leftovers::Leftovers;
use patience::Patience;
use service::Service;
use status_line::StatusLine;
pub use watch::Stops;
use watch::{Signals, Watch};

/// Runs the command.
pub fn run(typed: &RecordArgs, matches: &ArgMatches) -> Result<Ended> {
    let configured = configuration::configured(typed, matches)?;
    let args = &configured.args;
    if args.print_config && args.buses.is_empty() {
        return print(&configured);
    }
    let specs = parse_buses(&args.buses)?;
    let mut plan = Plan::of(args)?;
    plan.configuration = Some(configured.attachment()?);
    let names: Vec<String> = specs.iter().map(|spec| spec.name.clone()).collect();
    let mut definitions = definitions::load(&args.decode, &names, Vec::new())?;
    if !configured.triggers.is_empty() {
        let known = definitions.nameable(&names);
        let triggers = Triggers::new(&configured.triggers, known).map_err(UsageError)?;
        definitions.triggers = Some(triggers);
    }
    plan.check_windows(definitions.triggers.as_ref())?;
    if args.print_config {
        return print(&configured);
    }
    let runtime = runtime()?;
    let outcome = runtime.block_on(async {
        let can = CanOptions {
            receive_buffer: usize::try_from(args.receive_buffer)?,
            hardware_timestamps: args.hardware_timestamps,
            ..CanOptions::default()
        };
        let mut buses = Vec::new();
        for spec in &specs {
            let source = match args.missing {
                Missing::Fail => spec.open(&can)?,
                Missing::Wait => spec.open_or_wait(&can),
            };
            buses.push(Bus { name: spec.name.clone(), address: spec.text.clone(), source });
        }
        definitions.check(buses.iter().map(|bus| (bus.name.clone(), bus.source.facts().unit)))?;
        record(buses, definitions, &plan).await
    })?;
    report(&outcome, args.json)
}

fn print(configured: &Configured) -> Result<Ended> {
    let mut out = output::stdout();
    out.write_all(configured.explained()?.as_bytes())?;
    out.flush()?;
    Ok(Ended::Well)
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
pub async fn record(buses: Vec<Bus>, definitions: Definitions, plan: &Plan) -> Result<Recorded> {
    // Before the file is made, so that Ctrl-C from here on ends with a finished file.
    let mut signals = Signals::new()?;
    let desk = Desk::new(&buses, plan);
    let leftovers = Leftovers::find(plan);
    let reason = Arc::new(Mutex::new(String::new()));
    let writer = desk.start_writer(&buses, definitions, plan, reason.clone())?;
    let allowance = Allowance::new(plan.count);
    let (switch, stop) = Stop::new();
    let local = LocalSet::new();
    let mut sources = desk.start_sources(buses, &allowance, &stop, &local)?;

    let at_work = leftovers.recover(desk.progress.clone());
    let board = match Board::new(plan, desk.timeline.now()) {
        Ok((board, listener)) => {
            local.spawn_local(board::hear(listener, desk.progress.clone(), desk.timeline.clone()));
            Some(board)
        }
        Err(error) => {
            output::note(&format!("no status and no marks for this recording: {error:#}"));
            None
        }
    };
    let service = Service::find();
    service.ready();
    let mut watch = Watch {
        service,
        patience: Patience::new(),
        board,
        buses: &desk.units,
        timeline: &desk.timeline,
        progress: &desk.progress,
        tallies: &desk.tallies,
        writer: &writer,
        status: StatusLine::new(),
        errors: Vec::new(),
    };
    let ended =
        local.run_until(watch.until_end(&mut sources, &mut signals, plan, &allowance)).await;
    ended.clone_into(&mut reason.lock().unwrap_or_else(PoisonError::into_inner));
    watch.service.stopping();
    switch.send(true).ok();
    // Each takes what the kernel still holds. None of them may hold up the end for long.
    let drained = async {
        while let Some(ended) = sources.join_next().await {
            watch.note(ended);
        }
    };
    if tokio::time::timeout(PATIENCE, local.run_until(drained)).await.is_err() {
        watch.errors.push("a source did not stop within 3 s and was left behind".to_owned());
    }
    at_work.stop();
    let (mut status, errors) = (watch.status, watch.errors);
    // With the sources go their inlets, which hand over what they still owe.
    drop(sources);
    drop(local);
    desk.queue.close();
    let outcome = tokio::task::spawn_blocking(move || writer.join()).await?;
    // It may wait for the disk with a file of an earlier recording; ours is finished by now.
    drop(at_work);
    watch::tell(&mut status, &desk.progress.take().notices);
    status.clear();
    let Ok(outcome) = outcome else { bail!("the writer has failed; the file is not finished") };
    Ok(Recorded { buses: desk.units, outcome, errors, reason: ended.to_owned() })
}

/// How long sources may take to end.
const PATIENCE: Duration = Duration::from_secs(3);

/// What sources and writer share.
struct Desk {
    timeline: Timeline,
    queue: Arc<Queue>,
    progress: Arc<Progress>,
    tallies: Vec<Arc<Tally>>,
    units: Vec<(String, Unit)>,
}

impl Desk {
    fn new(buses: &[Bus], plan: &Plan) -> Self {
        let unit = |bus: &Bus| bus.source.facts().unit.unwrap_or(Unit::Frames);
        Self {
            timeline: Timeline::start(Arc::new(SystemClock)),
            queue: Queue::new(plan.queue),
            progress: Arc::default(),
            tallies: buses.iter().map(|_| Arc::default()).collect(),
            units: buses.iter().map(|bus| (bus.name.clone(), unit(bus))).collect(),
        }
    }

    /// Makes the folders and the first file, and a thread that writes. It asks for `reason` at the end.
    fn start_writer(
        &self,
        buses: &[Bus],
        definitions: Definitions,
        plan: &Plan,
        reason: Arc<Mutex<String>>,
    ) -> Result<JoinHandle<Outcome>> {
        let target = plan.target.clone();
        let mut retention = plan.retention();
        if let Some(retention) = &mut retention {
            let nothing = Open { path: Path::new(""), bytes: 0, holds_event: false };
            let need = LEAST_FREE.saturating_sub(plan.limits.map_or(0, |limits| limits.min_free));
            for text in retention.make_room(need, nothing, self.timeline.now()).said {
                self.progress.remark(Level::Info, text);
            }
        }
        let segments = Segments::new(Arc::new(RealDisk), target, plan.split, plan.writer)?;
        let recorded = buses.iter().zip(&self.tallies).zip(&definitions.streams);
        let recorded = recorded.map(|((bus, tally), stream)| bus.recorded(tally, stream.as_ref()));
        let (mut facts, mut attachments) = (about::about(), definitions.attachments);
        if let Some(configuration) = &plan.configuration {
            facts.insert(format!("configuration.{}", configuration.name), configuration.sha256());
            attachments.insert(0, configuration.clone());
        }
        let mut session = Session::new(
            recorded.collect(),
            self.timeline.clone(),
            plan.pace,
            (facts, attachments),
            retention,
            self.progress.clone(),
        );
        let windows = match definitions.triggers.as_ref().and_then(Triggers::reach) {
            Some(reach) => {
                let keeping =
                    Keeping { reach, memory: plan.window_memory, only: plan.windows_only };
                let row = segments.windows()?;
                Some(Windows::new(keeping, row, definitions.known, buses.len()))
            }
            None => None,
        };
        let tape = if plan.windows_only {
            None
        } else {
            Some(Tape::start(segments, definitions.streams, &mut session)?)
        };
        let mut recorder = Recorder::new(self.queue.clone(), session, tape);
        if let Some(triggers) = definitions.triggers {
            recorder = recorder.watch(triggers, windows).context("cannot start the triggers")?;
        }
        let ask = move || reason.lock().unwrap_or_else(PoisonError::into_inner).clone();
        std::thread::Builder::new()
            .name("writer".to_owned())
            .spawn(move || recorder.run(ask))
            .context("cannot start the writer's thread")
    }

    fn start_sources(
        &self,
        buses: Vec<Bus>,
        allowance: &Arc<Allowance>,
        stop: &Stop,
        local: &LocalSet,
    ) -> Result<JoinSet<Result<(), String>>> {
        let mut sources = JoinSet::new();
        for (number, Bus { name, source, .. }) in buses.into_iter().enumerate() {
            let index = BusIndex::try_from(number).context("too many buses")?;
            let (queue, tally) = (self.queue.clone(), self.tallies[number].clone());
            let (unit, timeline) = (self.units[number].1, self.timeline.clone());
            let facts = source.facts();
            let inlet = Inlet::new(index, unit, queue, tally, allowance.clone(), timeline)
                .at_rates(facts.bitrate, facts.data_bitrate);
            let stop = stop.clone();
            let run = async move {
                let ended = source.run(inlet, stop).await;
                ended.map_err(|error| format!("{name}: {error}"))
            };
            sources.spawn_local_on(run, local);
        }
        Ok(sources)
    }
}

impl Bus {
    fn recorded(&self, tally: &Arc<Tally>, stream: Option<&Stream>) -> RecordedBus {
        let mut facts: BusFacts = self.source.facts();
        facts.more.extend(stream.into_iter().flat_map(|stream| stream.facts().clone()));
        let (name, address) = (self.name.clone(), self.address.clone());
        RecordedBus { name, address, facts, tally: tally.clone() }
    }
}
