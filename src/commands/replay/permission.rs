//! Asks before something real can hear the replay.

use std::io::{BufRead as _, IsTerminal as _, Write as _};

use anyhow::{Result, bail};

use super::{any_real, usage};
use crate::cli::replay::ReplayArgs;
use crate::permit::{Permit, Reach, Refused, grant};

/// The permit to send to all targets, or the reason why nothing is sent.
pub fn permit(args: &ReplayArgs, reaches: &[Reach]) -> Result<Permit> {
    for name in &args.transmit_on {
        if !reaches.iter().any(|reach| reach.name == *name) {
            let names: Vec<&str> = reaches.iter().map(|reach| reach.name.as_str()).collect();
            let targets = names.join(", ");
            return usage(format!("--transmit-on {name}: the targets are {targets}"));
        }
    }
    Ok(grant(reaches, &args.transmit_on)?)
}

/// Asks a person, if anything real shall be sent to and nobody has said yes yet.
pub fn confirm(args: &ReplayArgs, reaches: &[Reach]) -> Result<()> {
    if any_real(reaches) && !args.yes && !confirmed(reaches)? {
        bail!(Refused("nothing was sent: it was not confirmed with \"yes\"".to_owned()));
    }
    Ok(())
}

fn confirmed(reaches: &[Reach]) -> Result<bool> {
    let real = reaches.iter().filter(|reach| !reach.is_virtual);
    let list: Vec<String> = real.map(|r| format!("{} ({})", r.name, r.kind)).collect();
    let list = list.join(", ");
    if !std::io::stdin().is_terminal() || !std::io::stderr().is_terminal() {
        bail!(Refused(format!(
            "nothing was sent: there is no terminal to confirm on that {list} shall hear this replay; add \
             --yes if it shall"
        )));
    }
    anstream::eprint!(
        "This replay will transmit on {}. Type yes to go on: ",
        crate::text::printable(&list)
    );
    std::io::stderr().flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    Ok(answer.trim() == "yes")
}
