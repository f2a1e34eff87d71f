//! Opens the targets, when it is known that they can carry what is played.

use anyhow::{Context as _, Result, bail};

use super::plan::Plan;
use super::usage;
use crate::cli::replay::ReplayArgs;
use crate::frame::{CanFlags, Frame, Timestamp};
use crate::permit::{Permit, Reach};
use crate::recording::reader::{Entry, Recording};
use crate::replay::lane::Lane;
use crate::replay::sink::Sink;
use crate::replay::sink::can::{CanSink, FD_MTU};
use crate::replay::sink::pty::PtySink;
use crate::replay::sink::serial::SerialSink;
use crate::replay::sink::slcan::SlcanSink;
use crate::replay::sink::trace::TraceSink;
use crate::replay::target::{TargetAddress, TargetSpec};
use crate::replay::verify::Witness;
use crate::text::rfc3339_millis;

impl Plan {
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

    /// Refuses to compare where nothing comes back to be compared.
    pub fn check_verify(&self) -> Result<()> {
        let mute = |target: &&TargetSpec| {
            !matches!(target.address, TargetAddress::Can(_) | TargetAddress::Pty(_))
        };
        match self.targets.iter().find(mute) {
            None => Ok(()),
            Some(target) => usage(format!(
                "--verify: {} does not hand back what was sent to it; only CAN interfaces and pty: \
                 do",
                target.text
            )),
        }
    }

    /// Has somebody listen to each target.
    pub fn watch(&self, lanes: &mut [Lane], reaches: &[Reach]) -> Result<()> {
        for ((target, lane), reach) in self.targets.iter().zip(lanes).zip(reaches) {
            let witness = match (&target.address, &reach.link) {
                (TargetAddress::Can(_), Some(link)) => Witness::of_can(link)?,
                (TargetAddress::Pty(path), _) => Witness::of_pty(path)?,
                _ => continue,
            };
            lane.watch(witness);
        }
        Ok(())
    }
}
