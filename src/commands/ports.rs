//! `bustape ports`: what this machine could record.

use std::io::Write as _;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::{Ended, output};
use crate::capture::serial::{PortInfo, serial_ports};
use crate::capture::socketcan::{CanInterfaceInfo, can_interfaces};
use crate::cli::PortsArgs;
use crate::text::printable_json;

/// Runs the command.
pub fn run(args: &PortsArgs) -> Result<Ended> {
    let interfaces = can_interfaces().context("cannot list the CAN interfaces")?;
    let ports = serial_ports();
    let mut out = output::stdout();
    if args.json {
        let can: Vec<Value> = interfaces.iter().map(can_json).collect();
        let serial: Vec<Value> = ports.iter().map(port_json).collect();
        let all = json!({ "can": can, "serial": serial });
        writeln!(out, "{}", printable_json(&all.to_string()))?;
    } else {
        print_interfaces(&mut out, &interfaces)?;
        print_ports(&mut out, &ports)?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn print_interfaces(out: &mut impl std::io::Write, interfaces: &[CanInterfaceInfo]) -> Result<()> {
    output::heading(out, "CAN interfaces")?;
    if interfaces.is_empty() {
        writeln!(out, "  none; \"ip link add vcan0 type vcan && ip link set vcan0 up\" makes one")?;
        return Ok(());
    }
    let head = ["name", "kind", "state", "bit/s", "mtu", "driver"];
    let rows = interfaces.iter().map(can_row).collect();
    write!(out, "{}", output::table(&head, &[3, 4], rows))?;
    Ok(())
}

fn print_ports(out: &mut impl std::io::Write, ports: &[PortInfo]) -> Result<()> {
    output::heading(out, "Serial ports")?;
    if ports.is_empty() {
        writeln!(out, "  none")?;
        return Ok(());
    }
    let rows = ports.iter().map(|port| {
        vec![
            port.path.display().to_string(),
            or_dash(port.driver.clone()),
            or_dash(port.usb.clone()),
            or_dash(Some(port.description.clone()).filter(|text| !text.is_empty())),
            or_dash(port.by_id.as_ref().map(|path| path.display().to_string())),
        ]
    });
    let head = ["port", "driver", "usb", "description", "stable name"];
    write!(out, "{}", output::table(&head, &[], rows.collect()))?;
    Ok(())
}

fn or_dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| "-".to_owned())
}

fn can_row(info: &CanInterfaceInfo) -> Vec<String> {
    let bitrate = match (info.bitrate, info.data_bitrate) {
        (Some(nominal), Some(data)) => Some(format!("{nominal}/{data}")),
        (nominal, _) => nominal.map(|rate| rate.to_string()),
    };
    vec![
        info.name.clone(),
        or_dash(info.kind.clone()),
        state(info).to_owned(),
        or_dash(bitrate),
        info.mtu.to_string(),
        or_dash(info.driver.clone()),
    ]
}

fn state(info: &CanInterfaceInfo) -> &str {
    match (info.up, info.state) {
        (false, _) => "DOWN",
        (true, Some(state)) => state,
        (true, None) => "UP",
    }
}

fn can_json(info: &CanInterfaceInfo) -> Value {
    json!({
        "name": info.name,
        "kind": info.kind,
        "state": state(info),
        "bitrate": info.bitrate,
        "data_bitrate": info.data_bitrate,
        "mtu": info.mtu,
        "driver": info.driver,
        "modes": info.modes,
    })
}

fn port_json(port: &PortInfo) -> Value {
    json!({
        "path": port.path,
        "by_id": port.by_id,
        "driver": port.driver,
        "usb": port.usb,
        "description": port.description,
    })
}
