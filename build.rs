//! Compiles `schemas/*.proto` into Rust types and into one self-contained descriptor set for each
//! message that bustape writes, so that the schemas stand in one place only.

use std::error::Error;
use std::path::PathBuf;

use protox::prost::Message as _;

/// The messages that have a channel, and the file that defines each.
const ROOTS: [(&str, &str); 10] = [
    ("bustape.CanFrame", "bustape/can_frame.proto"),
    ("bustape.CanBatch", "bustape/can_batch.proto"),
    ("bustape.CanError", "bustape/can_error.proto"),
    ("bustape.SerialBytes", "bustape/serial_bytes.proto"),
    ("bustape.SerialFrame", "bustape/serial_frame.proto"),
    ("bustape.Gap", "bustape/gap.proto"),
    ("bustape.BusStats", "bustape/bus_stats.proto"),
    ("bustape.ClockSync", "bustape/clock_sync.proto"),
    ("foxglove.Log", "foxglove/Log.proto"),
    ("foxglove.Event", "foxglove/Event.proto"),
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=schemas");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
    for (name, file) in ROOTS {
        // `compile` adds the imports, so each set can be read without any other.
        let set = protox::compile([file], ["schemas"])?;
        std::fs::write(out.join(format!("{name}.desc")), set.encode_to_vec())?;
    }
    let all = protox::compile(ROOTS.map(|(_, file)| file), ["schemas"])?;
    prost_build::Config::new().compile_fds(all)?;
    Ok(())
}
