//! `bustape demo`: a recording without any hardware.

use anyhow::{Context as _, Result};
use socketcan::CanInterface;

use super::record::{self, Bus, Plan};
use super::{Ended, definitions, info, output};
use crate::capture::Source;
use crate::capture::socketcan::{CanOptions, SocketCan};
use crate::cli::DemoArgs;
use crate::permit::{self, Reach};
use crate::record::{Pace, Split, Target};
use crate::recording::reader::Recording;
use crate::recording::writer::WriterOptions;
use crate::simulate::hmi_can::fault::{self as bus_fault, BusFaults};
use crate::simulate::hmi_can::{HmiCan, onto_can};
use crate::simulate::rectifier_line::SimulatedRectifier;
use crate::simulate::source::{Life, SimulatedCan};
use crate::simulate::zhongheng::fault::{self as line_fault, LineFaults};
use crate::sys::link::link;
use crate::text::duration;

/// Name of the interface the demo makes for itself.
const INTERFACE: &str = "vcan-bustape";

/// Runs the command.
pub fn run(args: &DemoArgs) -> Result<Ended> {
    std::fs::create_dir_all(&args.dir)
        .with_context(|| format!("cannot create the folder {}", args.dir.display()))?;
    let seconds = duration(u64::try_from(args.duration.as_nanos()).unwrap_or(u64::MAX));
    output::note(&format!(
        "Recording a simulated power station for {seconds} into {}; an hour passes there in 2.5 s.",
        args.dir.display()
    ));
    let buses = ["station", "rectifier"].map(str::to_owned);
    let decode = ["station=hmi-can", "rectifier=zhongheng-09"].map(str::to_owned);
    let definitions = definitions::load(&decode, &buses, Vec::new())?;
    let runtime = record::runtime()?;
    let recorded = runtime.block_on(async {
        let (station, _vcan) = station();
        let rectifier = Bus {
            name: "rectifier".to_owned(),
            address: "sim:zhongheng-09".to_owned(),
            source: Box::new(SimulatedRectifier::new(
                Life::default(),
                LineFaults::none(line_fault::FAULTS),
            )),
        };
        output::note("rectifier: the polling master and the monitor talk over a pseudo-terminal.");
        record::record(vec![station, rectifier], definitions, &plan(args)).await
    })?;
    let ended = record::report(&recorded, false)?;
    output::result("\n")?;
    info::print(&Recording::open(recorded.files())?)?;
    next_steps(recorded.files())?;
    Ok(ended)
}

fn plan(args: &DemoArgs) -> Plan {
    Plan {
        target: Target::Folder(args.dir.clone(), "demo".to_owned()),
        split: Split::default(),
        limits: None,
        writer: WriterOptions { layout: args.layout, ..WriterOptions::default() },
        pace: Pace::default(),
        queue: 16 << 20,
        window_memory: 0,
        windows_only: false,
        duration: Some(args.duration),
        count: None,
        configuration: None,
    }
}

/// The station's bus: through a virtual CAN interface where one can be made, else in this process.
fn station() -> (Bus, Option<Vcan>) {
    let name = "station".to_owned();
    match Vcan::create() {
        Ok((vcan, source)) => {
            output::note(&format!(
                "station: through the kernel's CAN, on the virtual interface {INTERFACE} made for \
                 this demo."
            ));
            (Bus { name, address: INTERFACE.to_owned(), source }, Some(vcan))
        }
        Err(why) => {
            output::note(&format!(
                "station: on a bus inside this process. A virtual CAN interface, which needs root \
                 and a kernel with vcan, cannot be made here: {why:#}."
            ));
            let source =
                Box::new(SimulatedCan::new(Life::default(), BusFaults::none(bus_fault::FAULTS)));
            (Bus { name, address: "sim:hmi-can".to_owned(), source }, None)
        }
    }
}

/// A virtual CAN interface with the station sending on it, gone when dropped.
struct Vcan {
    interface: Option<CanInterface>,
    sender: Option<tokio::task::JoinHandle<()>>,
}

impl Vcan {
    fn create() -> Result<(Self, Box<dyn Source>)> {
        // Created by us or not at all: an interface of this name that is there is somebody's.
        let interface = CanInterface::create_vcan(INTERFACE, None)?;
        let mut vcan = Self { interface: Some(interface), sender: None };
        if let Some(interface) = &vcan.interface {
            interface.bring_up()?;
        }
        let settings = INTERFACE.parse()?;
        let source = SocketCan::open(&settings, &CanOptions::default())?;
        let link = link(INTERFACE)?.context("it is gone again")?;
        let permit = permit::grant(&[Reach::of_interface(link.clone())], &[])?;
        let transmitter = onto_can::Transmitter::open(&link, &permit)?;
        let life = Life::default();
        let station = HmiCan::new(life.seed, life.time_scale);
        vcan.sender = Some(tokio::spawn(async move {
            // It ends with the interface.
            onto_can::play(station, &transmitter).await.ok();
        }));
        Ok((vcan, source))
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        if let Some(sender) = &self.sender {
            sender.abort();
        }
        if let Some(interface) = self.interface.take()
            && let Err((_, error)) = interface.delete()
        {
            output::warning(&format!(
                "cannot remove {INTERFACE}: {error}; remove it with \"ip link del {INTERFACE}\""
            ));
        }
    }
}

fn next_steps(files: &[std::path::PathBuf]) -> Result<()> {
    let Some(file) = files.first().map(|file| file.display().to_string()) else {
        return Ok(());
    };
    // As it was called, so that the lines can be copied before anything is installed.
    let bustape = std::env::args().next().unwrap_or_else(|| "bustape".to_owned());
    Ok(output::result(&format!(
        "\n\
         Look    {bustape} cat {file} | less\n\
         Plot    in Foxglove: Open local file, {file};\n        \
         add a Plot of /station/BATMON_2.voltage, State Transitions of\n        \
         /station/INV1_1.mode_label and the Log\n\
         Replay  {bustape} replay {file} --to station=trace:\n\
         Export  {bustape} export {file} --format parquet -o tables\n"
    ))?)
}
