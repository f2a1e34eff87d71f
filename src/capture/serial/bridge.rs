//! A bridge: the application opens our pseudo-terminal, the real port is behind it, and both
//! directions are recorded as they pass.
//!
//! What the application sets on the pseudo-terminal (rate, format, modem lines, breaks) stays
//! there; the real port keeps the settings of the address.

use std::cell::RefCell;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep};

use super::application::Application;
use super::last::LastReads;
use super::link::Link;
use super::open::{Opened, PortSpec, Use};
use super::port::{Port, READ_BYTES};
use super::pty::linked;
use super::relay::Relay;
use super::settings::{FlowControl, SerialSettings};
use super::supervise::Outage;
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Frame, Level, SerialBytes, Unit};
use crate::queue::Inlet;
use crate::sys::opens::Opens;
use crate::sys::pty::Pty;

/// At the end, what the application wrote last still goes out, but not for longer than this.
const LAST_WRITES: Duration = Duration::from_millis(500);

/// A real port and the pseudo-terminal in front of it.
pub struct Bridge {
    spec: PortSpec,
    opened: Opened,
    pty: Pty,
    link: Link,
    opens: Opens,
    path: PathBuf,
}

impl Bridge {
    /// Opens the real port at `path` and makes the pseudo-terminal at `link`.
    pub fn open(
        path: PathBuf,
        settings: SerialSettings,
        link: PathBuf,
    ) -> Result<Self, CaptureError> {
        let (spec, opened) = PortSpec::open_first(path, settings, Use::Talk)?;
        let (pty, made) = linked(&link)?;
        let opens = Opens::watch(pty.path()).map_err(|e| {
            CaptureError(format!("cannot watch {} with inotify: {e}", pty.path().display()))
        })?;
        Ok(Self { spec, opened, pty, link: made, opens, path: link })
    }
}

impl Source for Bridge {
    fn facts(&self) -> BusFacts {
        let bitrate = Some(self.spec.settings.baud);
        let mut more = self.spec.facts();
        more.insert("kind".to_owned(), "bridge".to_owned());
        more.insert("timestamps".to_owned(), "read".to_owned());
        more.insert("application".to_owned(), self.path.display().to_string());
        BusFacts { unit: Some(Unit::Bytes), bitrate, data_bitrate: None, more }
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            let inlet = RefCell::new(inlet);
            let Self { spec, opened, pty, link, opens, path } = *self;
            let failed =
                |e: io::Error| CaptureError(format!("bridge at {} failed: {e}", path.display()));
            let may_hold = spec.settings.flow != FlowControl::None;
            let mut second = interval(Duration::from_secs(1));
            second.set_missed_tick_behavior(MissedTickBehavior::Delay);
            let mut bridging = Bridging {
                application: Application::new(pty, link, opens, may_hold).map_err(failed)?,
                to_port: Relay::default(),
                inlet: &inlet,
                second,
                buffer: vec![0; READ_BYTES],
                unsent: 0,
            };
            bridging.run(&spec, opened, stop).await.map_err(failed)
        })
    }
}

/// A bridge at work.
struct Bridging<'a> {
    application: Application,
    to_port: Relay,
    inlet: &'a RefCell<Inlet>,
    second: Interval,
    buffer: Vec<u8>,
    /// Bytes of the application that could not be sent because the port was away.
    unsent: usize,
}

/// Why passing bytes on came to an end.
enum End {
    Stopped,
    PortGone(io::Error),
}

impl Bridging<'_> {
    async fn run(&mut self, spec: &PortSpec, mut opened: Opened, mut stop: Stop) -> io::Result<()> {
        loop {
            let mut port = Port::new(opened, spec, Direction::Rx, self.inlet)?;
            let why = match self.pass_on(&mut port, &mut stop).await? {
                End::Stopped => return self.finish(port).await,
                End::PortGone(why) => why,
            };
            let since = port.alive();
            drop(port);
            self.unsent += self.to_port.clear();
            let again = spec.clone();
            let inlet = self.inlet;
            let outage = Outage { stable: &spec.stable, since, why: &why };
            let back = tokio::select! {
                back = outage.wait(move || again.open_again(), inlet, &mut stop) => back,
                failed = self.pass_nothing() => return failed,
            };
            self.report_unsent();
            let Some(back) = back else { return Ok(()) };
            opened = back;
        }
    }

    /// Passes bytes on in both directions until `stop` or until the port is gone. An error means
    /// that the pseudo-terminal failed, which has no remedy.
    async fn pass_on(&mut self, port: &mut Port, stop: &mut Stop) -> io::Result<End> {
        // Two buffers, because either read may be under way.
        let mut heard = vec![0; READ_BYTES];
        loop {
            let Self { application, to_port, inlet, second, buffer, unsent } = self;
            let (to_application, from_application) = (application.room(), to_port.room());
            let heard = &mut heard[..to_application.min(READ_BYTES)];
            let said = &mut buffer[..from_application.min(READ_BYTES)];
            tokio::select! {
                () = stop.requested() => return Ok(End::Stopped),
                _ = second.tick() => port.check_overruns(inlet),
                opened = application.opened_or_closed() => { opened?; application.look(); }
                read = port.read(heard), if to_application > 0 => match read {
                    Ok(length) => hear(port, application, inlet, &heard[..length])?,
                    Err(why) => return Ok(End::PortGone(why)),
                },
                read = application.read(said), if from_application > 0 => {
                    let said = &said[..read?];
                    let time = inlet.borrow().timeline().now();
                    let passed = to_port.pass(said, |bytes| port.write_now(bytes));
                    record_said(inlet, time, said);
                    if let Err(why) = passed {
                        *unsent += said.len();
                        return Ok(End::PortGone(why));
                    }
                }
                written = port.write(to_port.front()), if !to_port.is_empty() => match written {
                    Ok(count) => to_port.advance(count),
                    Err(why) => return Ok(End::PortGone(why)),
                },
                written = application.flush() => application.flushed(written?, inlet),
            }
        }
    }

    /// While the port is away: what the application says is recorded and goes nowhere, as on a
    /// cable that leads nowhere. Sending it later would be worse than not sending it.
    async fn pass_nothing(&mut self) -> io::Result<()> {
        loop {
            let Self { application, buffer, inlet, .. } = self;
            tokio::select! {
                opened = application.opened_or_closed() => { opened?; application.look(); }
                read = application.read(buffer) => {
                    let said = &buffer[..read?];
                    let time = inlet.borrow().timeline().now();
                    record_said(inlet, time, said);
                    self.unsent += said.len();
                }
                written = application.flush() => application.flushed(written?, inlet),
            }
        }
    }

    fn report_unsent(&mut self) {
        if self.unsent > 0 {
            let text = format!(
                "{} bytes that the application wrote to {} did not reach the port",
                std::mem::take(&mut self.unsent),
                self.application.path().display()
            );
            self.inlet.borrow_mut().notice(Level::Warning, text);
        }
    }

    /// Takes what both sides have already said, and lets it reach the other side.
    async fn finish(&mut self, mut port: Port) -> io::Result<()> {
        let mut last = LastReads::new();
        while last.more()
            && let Ok(length @ 1..) = port.read_now(&mut self.buffer)
        {
            last.took(length);
            hear(&mut port, &mut self.application, self.inlet, &self.buffer[..length])?;
        }
        let mut last = LastReads::new();
        while last.more()
            && let Ok(length @ 1..) = self.application.read_now(&mut self.buffer)
        {
            last.took(length);
            let said = &self.buffer[..length];
            let time = self.inlet.borrow().timeline().now();
            record_said(self.inlet, time, said);
            let passed = self.to_port.pass(said, |bytes| port.write_now(bytes));
            self.unsent += if passed.is_err() { length } else { 0 };
        }
        let end = Instant::now() + LAST_WRITES;
        while !(self.to_port.is_empty() && port.unsent() == 0) && Instant::now() < end {
            match port.write_now(self.to_port.front()) {
                Ok(count) => self.to_port.advance(count),
                Err(_) => break,
            }
            sleep(Duration::from_millis(5)).await;
        }
        self.unsent += self.to_port.clear();
        self.report_unsent();
        port.check_overruns(self.inlet);
        Ok(())
    }
}

/// The device said something: on to the application first, then into the recording.
fn hear(
    port: &mut Port,
    application: &mut Application,
    inlet: &RefCell<Inlet>,
    read: &[u8],
) -> io::Result<()> {
    let time = inlet.borrow().timeline().now();
    let Some(bytes) = port.unmark(time, read) else { return Ok(()) };
    application.pass(&bytes.data, inlet)?;
    inlet.borrow_mut().push_one(time, Frame::Serial(bytes));
    Ok(())
}

fn record_said(inlet: &RefCell<Inlet>, time: crate::frame::Timestamp, said: &[u8]) {
    let (direction, data, errors) = (Direction::Tx, said.to_vec(), Vec::new());
    inlet.borrow_mut().push_one(time, Frame::Serial(SerialBytes { direction, data, errors }));
}
