//! The rectifier monitor and its master on a serial line.

use anyhow::{Result, bail};

use super::super::{Ended, UsageError, output};
use super::until_end;
use crate::capture::serial::SerialAddress;
use crate::cli::simulate::{LineRole, ZhonghengArgs};
use crate::permit::{self, Reach};
use crate::simulate::line::Line;
use crate::simulate::rectifier_line::{run_master, run_slave};
use crate::simulate::zhongheng::{BAUD, Master, Slave};

/// Plays the side that was asked for.
pub async fn run(args: &ZhonghengArgs) -> Result<Ended> {
    if args.role == LineRole::Master && args.faults.is_some() {
        bail!(UsageError("--faults are those of the monitor; the master has none".to_owned()));
    }
    let line = open(args)?;
    output::note(&format!("{} at {}; Ctrl-C ends.", what(args.role), args.address));
    let ended = until_end(play(args, &line), args.simulation.duration).await;
    ended.map_err(|error| error.context(format!("the simulation on {} failed", args.address)))
}

fn what(role: LineRole) -> &'static str {
    match role {
        LineRole::Slave => "A rectifier monitor answers",
        LineRole::Master => "A master polls",
        LineRole::Both => "A rectifier monitor and its master are heard",
    }
}

fn open(args: &ZhonghengArgs) -> Result<Line> {
    let address = &args.address;
    let wrong = |why: String| UsageError(format!("address \"{address}\": {why}"));
    Ok(match SerialAddress::parse(address) {
        Some(Ok(SerialAddress::Pty { link })) => Line::linked(&link, BAUD)?,
        Some(Ok(SerialAddress::Port { path, settings })) => {
            let reach = [Reach::of_port(&path)];
            let permit = permit::grant(&reach, &args.simulation.transmit_on)?;
            Line::port(path, settings, &permit)?
        }
        Some(Err(error)) => bail!(wrong(error.to_string())),
        Some(Ok(_)) | None => bail!(wrong(
            "a simulated device speaks at pty:PATH or on a port such as /dev/ttyUSB0,19200,8N1"
                .to_owned()
        )),
    })
}

async fn play(args: &ZhonghengArgs, line: &Line) -> Result<()> {
    let simulation = &args.simulation;
    let seed = simulation.seed;
    let mut slave = Slave::new(args.slave_address.unwrap_or(1), seed, simulation.time_scale);
    if let Some(faults) = &args.faults {
        slave = slave.with_faults(faults.clone());
    }
    // Address 0 calls whichever slave is there.
    let master = Master::new(seed, args.slave_address.unwrap_or(0));
    match args.role {
        LineRole::Slave => run_slave(line, slave, |_| ()).await?,
        LineRole::Master => run_master(line, master, |_| ()).await?,
        LineRole::Both => {
            let (device, host) = Line::pair(BAUD)?;
            let hear = |bytes: &[u8]| line.write_now(bytes);
            tokio::select! {
                result = run_slave(&device, slave, hear) => result?,
                result = run_master(&host, master, hear) => result?,
            }
        }
    }
    bail!("the other end of the line was closed or unplugged")
}
