//! What SocketCAN capture promises, on real CAN interfaces of a real kernel.
//!
//! Machines that build software rarely have them, so this program starts itself again where
//! `vcan0` and `vcan1` exist: see `tests/lab/README.md`. When that is impossible it fails; with
//! `BUSTAPE_NO_VCAN=1` it says that nothing was tested.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::panic_in_result_fn,
    clippy::cast_possible_truncation,
    clippy::unnecessary_wraps,
    reason = "a test that cannot go on fails by panicking"
)]

mod errors;
mod frames;
mod lab;
mod links;
mod loss;
mod replay;
mod simulate;
mod time;

use std::process::{Command, ExitCode};

use libtest_mimic::{Arguments, Failed, Trial};

/// Set where the interfaces exist.
const IN_LAB: &str = "BUSTAPE_IN_LAB";

fn main() -> ExitCode {
    let mut args = Arguments::from_args();
    let list_only = args.list;
    if !list_only && std::env::var_os(IN_LAB).is_none() {
        if std::env::var_os("BUSTAPE_NO_VCAN").is_some_and(|value| value == "1") {
            eprintln!("socketcan: nothing was tested, because BUSTAPE_NO_VCAN=1 is set");
            return ExitCode::SUCCESS;
        }
        return run_in_lab();
    }
    // The tests share two interfaces and one clock.
    args.test_threads = Some(1);
    let trials = [
        errors::trials(),
        frames::trials(),
        loss::trials(),
        links::trials(),
        time::trials(),
        replay::trials(),
        simulate::trials(),
    ];
    libtest_mimic::run(&args, trials.into_iter().flatten().collect()).exit_code()
}

/// This program again, with the same arguments, where there is CAN.
fn run_in_lab() -> ExitCode {
    let lab = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/lab/vcan-run");
    let own = std::env::current_exe().expect("this program has a path");
    let status = Command::new(lab)
        .args(["--timeout", "900", "--", "env"])
        .arg(format!("{IN_LAB}=1"))
        .arg(own)
        .args(std::env::args_os().skip(1))
        .status();
    match status {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        Ok(status) => {
            if status.code() == Some(125) {
                eprintln!("socketcan: no CAN interfaces here; BUSTAPE_NO_VCAN=1 leaves these out");
            }
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("socketcan: cannot run {lab}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn trial(name: &str, test: fn() -> Result<(), Failed>) -> Trial {
    Trial::test(name, test)
}
