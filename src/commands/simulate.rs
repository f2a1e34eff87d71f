//! `bustape simulate`: devices that do not exist, for programs that want to talk to them.

mod hmi_can;
mod zhongheng;

use std::future::Future;
use std::time::Duration;

use anyhow::Result;

use super::record::{self, Stops};
use super::{Ended, output};
use crate::cli::simulate::{SimulateArgs, SimulatedDevice};

/// Runs the command.
pub fn run(args: &SimulateArgs) -> Result<Ended> {
    record::runtime()?.block_on(async {
        match &args.device {
            SimulatedDevice::HmiCan(args) => hmi_can::run(args).await,
            SimulatedDevice::Zhongheng(args) => zhongheng::run(args).await,
        }
    })
}

/// Lets `simulation` run until it fails, `duration` is over, or a person has had enough.
async fn until_end(
    simulation: impl Future<Output = Result<()>>,
    duration: Option<Duration>,
) -> Result<Ended> {
    let mut stops = Stops::new()?;
    let over = async {
        match duration {
            Some(duration) => tokio::time::sleep(duration).await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        result = simulation => result?,
        () = over => {}
        name = stops.next() => output::note(&format!("Stopped by {name}.")),
    }
    Ok(Ended::Well)
}
