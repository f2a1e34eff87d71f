//! Prints made-up traffic of a CAN bus as `candump -L` does: the input of the comparisons in
//! `benches/peers`.
//!
//!     traffic FRAMES >FILE

#[path = "../benches/recording/traffic.rs"]
mod traffic;

use std::io::{BufWriter, Write as _};

use anyhow::{Context as _, Result};
use bustape::frame::{CanFlags, Frame};

fn main() -> Result<()> {
    let count = std::env::args().nth(1).context("usage: traffic FRAMES >FILE")?.parse()?;
    let mut out = BufWriter::new(std::io::stdout().lock());
    for stamped in traffic::Traffic::new().take(count) {
        let Frame::Can(frame) = stamped.value else { continue };
        let micros = stamped.time.nanos() / 1_000;
        let digits = if frame.flags.has(CanFlags::EXTENDED) { 8 } else { 3 };
        let (seconds, rest) = (micros / 1_000_000, micros % 1_000_000);
        write!(out, "({seconds}.{rest:06}) can0 {:0digits$X}#", frame.id)?;
        for byte in frame.data() {
            write!(out, "{byte:02X}")?;
        }
        writeln!(out)?;
    }
    Ok(out.flush()?)
}
