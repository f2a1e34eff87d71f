//! `bustape simulate`.

use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};

use super::parse_nonzero_duration;
use crate::simulate::faults::Rates;
use crate::simulate::hmi_can::fault::{self as can, BusFaults};
use crate::simulate::zhongheng::fault::{self as line, LineFaults};

/// Options of `bustape simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// The device
    #[command(subcommand)]
    pub device: SimulatedDevice,
}

/// What can be simulated.
#[derive(Debug, Subcommand)]
pub enum SimulatedDevice {
    /// The controllers of a hybrid solar power station, on a CAN interface
    #[command(after_help = "\
BUS is a SocketCAN interface. Frames are sent on virtual interfaces (vcan), and on a real one
only when it is named with --transmit-on; else nothing is sent and the exit status is 4.
Faults: missing (a frame is not sent), short, long (one byte less, one more), unknown-id, duplicate,
        out-of-order (a packet of a MODBUS structure after the next one), bus-error (an error frame
        of the kernel in front; on virtual interfaces only, never on a wire)")]
    HmiCan(HmiCanArgs),
    /// A telecom rectifier monitor, on a serial line that any master may poll
    #[command(
        name = "zhongheng-09",
        after_help = "\
ADDRESS is pty:PATH, a new pseudo-terminal that the other side opens as PATH, or a serial port such as
/dev/ttyUSB0,19200,8N1, which must be named with --transmit-on too, also if it is the pseudo-terminal
of another program; else nothing is sent and the exit status is 4.
Faults of the monitor's answers: bad-crc, no-answer, wrong-length (the count of data bytes), garbage
        (in front), late (1 to 2 s), link-error (DL_ERROR), wrong-sequence, wrong-address, busy"
    )]
    Zhongheng(ZhonghengArgs),
}

/// Options of every simulated device.
#[derive(Debug, Args)]
pub struct SimulationArgs {
    /// Another number is another life: weather, loads, failures, faults
    #[arg(long, value_name = "N", default_value_t = 13)]
    pub seed: u64,

    /// How many times faster than real time its day passes, 0.01 to 100000; the pace of the frames
    /// stays as it is
    #[arg(long, value_name = "X", default_value_t = 1440.0, value_parser = parse_time_scale)]
    pub time_scale: f64,

    /// Stop after this time, e.g. 90s, 10m [default: simulate until stopped]
    #[arg(long, value_name = "TIME", value_parser = parse_nonzero_duration)]
    pub duration: Option<Duration>,

    /// Transmit on this real interface or port too; may be repeated
    #[arg(long, value_name = "NAME")]
    pub transmit_on: Vec<String>,
}

/// Options of `bustape simulate hmi-can`.
#[derive(Debug, Args)]
pub struct HmiCanArgs {
    /// The interface, e.g. vcan0
    #[arg(value_name = "BUS")]
    pub bus: String,

    /// Which side is played
    #[arg(long, value_enum, default_value_t)]
    pub role: CanRole,

    /// What goes wrong and how often, e.g. missing=0.01,short=0.001 (of all frames)
    #[arg(long, value_name = "NAME=RATE,...", value_parser = can_faults)]
    pub faults: Option<BusFaults>,

    /// For every device
    #[command(flatten)]
    pub simulation: SimulationArgs,
}

/// Who of the CAN bus is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum CanRole {
    /// The control controller, which answers what it hears on the bus
    Controller,
    /// The HMI controller: commands, settings, MODBUS requests
    Hmi,
    /// The two with each other
    #[default]
    Both,
}

/// Options of `bustape simulate zhongheng-09`.
#[derive(Debug, Args)]
pub struct ZhonghengArgs {
    /// pty:PATH, or a serial port with its settings
    #[arg(value_name = "ADDRESS")]
    pub address: String,

    /// Which side is played
    #[arg(long, value_enum, default_value_t)]
    pub role: LineRole,

    /// Address of the monitor, 1 to 65279; it also answers to 0. The master calls 0 unless this is
    /// given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=0xFEFF))]
    pub slave_address: Option<u16>,

    /// What goes wrong and how often, e.g. bad-crc=0.01,no-answer=0.01 (of all answers)
    #[arg(long, value_name = "NAME=RATE,...", value_parser = line_faults)]
    pub faults: Option<LineFaults>,

    /// For every device
    #[command(flatten)]
    pub simulation: SimulationArgs,
}

/// Who of the serial line is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LineRole {
    /// The monitor, which answers any master
    #[default]
    Slave,
    /// The polling master
    Master,
    /// The two with each other; what both say is heard at ADDRESS
    Both,
}

fn can_faults(text: &str) -> Result<BusFaults, String> {
    Rates::parse(can::FAULTS, text)
}

fn line_faults(text: &str) -> Result<LineFaults, String> {
    Rates::parse(line::FAULTS, text)
}

fn parse_time_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse().ok().filter(|scale| (0.01..=100_000.0).contains(scale));
    scale.ok_or_else(|| format!("\"{text}\" is not a number from 0.01 to 100000"))
}
