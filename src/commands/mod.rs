//! The verbs: the only place that joins the stations together and talks to a person.

mod books;
mod cat;
mod configuration;
mod convert;
mod decode;
mod definitions;
mod demo;
mod explain;
mod export;
mod import;
mod info;
mod install;
mod interrupt;
mod keep;
mod mark;
mod output;
mod ports;
mod protocols;
mod record;
mod recover;
mod replay;
mod retime;
mod rewrite;
mod running;
mod simulate;
mod status;

use std::process::ExitCode;

use clap::{ArgMatches, CommandFactory as _, FromArgMatches as _};

use crate::cli::{Cli, Command};
use crate::permit::Refused;

/// How a command ended, when it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// All is well.
    Well,
    /// Something was lost or skipped, and was said.
    WithLoss,
}

/// What was typed makes no sense: exit status 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let matches = Cli::command().get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    ExitCode::from(run(&cli, &matches))
}

/// Runs a command line that was understood from `matches`, and says on stderr why it failed if it did.
/// Returns the exit status.
pub fn run(cli: &Cli, matches: &ArgMatches) -> u8 {
    let result = match &cli.command {
        Command::Record(args) => record::run(args, matches),
        Command::Info(args) => info::run(args),
        Command::Cat(args) => cat::run(args),
        Command::Convert(args) => convert::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Recover(args) => recover::run(args),
        Command::Completions(args) => install::completions(args),
        Command::Man(args) => install::man(args),
        Command::Keep(args) => keep::run(args),
        Command::Mark(args) => mark::run(args),
        Command::Status(args) => status::run(args),
        Command::Retime(args) => retime::run(args),
        Command::Export(args) => export::run(args),
        Command::Import(args) => import::run(args),
        Command::Decode(args) => decode::run(args),
        Command::Ports(args) => ports::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Explain(args) => explain::run(args),
        Command::Protocols(args) => protocols::run(args),
        Command::Simulate(args) => simulate::run(args),
    };
    match result {
        Ok(Ended::Well) => 0,
        Ok(Ended::WithLoss) => 3,
        Err(error) if output::is_broken_pipe(&error) => 0,
        Err(error) => {
            output::error(&format!("{error:#}"));
            status(&error)
        }
    }
}

/// The exit status of a command that failed.
fn status(error: &anyhow::Error) -> u8 {
    if error.is::<UsageError>() {
        2
    } else if error.is::<Refused>() {
        4
    } else {
        1
    }
}
