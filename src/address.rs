//! Addresses of buses, as written on the command line: `[NAME=]ADDRESS`.

use crate::capture::serial::SerialAddress;
use crate::capture::slcan::{Slcan, SlcanAddress};
use crate::capture::socketcan::{CanOptions, CanSettings, SocketCan};
use crate::capture::{CaptureError, Source};
use crate::simulate::rectifier_line::SimulatedRectifier;
use crate::simulate::source::{DEMO_TIME_SCALE, SimulatedCan};

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
    SimulatedStation,
    /// `sim:zhongheng-09`: a telecom rectifier monitor and its master.
    SimulatedRectifier,
}

/// The same for everybody, so that two people see the same recording. This one has clouds, a
/// mains failure and a generator start in its first minute.
const SEED: u64 = 13;

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

    /// Opens the bus.
    pub fn open(&self, can: &CanOptions) -> Result<Box<dyn Source>, CaptureError> {
        match &self.address {
            Address::Can(settings) => SocketCan::open(settings, can),
            Address::Slcan(address) => Ok(Box::new(Slcan::open(address.clone())?)),
            Address::Serial(address) => address.clone().open(),
            Address::SimulatedStation => Ok(Box::new(SimulatedCan::new(SEED, DEMO_TIME_SCALE))),
            Address::SimulatedRectifier => {
                Ok(Box::new(SimulatedRectifier::new(SEED, DEMO_TIME_SCALE)))
            }
        }
    }
}

impl Address {
    fn parse(text: &str) -> Result<Self, String> {
        if let Some(device) = text.strip_prefix("sim:") {
            return match device {
                "hmi-can" => Ok(Self::SimulatedStation),
                "zhongheng-09" => Ok(Self::SimulatedRectifier),
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
            Self::SimulatedStation => "hmi-can".to_owned(),
            Self::SimulatedRectifier => "zhongheng-09".to_owned(),
        }
    }
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
