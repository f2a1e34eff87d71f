//! Addresses of buses, as written on the command line: `[NAME=]ADDRESS`.

use crate::capture::awaited::{Awaited, Opener};
use crate::capture::serial::SerialAddress;
use crate::capture::slcan::{Slcan, SlcanAddress};
use crate::capture::socketcan::{CanOptions, CanSettings, SocketCan};
use crate::capture::{CaptureError, Source};
use crate::frame::Unit;
use crate::simulate::faults::Rates;
use crate::simulate::hmi_can::fault::{self as bus_fault, BusFaults};
use crate::simulate::rectifier_line::SimulatedRectifier;
use crate::simulate::source::{Life, SimulatedCan};
use crate::simulate::zhongheng::fault::{self as line_fault, LineFaults};

/// A bus to be recorded: its name, and where it is.
#[derive(Clone, Debug)]
pub struct BusSpec {
    /// What its topics begin with.
    pub name: String,
    /// The address, as it was written.
    pub text: String,
    address: Address,
}

/// Where a bus is.
#[derive(Clone, Debug)]
enum Address {
    /// A SocketCAN interface.
    Can(CanSettings),
    /// A CAN adapter on a serial line.
    Slcan(SlcanAddress),
    /// A serial line.
    Serial(SerialAddress),
    /// `sim:hmi-can`: the CAN link of a hybrid solar power station.
    SimulatedStation(Life, BusFaults),
    /// `sim:zhongheng-09`: a telecom rectifier monitor and its master.
    SimulatedRectifier(Life, LineFaults),
}

/// What a bus argument got wrong. The text is the whole sentence.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct AddressError(pub String);

impl BusSpec {
    /// Reads `[NAME=]ADDRESS`. Without a name, the last part of the address is the name.
    pub fn parse(text: &str) -> Result<Self, AddressError> {
        let (name, rest) = match text.split_once('=') {
            // An "=" behind the start of an address belongs to the address.
            Some((name, rest)) if !name.contains(['/', ':', ',']) => (Some(name), rest),
            _ => (None, text),
        };
        let wrong = |why: String| AddressError(format!("bus \"{text}\": {why}"));
        let address = Address::parse(rest).map_err(wrong)?;
        let name = match name {
            Some(name) => name.to_owned(),
            None => address.default_name(),
        };
        check_name(&name).map_err(wrong)?;
        Ok(Self { name, text: rest.to_owned(), address })
    }

    /// Opens the bus, or waits for it as long as it cannot be opened.
    pub fn open_or_wait(&self, can: &CanOptions) -> Box<dyn Source> {
        let why = match self.open(can) {
            Ok(source) => return source,
            Err(why) => why,
        };
        let unit = match &self.address {
            Address::Can(_) | Address::Slcan(_) | Address::SimulatedStation(..) => Unit::Frames,
            Address::Serial(_) | Address::SimulatedRectifier(..) => Unit::Bytes,
        };
        let (spec, address, can) = (self.clone(), self.address.clone(), can.clone());
        let is_there = move || match &address {
            Address::Slcan(adapter) => adapter.path.exists(),
            Address::Serial(serial) => serial.is_there(),
            Address::Can(_) | Address::SimulatedStation(..) | Address::SimulatedRectifier(..) => {
                true
            }
        };
        let open = move || spec.open(&can);
        let opener = Opener { is_there: Box::new(is_there), open: Box::new(open) };
        Box::new(Awaited::new(opener, unit, why))
    }

    /// Opens the bus.
    pub fn open(&self, can: &CanOptions) -> Result<Box<dyn Source>, CaptureError> {
        match &self.address {
            Address::Can(settings) => SocketCan::open(settings, can),
            Address::Slcan(address) => Ok(Box::new(Slcan::open(address.clone())?)),
            Address::Serial(address) => address.clone().open(),
            Address::SimulatedStation(life, faults) => {
                Ok(Box::new(SimulatedCan::new(*life, faults.clone())))
            }
            Address::SimulatedRectifier(life, faults) => {
                Ok(Box::new(SimulatedRectifier::new(*life, faults.clone())))
            }
        }
    }
}

impl Address {
    fn parse(text: &str) -> Result<Self, String> {
        if let Some(device) = text.strip_prefix("sim:") {
            let (device, options) = device.split_once(',').unwrap_or((device, ""));
            return match device {
                "hmi-can" => {
                    simulated(options, bus_fault::FAULTS).map(|(l, f)| Self::SimulatedStation(l, f))
                }
                "zhongheng-09" => simulated(options, line_fault::FAULTS)
                    .map(|(l, f)| Self::SimulatedRectifier(l, f)),
                _ => Err(format!(
                    "there is no simulated device \"{}\"; there are sim:hmi-can and \
                     sim:zhongheng-09",
                    device.escape_debug()
                )),
            };
        }
        if let Some(adapter) = SlcanAddress::parse(text) {
            return adapter.map(Self::Slcan).map_err(|error| error.to_string());
        }
        if let Some(serial) = SerialAddress::parse(text) {
            return serial.map(Self::Serial).map_err(|error| error.to_string());
        }
        text.parse().map(Self::Can).map_err(|error: CaptureError| error.to_string())
    }

    fn default_name(&self) -> String {
        match self {
            Self::Can(settings) => settings.interface.clone(),
            Self::Slcan(address) => address.default_name(),
            Self::Serial(address) => address.default_name(),
            Self::SimulatedStation(..) => "hmi-can".to_owned(),
            Self::SimulatedRectifier(..) => "zhongheng-09".to_owned(),
        }
    }
}

/// `seed=N`, `time-scale=X` and rates of faults, with commas between them.
fn simulated<F: Copy>(
    options: &str,
    known: &'static [(&'static str, F)],
) -> Result<(Life, Rates<F>), String> {
    let (mut life, mut faults) = (Life::default(), Rates::none(known));
    for option in options.split(',').filter(|option| !option.is_empty()) {
        let (name, value) = option.split_once('=').unwrap_or((option, ""));
        let wrong =
            |expected| Err(format!("{name} is \"{}\", not {expected}", value.escape_debug()));
        match name {
            "seed" => match value.parse() {
                Ok(seed) => life.seed = seed,
                Err(_) => return wrong("a whole number"),
            },
            "time-scale" => match value.parse() {
                Ok(scale) if (0.01..=100_000.0).contains(&scale) => life.time_scale = scale,
                _ => return wrong("a number from 0.01 to 100000"),
            },
            _ if faults.set(name, value)? => {}
            _ => {
                let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
                return Err(format!(
                    "a simulated device has no option \"{}\"; there are seed, time-scale, {}",
                    name.escape_debug(),
                    names.join(", ")
                ));
            }
        }
    }
    Ok((life, faults))
}

/// A name becomes part of topics, of metadata names and of file names of exports.
pub fn check_name(name: &str) -> Result<(), String> {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() || name.len() > 64 || name.starts_with('.') || !name.chars().all(fits) {
        return Err(format!(
            "\"{}\" cannot be a name: use up to 64 letters, digits, '-', '_' and '.', no '.' in \
             front, as in NAME=ADDRESS",
            name.escape_debug()
        ));
    }
    if name == "bustape" {
        return Err("the name \"bustape\" is taken by the recorder's own topics".to_owned());
    }
    Ok(())
}
