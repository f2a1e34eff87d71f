//! What goes where: all that was asked for, checked against the recording before anything is
//! opened.

use std::ops::RangeInclusive;
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};

use super::definitions::Definitions;
use super::usage;
use crate::capture::serial::SerialSettings;
use crate::cli::replay::ReplayArgs;
use crate::commands::output;
use crate::frame::{CanFlags, Direction, Frame, Timestamp};
use crate::recording::reader::{Entry, Recording};
use crate::replay::feed::{FedBus, FeedPlan};
use crate::replay::lane::{Lane, Pace};
use crate::replay::permit::{Permit, Reach};
use crate::replay::select::{Selection, Which, identifier};
use crate::replay::sink::Sink;
use crate::replay::sink::can::{CanSink, FD_MTU};
use crate::replay::sink::pty::PtySink;
use crate::replay::sink::serial::SerialSink;
use crate::replay::sink::slcan::SlcanSink;
use crate::replay::sink::trace::TraceSink;
use crate::replay::target::{TargetAddress, TargetSpec};
use crate::replay::verify::Witness;
use crate::text::{parse_moment, rfc3339_millis};

/// What a bus carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carries {
    /// CAN frames.
    Can,
    /// Serial bytes.
    Serial,
}

/// What goes where.
pub struct Plan {
    /// The targets, each once.
    pub targets: Vec<TargetSpec>,
    /// The buses that are played, and what of them.
    pub feed: FeedPlan,
    /// For each played bus the number of its target, then for each bus that is answered.
    pub lane_of: Vec<usize>,
    /// The buses that are answered.
    pub answered: Vec<String>,
    /// What each bus carries.
    carried: Vec<Carries>,
    /// The names in a trace, by bus.
    names: Vec<String>,
    /// What one byte takes on a paced line, by target.
    paces: Vec<Option<Pace>>,
}

/// The targets, read but not yet compared with a recording.
pub struct Wanted(Vec<TargetSpec>);

impl Plan {
    /// Reads what can be read without the recording.
    pub fn check(args: &ReplayArgs) -> Result<Wanted> {
        let mut specs: Vec<TargetSpec> = Vec::new();
        for text in &args.to {
            let spec = TargetSpec::parse(text).or_else(|error| usage(error.0))?;
            if specs.iter().any(|other| other.bus == spec.bus) {
                return usage(format!("--to {text}: {} has a target already", spec.bus));
            }
            specs.push(spec);
        }
        for bus in &args.answer {
            if !specs.iter().any(|spec| spec.bus == *bus) {
                return usage(format!(
                    "--answer {bus}: say where with --to {bus}=ADDRESS, e.g. --to \
                     {bus}=pty:/tmp/tty{bus}"
                ));
            }
        }
        Ok(Wanted(specs))
    }

    /// The buses by number, with their names and the numbers of their targets.
    pub fn buses(&self) -> impl Iterator<Item = (usize, &str, usize)> {
        let names = self.feed.buses.iter().map(|bus| &bus.name).chain(&self.answered);
        names.enumerate().map(|(bus, name)| (bus, name.as_str(), self.lane_of[bus]))
    }

    /// True for the number of a bus that is answered.
    pub fn answers(&self, bus: usize) -> bool {
        bus >= self.feed.buses.len()
    }

    /// What stands at each target.
    pub fn reaches(&self) -> Result<Vec<Reach>> {
        let reach = |target: &TargetSpec| Ok(Reach::of(&target.address)?);
        self.targets.iter().map(reach).collect()
    }

    /// Says which buses stay behind.
    pub fn say_unmapped(&self, recording: &Recording) {
        let taken = |name: &&String| !self.buses().any(|(_, bus, _)| bus == *name);
        let left: Vec<&str> = recording.buses.iter().filter(taken).map(String::as_str).collect();
        if !left.is_empty() {
            output::note(&format!("not sent, since there is no --to for it: {}", left.join(", ")));
        }
    }

    /// Refuses CAN FD frames for a target that cannot carry them. Reads the recording only where
    /// its metadata leave it open whether there are any.
    pub fn check_fd(&self, recording: &Recording, reaches: &[Reach]) -> Result<()> {
        for (bus, name, lane) in self.buses().filter(|(bus, ..)| !self.answers(*bus)) {
            let able = match &self.targets[lane].address {
                TargetAddress::Can(_) => {
                    reaches[lane].link.as_ref().is_some_and(|link| link.mtu >= FD_MTU)
                }
                TargetAddress::Slcan(address) => address.data_bitrate.is_some(),
                _ => true,
            };
            let record = format!("bustape.bus.{name}");
            let mut facts = recording.segments.iter().map(|s| s.fact(&record, "mtu"));
            if able || facts.all(|mtu| mtu == Some("16")) {
                continue;
            }
            if let Some(time) = self.first_fd(recording, bus, name) {
                let target = &self.targets[lane].text;
                let hint = if reaches[lane].is_virtual {
                    format!(" (here: ip link set {target} mtu 72)")
                } else {
                    String::new()
                };
                bail!(
                    "{name} has CAN FD frames (the first at {}), which {target} cannot carry; \
                     choose a target with CAN FD{hint}",
                    rfc3339_millis(time),
                );
            }
        }
        Ok(())
    }

    fn first_fd(&self, recording: &Recording, bus: usize, name: &str) -> Option<Timestamp> {
        let topic = format!("/{name}/raw");
        let selection = &self.feed.buses[bus].selection;
        recording.entries(self.feed.range.clone(), |other| other == topic).find_map(|entry| {
            let Entry::Frame(_, mut frame) = entry.value else { return None };
            let fd = matches!(&frame, Frame::Can(frame) if frame.flags.has(CanFlags::FD));
            (fd && selection.take(&mut frame).is_ok()).then_some(entry.time)
        })
    }

    /// Opens every target.
    pub fn open(&self, args: &ReplayArgs, reaches: &[Reach], permit: &Permit) -> Result<Vec<Lane>> {
        let mut lanes = Vec::new();
        for (number, target) in self.targets.iter().enumerate() {
            let answers = args.answer.contains(&target.bus);
            let sink: Box<dyn Sink> = match &target.address {
                TargetAddress::Can(name) => {
                    let link = reaches[number].link.as_ref();
                    let link = link.with_context(|| format!("{name} was not looked up"))?;
                    Box::new(CanSink::open(link, answers, permit)?)
                }
                TargetAddress::Slcan(address) => {
                    Box::new(SlcanSink::open(address.clone(), permit)?)
                }
                TargetAddress::Port { path, settings } => {
                    Box::new(SerialSink::open(path.clone(), *settings, permit)?)
                }
                TargetAddress::Pty(path) => Box::new(PtySink::open(path)?),
                TargetAddress::Trace => Box::new(TraceSink::new(&self.names)),
            };
            lanes.push(Lane::new(target.text.clone(), sink, self.paces[number]));
        }
        Ok(lanes)
    }

    /// What a bus carries, by its number.
    pub fn carries(&self, bus: usize) -> Carries {
        self.carried.get(bus).copied().unwrap_or(Carries::Can)
    }

    /// Has somebody listen to each target.
    pub fn watch(&self, lanes: &mut [Lane], reaches: &[Reach]) -> Result<()> {
        for ((target, lane), reach) in self.targets.iter().zip(lanes).zip(reaches) {
            let witness = match (&target.address, &reach.link) {
                (TargetAddress::Can(_), Some(link)) => Witness::of_can(link)?,
                (TargetAddress::Pty(path), _) => Witness::of_pty(path)?,
                _ => {
                    return usage(format!(
                        "--verify: {} does not hand back what was sent to it; only CAN interfaces \
                         and pty: do",
                        target.text
                    ));
                }
            };
            lane.watch(witness);
        }
        Ok(())
    }
}

impl Wanted {
    /// Compares what is wanted with what there is.
    pub fn complete(self, args: &ReplayArgs, recording: &Recording) -> Result<Plan> {
        let definitions = Definitions::of(&args.decode, recording)?;
        let mut plan = Plan {
            targets: Vec::new(),
            feed: FeedPlan {
                buses: Vec::new(),
                range: range(args, recording)?,
                laps: args.laps.0,
                max_gap: args.max_gap.map(|gap| u64::try_from(gap.as_nanos()).unwrap_or(u64::MAX)),
            },
            lane_of: Vec::new(),
            answered: Vec::new(),
            carried: Vec::new(),
            names: Vec::new(),
            paces: Vec::new(),
        };
        let (answered, played): (Vec<_>, Vec<_>) =
            self.0.into_iter().partition(|spec| args.answer.contains(&spec.bus));
        for spec in &played {
            let carries = carries(recording, spec)?;
            let selection = selection(args, recording, spec, carries, &definitions)?;
            plan.feed.buses.push(FedBus { name: spec.bus.clone(), selection });
            plan.carried.push(carries);
            plan.names.push(shown_name(args, &spec.bus));
            plan.add_target(args, recording, spec)?;
        }
        for spec in &answered {
            plan.carried.push(carries(recording, spec)?);
            if spec.address == TargetAddress::Trace {
                return usage(format!("--answer {}: nobody asks a trace", spec.bus));
            }
            plan.answered.push(spec.bus.clone());
            plan.names.push(spec.bus.clone());
            plan.add_target(args, recording, spec)?;
        }
        check_options(args, &plan)?;
        Ok(plan)
    }
}

impl Plan {
    fn add_target(
        &mut self,
        args: &ReplayArgs,
        recording: &Recording,
        spec: &TargetSpec,
    ) -> Result<()> {
        let known = self.targets.iter().position(|target| target.address == spec.address);
        if known.is_none() {
            let serial = matches!(spec.address, TargetAddress::Pty(_) | TargetAddress::Port { .. });
            let pace = match &args.pace {
                Some(text) if serial => Some(pace(text, recording, spec)?),
                _ => None,
            };
            self.targets.push(spec.clone());
            self.paces.push(pace);
        }
        self.lane_of.push(known.unwrap_or(self.targets.len() - 1));
        Ok(())
    }
}

/// What `spec`'s bus carries, if its target takes that.
fn carries(recording: &Recording, spec: &TargetSpec) -> Result<Carries> {
    let TargetSpec { bus, text, address } = spec;
    if !recording.buses.contains(bus) {
        let buses = recording.buses.join(", ");
        return usage(format!("--to {bus}={text}: the recording has no bus {bus}, only {buses}"));
    }
    let topic = format!("/{bus}/raw");
    let schema = recording.segments.iter().find_map(|segment| {
        let channel = segment.channels.values().find(|channel| channel.topic == topic)?;
        segment.schemas.get(&channel.schema).map(|schema| schema.name.as_str())
    });
    match schema {
        Some("bustape.SerialBytes") if !address.takes_serial() => usage(format!(
            "--to {bus}={text}: {bus} is a serial line, which needs a pty:, a serial port or trace:"
        )),
        Some("bustape.SerialBytes") => Ok(Carries::Serial),
        Some(_) if !address.takes_can() => usage(format!(
            "--to {bus}={text}: {bus} is a CAN bus, which needs a CAN interface, slcan: or trace:"
        )),
        // A bus on which nothing was recorded has no channel; it fits anywhere.
        None if !address.takes_can() => Ok(Carries::Serial),
        Some(_) | None => Ok(Carries::Can),
    }
}

fn range(args: &ReplayArgs, recording: &Recording) -> Result<RangeInclusive<Timestamp>> {
    let (first, last) = recording.span().unwrap_or_default();
    let moment = |text: &Option<String>, default| match text {
        Some(text) => parse_moment(text, first).or_else(usage),
        None => Ok(default),
    };
    let start = moment(&args.start, first)?;
    let end = match args.duration {
        Some(duration) => start.plus(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)),
        // Not the time of the last message: a batch has frames that are later.
        None => moment(&args.end, Timestamp(u64::MAX))?,
    };
    let widest = batch_span(recording);
    if start > end || start > last.plus(widest) {
        return usage(format!(
            "nothing is left to play: the recording goes from {} to {}",
            rfc3339_millis(first),
            rfc3339_millis(last)
        ));
    }
    Ok(start..=end)
}

/// How much later than its message a frame in it can be, nanoseconds.
fn batch_span(recording: &Recording) -> u64 {
    let spans = recording.segments.iter();
    let spans = spans.filter_map(|s| s.fact("bustape.recording", "batch_max_ns")?.parse().ok());
    spans.max().unwrap_or(0)
}

fn selection(
    args: &ReplayArgs,
    recording: &Recording,
    spec: &TargetSpec,
    carries: Carries,
    definitions: &Definitions<'_>,
) -> Result<Selection> {
    let bus = &spec.bus;
    let mut selection = Selection {
        error_frames: spec.address == TargetAddress::Trace,
        only: only(args, bus)?,
        ..Selection::default()
    };
    for text in &args.filters {
        let (name, filters) = text.split_once(',').unwrap_or((text, ""));
        if name == bus {
            if filters.is_empty() || carries != Carries::Can {
                return usage(format!("--filter {text}: write it as BUS,123:7FF for a CAN bus"));
            }
            selection.filters = format!("x,{filters}")
                .parse()
                .or_else(|e| usage(format!("--filter {text}: {e}")))?;
        }
    }
    for text in &args.messages {
        match text.split_once(':') {
            Some((name, message)) if name == bus => selection.messages.push(message.to_owned()),
            Some((name, _)) if recording.buses.iter().any(|other| other == name) => {}
            Some(_) | None => selection.messages.push(text.clone()),
        }
    }
    for text in &args.remap {
        if let Some((old, new)) = remap(text, bus)? {
            let Some((id, extended)) = identifier(new) else {
                return usage(format!(
                    "--remap {text}: \"{new}\" is no identifier; write 3 hexadecimal digits for \
                     11 bits, 8 for 29"
                ));
            };
            selection.remap.push((Which::parse(old), id, extended));
        }
    }
    let by_name = selection.remap.iter().any(|(which, ..)| matches!(which, Which::Message(_)));
    if carries == Carries::Can && (by_name || !selection.messages.is_empty()) {
        name_messages(&mut selection, bus, definitions)?;
    }
    Ok(selection)
}

/// Finds the database that tells messages apart, and checks that it has those asked for.
fn name_messages(
    selection: &mut Selection,
    bus: &str,
    definitions: &Definitions<'_>,
) -> Result<()> {
    let Some(definition) = definitions.can(bus)? else {
        return usage(format!(
            "messages of {bus} have no names without a database; name it with --decode \
             {bus}=PROTOCOL"
        ));
    };
    let renamed = selection.remap.iter().filter_map(|(which, ..)| match which {
        Which::Message(name) => Some(name),
        Which::Id { .. } => None,
    });
    for name in selection.messages.iter().chain(renamed) {
        let remote = definition.remotes().iter().any(|remote| remote.name == *name);
        if !remote && !definition.messages().iter().any(|message| message.name == *name) {
            return usage(format!("the database of {bus} has no message {name}"));
        }
    }
    selection.definition = Some(Arc::new(definition));
    Ok(())
}

fn only(args: &ReplayArgs, bus: &str) -> Result<Option<Direction>> {
    let mut only = None;
    for text in &args.only {
        let (name, way) = match text.split_once(':') {
            Some((name, way)) => (Some(name), way),
            None => (None, text.as_str()),
        };
        let way = match way {
            "rx" => Direction::Rx,
            "tx" => Direction::Tx,
            _ => return usage(format!("--only {text}: write rx or tx, or BUS:rx")),
        };
        if name.is_none_or(|name| name == bus) {
            only = Some(way);
        }
    }
    Ok(only)
}

/// `BUS:OLD=NEW` of this bus.
fn remap<'a>(text: &'a str, bus: &str) -> Result<Option<(&'a str, &'a str)>> {
    let Some((old, new)) = text.split_once('=') else {
        return usage(format!("--remap {text}: write it as BUS:OLD=NEW"));
    };
    match old.split_once(':') {
        Some((name, old)) if name == bus => Ok(Some((old, new))),
        _ => Ok(None),
    }
}

/// The name of a bus in a trace.
fn shown_name(args: &ReplayArgs, bus: &str) -> String {
    let mut renamed = args.remap.iter().filter_map(|text| text.split_once('='));
    renamed.find(|(old, _)| *old == bus).map_or(bus, |(_, new)| new).to_owned()
}

/// Options that name a bus must name one that is played.
fn check_options(args: &ReplayArgs, plan: &Plan) -> Result<()> {
    let known = |name: &str| plan.buses().any(|(_, bus, _)| bus == name);
    let named = |text: &str, end: &[char]| text.split(end).next().unwrap_or_default().to_owned();
    let filters = args.filters.iter().map(|text| ("filter", text, named(text, &[','])));
    let remaps = args.remap.iter().map(|text| ("remap", text, named(text, &[':', '='])));
    let only = args.only.iter().filter(|text| text.contains(':'));
    let only = only.map(|text| ("only", text, named(text, &[':'])));
    for (option, text, bus) in filters.chain(remaps).chain(only) {
        if !known(&bus) {
            return usage(format!("--{option} {text}: there is no --to for {bus}"));
        }
    }
    Ok(())
}

/// How long a byte takes at `text` baud, or at that of the recorded line.
fn pace(text: &str, recording: &Recording, spec: &TargetSpec) -> Result<Pace> {
    let record = format!("bustape.bus.{}", spec.bus);
    let settings = recording.segments.iter().find_map(|s| s.fact(&record, "settings"));
    let recorded: Option<SerialSettings> = settings.and_then(|text| text.parse().ok());
    let baud = match (text, text.parse(), &recorded) {
        (_, Ok(baud @ 50..=12_000_000), _) => baud,
        ("baud", _, Some(settings)) => settings.baud,
        ("baud", _, None) => {
            return usage(format!(
                "--pace baud: the recording does not tell the baud rate of {}; write it as a number",
                spec.bus
            ));
        }
        _ => return usage(format!("--pace {text}: write 50 to 12000000 bit/s, or baud")),
    };
    let bits = recorded.map_or(10, |settings| settings.bits_per_byte());
    Ok(Pace { byte: u64::from(bits) * 1_000_000_000 / u64::from(baud) })
}
