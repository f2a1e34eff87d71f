//! `bustape ports`: what this machine could record.

use std::io::Write as _;

use anyhow::{Context as _, Result};
use serde_json::json;

use super::{Ended, output};
use crate::capture::socketcan::{CanInterfaceInfo, can_interfaces};
use crate::cli::PortsArgs;

/// Runs the command.
pub fn run(args: &PortsArgs) -> Result<Ended> {
    let interfaces = can_interfaces().context("cannot list the CAN interfaces")?;
    if args.json {
        let can: Vec<_> = interfaces.iter().map(can_json).collect();
        println!("{}", json!({ "can": can }));
        return Ok(Ended::Well);
    }
    let mut out = output::stdout();
    output::heading(&mut out, "CAN interfaces")?;
    if interfaces.is_empty() {
        writeln!(out, "  none; \"ip link add vcan0 type vcan && ip link set vcan0 up\" makes one")?;
    } else {
        let head = ["name", "kind", "state", "bit/s", "mtu", "driver"];
        let rows = interfaces.iter().map(can_row).collect();
        write!(out, "{}", output::table(&head, &[3, 4], rows))?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

fn can_row(info: &CanInterfaceInfo) -> Vec<String> {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
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

fn can_json(info: &CanInterfaceInfo) -> serde_json::Value {
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
