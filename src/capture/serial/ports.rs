//! The serial ports of this machine, for a person to choose from.

use std::path::PathBuf;

use super::identity::{by_id, hardware};

/// One serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortInfo {
    /// The device: `/dev/ttyUSB0`.
    pub path: PathBuf,
    /// The name that stays when it is plugged in elsewhere: a link in `/dev/serial/by-id`.
    pub by_id: Option<PathBuf>,
    /// The kernel driver: `ftdi_sio`, `cdc_acm`, ...
    pub driver: Option<String>,
    /// USB vendor and product, `0403:6001`.
    pub usb: Option<String>,
    /// Manufacturer, product and serial number, as far as the device tells; may be empty.
    pub description: String,
}

/// All serial ports with hardware behind them, in the order of their names.
///
/// Machines have entries for UARTs that do not exist; those are left out.
pub fn serial_ports() -> Vec<PortInfo> {
    let mut ports: Vec<_> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| describe(PathBuf::from(port.port_name)))
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    ports.dedup_by(|a, b| a.path == b.path);
    ports
}

fn describe(path: PathBuf) -> PortInfo {
    let mut facts = hardware(&path);
    let words = ["manufacturer", "product", "serial_number"];
    let words: Vec<_> = words.iter().filter_map(|w| facts.remove(*w)).collect();
    PortInfo {
        by_id: by_id(&path),
        driver: facts.remove("driver"),
        usb: facts.remove("usb"),
        description: words.join(" "),
        path,
    }
}
