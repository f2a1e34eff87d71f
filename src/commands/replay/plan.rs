//! What goes where: all that was asked for, checked against the recording before anything is
//! opened.

use std::ops::RangeInclusive;

use anyhow::Result;

use super::choice::{check_options, selection, shown_name};
use super::definitions::Definitions;
use super::usage;
use crate::capture::serial::SerialSettings;
use crate::cli::replay::ReplayArgs;
use crate::commands::output;
use crate::frame::Timestamp;
use crate::permit::Reach;
use crate::recording::reader::Recording;
use crate::replay::feed::{FedBus, FeedPlan};
use crate::replay::lane::Pace;
use crate::replay::reach::reach_of;
use crate::replay::target::{TargetAddress, TargetSpec};
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
    pub names: Vec<String>,
    /// What one byte takes on a paced line, by target.
    pub paces: Vec<Option<Pace>>,
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
        let reach = |target: &TargetSpec| Ok(reach_of(&target.address)?);
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

    /// What a bus carries, by its number.
    pub fn carries(&self, bus: usize) -> Carries {
        self.carried.get(bus).copied().unwrap_or(Carries::Can)
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
            let selection = selection(args, spec, carries, &definitions)?;
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
            if plan.targets.iter().any(|target| target.address == spec.address) {
                return usage(format!(
                    "--answer {}: {} is the target of another bus, too; who asks there could not \
                     tell them apart, so give each a target of its own",
                    spec.bus, spec.text
                ));
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
    match (holds(recording, bus, Carries::Can), holds(recording, bus, Carries::Serial)) {
        (true, true) => usage(format!(
            "--to {bus}={text}: {bus} is a CAN bus in one of the files and a serial line in \
             another; play them one after the other"
        )),
        (_, true) if !address.takes_serial() => usage(format!(
            "--to {bus}={text}: {bus} is a serial line, which needs a pty:, a serial port or trace:"
        )),
        (_, true) => Ok(Carries::Serial),
        (true, _) if !address.takes_can() => usage(format!(
            "--to {bus}={text}: {bus} is a CAN bus, which needs a CAN interface, slcan: or trace:"
        )),
        // A bus on which nothing was recorded has no channel; it fits anywhere.
        (false, _) if !address.takes_can() => Ok(Carries::Serial),
        _ => Ok(Carries::Can),
    }
}

/// True if one of the files has frames of this kind of `bus`.
fn holds(recording: &Recording, bus: &str, what: Carries) -> bool {
    let topic = format!("/{bus}/raw");
    recording.segments.iter().any(|segment| {
        let own = segment.channels.values().filter(|channel| channel.topic == topic);
        own.filter_map(|channel| segment.schemas.get(&channel.schema)).any(|schema| {
            let serial = schema.name == "bustape.SerialBytes";
            serial == (what == Carries::Serial)
        })
    })
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
