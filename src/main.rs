//! The `bustape` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    bustape::commands::main()
}
