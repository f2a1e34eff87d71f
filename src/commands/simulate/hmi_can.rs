//! The controllers of the power station on a CAN interface.

use anyhow::{Context as _, Result, anyhow, bail};

use super::super::{Ended, UsageError, output};
use super::until_end;
use crate::cli::simulate::{CanRole, HmiCanArgs};
use crate::permit::{self, Reach};
use crate::simulate::hmi_can::fault::Fault;
use crate::simulate::hmi_can::onto_can::{Transmitter, play};
use crate::simulate::hmi_can::{HmiCan, Role};
use crate::sys::link::link;

/// Plays the controllers that were asked for.
pub async fn run(args: &HmiCanArgs) -> Result<Ended> {
    let (simulation, name) = (&args.simulation, &args.bus);
    let found = link(name).with_context(|| format!("cannot look for the interface {name}"))?;
    let interface = found.filter(|link| link.can).ok_or_else(|| {
        anyhow!(
            "there is no CAN interface {name}; \"ip link add vcan0 type vcan && ip link set vcan0 \
             up\" makes one, \"bustape ports\" lists those that are there"
        )
    })?;
    let permit = permit::grant(&[Reach::of_interface(interface.clone())], &simulation.transmit_on)?;
    if !interface.up {
        bail!("the interface {name} is down; \"ip link set {name} up\" helps");
    }
    let mut bus = HmiCan::new(simulation.seed, simulation.time_scale).with_role(match args.role {
        CanRole::Controller => Role::Controller,
        CanRole::Hmi => Role::Hmi,
        CanRole::Both => Role::Both,
    });
    if let Some(faults) = &args.faults {
        if faults.rate(Fault::BusError) > 0.0 && !interface.is_virtual_can() {
            let text = format!(
                "the fault bus-error needs a virtual interface, which {name} is not: error frames \
                 are made by the kernel and never sent on a wire"
            );
            bail!(UsageError(text));
        }
        bus = bus.with_faults(faults.clone());
    }
    let transmitter = Transmitter::open(&interface, &permit)
        .with_context(|| format!("cannot open the interface {name}"))?;
    output::note(&format!("{} on {name}; Ctrl-C ends.", what(args.role)));
    let played = async {
        play(bus, &transmitter).await.with_context(|| format!("sending on {name} failed"))
    };
    until_end(played, simulation.duration).await
}

fn what(role: CanRole) -> &'static str {
    match role {
        CanRole::Controller => "A control controller sends and answers",
        CanRole::Hmi => "An HMI controller sends",
        CanRole::Both => "A control controller and its HMI controller talk",
    }
}
