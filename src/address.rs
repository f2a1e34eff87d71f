//! Addresses of buses, as written on the command line: `[NAME=]ADDRESS`.

use crate::capture::serial::SerialAddress;
use crate::capture::slcan::SlcanSettings;
use crate::capture::socketcan::CanSettings;

/// A bus to be recorded: its name, and where it is.
#[derive(Clone, Debug)]
pub struct BusSpec {
    /// What its topics begin with.
    pub name: String,
    /// The address, as it was written.
    pub text: String,
    /// The address, understood.
    pub address: Address,
}

/// Where a bus is.
#[derive(Clone, Debug)]
pub enum Address {
    /// A SocketCAN interface.
    Can(CanSettings),
    /// A serial line.
    Serial(SerialAddress),
    /// A CAN adapter on a serial line.
    Slcan(SlcanSettings),
    /// A simulated device.
    Simulated(Simulation),
}

/// The built-in simulated devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simulation {
    /// Controller and HMI of a hybrid solar power station, on CAN.
    HmiCan,
    /// Telecom rectifier monitor and its master, on a serial line.
    Zhongheng09,
}
