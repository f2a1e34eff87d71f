//! `bustape protocols layout`: what Foxglove and Lichtblick show of a bus.

use std::io::Write as _;

use anyhow::{Result, bail};

use crate::cli::protocols::LayoutArgs;
use crate::commands::{Ended, UsageError, output};

/// Protocol, name of the bus in its layout, and the layout: files of `schemas/foxglove`.
const LAYOUTS: [(&str, &str, &str); 2] = [
    ("hmi-can", "station", include_str!("../../../schemas/foxglove/hmi-can.json")),
    ("zhongheng-09", "rectifier", include_str!("../../../schemas/foxglove/zhongheng-09.json")),
];

/// Runs the command.
pub fn run(args: &LayoutArgs) -> Result<Ended> {
    let found = LAYOUTS.iter().find(|(protocol, ..)| *protocol == args.protocol);
    let Some((_, bus, layout)) = found else {
        let text = format!(
            "there is no layout for \"{}\"; there are those of hmi-can and zhongheng-09",
            args.protocol
        );
        bail!(UsageError(text));
    };
    let name = args.bus.as_deref().unwrap_or(bus);
    crate::address::check_name(name).map_err(UsageError)?;
    // Topics are the only texts in a layout that begin so.
    let layout = layout.replace(&format!("\"/{bus}/"), &format!("\"/{name}/"));
    let mut out = output::stdout();
    out.write_all(layout.as_bytes())?;
    out.flush()?;
    Ok(Ended::Well)
}
