//! Ports that only listen: one alone, or two on the two lines of one link (a tap).
//!
//! No nap between reads: at 4 Mbit/s through a pseudo-terminal reading at once costs a few percent
//! of one core, and the time of bytes is the time of their read, so a nap would be paid with
//! precision.

use std::cell::RefCell;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};

use super::last::LastReads;
use super::open::{Opened, PortSpec, Use};
use super::port::{Port, READ_BYTES};
use super::settings::SerialSettings;
use super::supervise::Outage;
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Unit};
use crate::queue::Inlet;

/// One or two listening ports that make one bus.
pub struct Listen {
    kind: &'static str,
    lines: Vec<(PortSpec, Opened, Direction)>,
}

impl Listen {
    /// A port that hears what the device says.
    pub fn port(path: PathBuf, settings: SerialSettings) -> Result<Self, CaptureError> {
        let (spec, opened) = PortSpec::open_first(path, settings, Use::Listen)?;
        Ok(Self { kind: "port", lines: vec![(spec, opened, Direction::Rx)] })
    }

    /// Two ports: `device` hears what the device says (Rx), `host` what the host says (Tx).
    pub fn tap(
        device: PathBuf,
        host: PathBuf,
        settings: SerialSettings,
    ) -> Result<Self, CaptureError> {
        let (rx_spec, rx) = PortSpec::open_first(device, settings, Use::Listen)?;
        let (tx_spec, tx) = PortSpec::open_first(host, settings, Use::Listen)?;
        let lines = vec![(rx_spec, rx, Direction::Rx), (tx_spec, tx, Direction::Tx)];
        Ok(Self { kind: "tap", lines })
    }
}

impl Source for Listen {
    fn facts(&self) -> BusFacts {
        let mut facts = BusFacts { unit: Some(Unit::Bytes), ..BusFacts::default() };
        for (spec, _, direction) in &self.lines {
            facts.bitrate = Some(spec.settings.baud);
            for (name, text) in spec.facts() {
                // The settings are the same for both lines; everything else is told apart.
                let name = match direction {
                    Direction::Tx if name != "settings" => format!("host_{name}"),
                    _ => name,
                };
                facts.more.insert(name, text);
            }
        }
        facts.more.insert("kind".to_owned(), self.kind.to_owned());
        facts.more.insert("timestamps".to_owned(), "read".to_owned());
        facts
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            let inlet = RefCell::new(inlet);
            let mut lines = self.lines.into_iter();
            let (first, second) = (lines.next(), lines.next());
            let both = tokio::join!(
                run_line(first, &inlet, stop.clone()),
                run_line(second, &inlet, stop.clone())
            );
            both.0.and(both.1)
        })
    }
}

async fn run_line(
    line: Option<(PortSpec, Opened, Direction)>,
    inlet: &RefCell<Inlet>,
    mut stop: Stop,
) -> Result<(), CaptureError> {
    let Some((spec, mut opened, direction)) = line else { return Ok(()) };
    loop {
        let mut port = Port::new(opened, &spec, direction, inlet)
            .map_err(|e| CaptureError(format!("cannot wait on {}: {e}", spec.path.display())))?;
        let Err(why) = listen(&mut port, inlet, &mut stop).await else { return Ok(()) };
        let since = port.alive();
        drop(port);
        let again = spec.clone();
        let outage = Outage { stable: &spec.stable, since, why: &why };
        let back = outage.wait(move || again.open_again(), inlet, &mut stop).await;
        let Some(back) = back else { return Ok(()) };
        opened = back;
    }
}

/// Records until `stop`. An error means that the device is gone.
async fn listen(port: &mut Port, inlet: &RefCell<Inlet>, stop: &mut Stop) -> io::Result<()> {
    let mut buffer = vec![0; READ_BYTES];
    let mut second = interval(Duration::from_secs(1));
    second.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            () = stop.requested() => break,
            _ = second.tick() => port.check_overruns(inlet),
            read = port.read(&mut buffer) => port.record(inlet, &buffer[..read?]),
        }
    }
    let mut last = LastReads::new();
    while last.more()
        && let Ok(length @ 1..) = port.read_now(&mut buffer)
    {
        port.record(inlet, &buffer[..length]);
        last.took(length);
    }
    port.check_overruns(inlet);
    Ok(())
}
