//! The life of a CAN bus in a recording: reading, outages, the end.

use std::io;
use std::time::Duration;

use tokio::io::Interest;
use tokio::time::Instant;

use super::bitrate::{self, Rate};
use super::pace::Pace;
use super::port::Port;
use super::reader::Reader;
use super::{CanOptions, CanSettings, SocketCan, interfaces, open};
use crate::capture::{CaptureError, Stop};
use crate::frame::error::BusState;
use crate::frame::{Level, Timestamp};
use crate::queue::Inlet;
use crate::sys::link::{self, Link, LinkWatch};
use crate::sys::{CanBatch, CanSocket, Waiting};

/// How often drops are counted and the link is looked at.
const CHECK: Duration = Duration::from_secs(1);
/// How often the link is looked for while it is down; mostly the kernel says so before.
const CHECK_DOWN: Duration = Duration::from_millis(200);
/// Bytes of the receive buffer that one frame takes, at most: 768 for a classic frame on a 64-bit
/// machine, more for CAN FD with some drivers.
const FRAME_BYTES: usize = 1024;
/// Most reads in one check, so that a flood cannot keep it from ending.
const READS: u32 = 64;

/// Index of no interface.
const NOWHERE: u32 = 0;

/// No end to what is recorded.
const FOREVER: Timestamp = Timestamp(u64::MAX);

/// An interface that is being read.
struct Capture {
    settings: CanSettings,
    options: CanOptions,
    port: Port,
    /// Of the interface that the socket is bound to.
    index: u32,
    batch: CanBatch,
    reader: Reader,
    pace: Pace,
    watch: Option<Waiting<LinkWatch>>,
    /// When the link was last known to be there.
    known: Timestamp,
    next_check: Instant,
    /// A failure to come back is told once an outage.
    told_failure: bool,
}

/// Reads the interface into `inlet` until `stop`, then what the kernel still holds.
pub(super) async fn run(
    source: SocketCan,
    inlet: Inlet,
    mut stop: Stop,
) -> Result<(), CaptureError> {
    let name = source.settings.interface.clone();
    let reader = Reader::new(&name, inlet, source.options.hardware_timestamps);
    let lost = |error: io::Error| CaptureError(format!("cannot read from {name}: {error}"));
    let mut capture = Capture {
        known: reader.inlet.timeline().now(),
        port: Port::new(source.socket).map_err(lost)?,
        index: source.info.index,
        batch: CanBatch::new(),
        reader,
        pace: Pace::new(source.granted * 2 / FRAME_BYTES),
        // Where it is not permitted, the checks find the link too, only later.
        watch: LinkWatch::new().and_then(|w| Waiting::new(w, Interest::READABLE)).ok(),
        next_check: Instant::now() + CHECK,
        told_failure: false,
        settings: source.settings,
        options: source.options,
    };
    // What was received since the opening is older than what is said now.
    capture.check().map_err(lost)?;
    for (level, text) in source.notices {
        capture.reader.inlet.notice(level, text);
    }
    while capture.step(&mut stop).await.map_err(lost)? {}
    if capture.reader.inlet.satisfied() {
        return Ok(()); // What came after the last frame that was asked for does not matter.
    }
    capture.finish().map_err(lost)
}

impl Capture {
    /// Waits for the next thing to do and does it. Returns false when it is time to finish.
    async fn step(&mut self, stop: &mut Stop) -> io::Result<bool> {
        tokio::select! {
            biased;
            () = stop.requested() => return Ok(false),
            () = tokio::time::sleep_until(self.next_check) => self.check()?,
            () = changed(self.watch.as_ref()) => self.check()?,
            received = self.port.receive(&mut self.batch) => self.read(received)?,
        }
        Ok(!self.reader.inlet.satisfied())
    }

    /// Records what one read returned, and chooses how to wait for the next.
    fn read(&mut self, received: io::Result<usize>) -> io::Result<()> {
        match received {
            Ok(count) => {
                let now = self.reader.take(self.batch.messages(), FOREVER).unwrap_or(self.known);
                if self.batch.is_full() {
                    self.pace.go_on(count);
                    return Ok(());
                }
                self.port.nap(self.pace.nap_after(count, now))
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                self.pace.rest();
                self.port.nap(None)
            }
            Err(error) => self.trouble(error).and_then(|()| self.check()),
        }
    }

    /// Takes note that the link went away; any other error is the end of this source.
    fn trouble(&mut self, error: io::Error) -> io::Result<()> {
        match error.raw_os_error() {
            Some(libc::ENETDOWN | libc::ENODEV) => self.reader.link_lost(self.known),
            Some(libc::EINTR) => {}
            _ => return Err(error),
        }
        Ok(())
    }

    /// Once a second, and whenever something about the link may have changed: reads all there is,
    /// counts what was dropped behind it, and looks at the link.
    fn check(&mut self) -> io::Result<()> {
        // In this order a drop is either in front of a frame that is now read, or behind all.
        let drops = self.port.socket().drops()?;
        let now = self.reader.inlet.timeline().now();
        if self.drain(FOREVER, READS)? {
            self.reader.settle(drops, now);
        }
        match link::link(&self.settings.interface) {
            Ok(link) => self.look_at(link)?,
            Err(error) => self.tell_failure(&error),
        }
        self.reader.tell_news(now);
        let soon = if self.reader.is_down() { CHECK_DOWN } else { CHECK };
        self.next_check = Instant::now() + soon;
        Ok(())
    }

    /// Reads at most `reads` batches up to the moment `until`. True if there is nothing left.
    fn drain(&mut self, until: Timestamp, reads: u32) -> io::Result<bool> {
        for _ in 0..reads {
            let before = self.reader.inlet.timeline().now();
            match self.port.socket().receive(&mut self.batch) {
                Ok(_) if self.reader.take(self.batch.messages(), until).is_some() => {}
                Ok(_) => return Ok(true),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if !self.reader.is_down() {
                        self.known = before;
                    }
                    return Ok(true);
                }
                Err(error) => self.trouble(error)?,
            }
        }
        Ok(false)
    }

    fn look_at(&mut self, link: Option<Link>) -> io::Result<()> {
        let name = &self.settings.interface;
        let Some(link) = link else {
            let text = match renamed(self.index) {
                Some(new) => format!(
                    "{name} is called {new} now: recording goes on when there is a {name} again"
                ),
                None => format!("{name} is gone: recording goes on when it is back"),
            };
            self.reader.link_down(self.known);
            // Also where it was seen to be down before: then this is news all the same.
            if self.index != NOWHERE {
                self.reader.inlet.notice(Level::Warning, text);
            }
            return self.let_go();
        };
        let state = link.state.and_then(bus_state);
        self.reader.look_at(state, link.errors.map(|(tx, rx)| (tx.into(), rx.into())));
        if link.index != self.index {
            let text = format!("{name} is another interface now: recording goes on with that");
            self.down(text);
            return self.move_to(link);
        }
        if !link.up {
            let text = format!("{name} is down: recording goes on when it is up");
            self.down(text);
        } else if state == Some(BusState::BusOff) {
            self.reader.bus_off(self.known);
        } else if self.reader.is_bus_off() && state.is_none() {
            // The kernel does not know; the controller will say so itself.
        } else if self.reader.is_down() {
            // The first frame after the outage says more exactly when it ended.
            let now = self.reader.inlet.timeline().now();
            self.drain(FOREVER, READS)?;
            self.reader.link_up(now);
            self.known = now;
            self.told_failure = false;
        }
        Ok(())
    }

    fn down(&mut self, text: String) {
        if self.reader.link_down(self.known) {
            self.reader.inlet.notice(Level::Warning, text);
        }
    }

    /// Stops listening to an interface that has lost the name, if it still exists: a socket that
    /// is bound to nothing receives nothing.
    fn let_go(&mut self) -> io::Result<()> {
        if self.index != NOWHERE {
            self.port = Port::new(CanSocket::new()?)?;
            self.reader.new_socket();
            self.index = NOWHERE;
        }
        Ok(())
    }

    /// Listens to an interface that has taken the name. Bound before it is up, so that its first
    /// frame is not missed.
    fn move_to(&mut self, link: Link) -> io::Result<()> {
        match open::again(&self.settings, &self.options, link.index) {
            Ok(socket) => self.port = Port::new(socket)?,
            Err(error) => {
                self.tell_failure(&error);
                return Ok(());
            }
        }
        self.index = link.index;
        self.reader.new_socket();
        if !link.up {
            self.set_rate(&link);
        }
        let link = link::link(&self.settings.interface)?.filter(|now| now.index == self.index);
        if link.is_some() { self.look_at(link) } else { Ok(()) }
    }

    /// An adapter that was plugged in again has forgotten its bit rate.
    fn set_rate(&mut self, link: &Link) {
        match bitrate::ensure(&self.settings, &interfaces::describe(link.clone())) {
            Ok(Rate::Set(text)) => self.reader.inlet.notice(Level::Info, text),
            Ok(Rate::AsAsked | Rate::Ignored(_)) => {}
            Err(error) => self.reader.inlet.notice(Level::Warning, error.to_string()),
        }
    }

    fn tell_failure(&mut self, error: &io::Error) {
        if !self.told_failure {
            self.told_failure = true;
            let text = format!("cannot listen to {} again: {error}", self.settings.interface);
            self.reader.inlet.notice(Level::Warning, text);
        }
    }

    /// Reads what was received up to now, and counts what was dropped up to now.
    fn finish(&mut self) -> io::Result<()> {
        let end = self.reader.inlet.timeline().now();
        let drops = self.port.socket().drops()?;
        // Bounded by what was received before `end`, which the kernel has already queued.
        while !self.drain(end, READS)? {}
        self.reader.settle(drops, end);
        self.reader.finish(end);
        Ok(())
    }
}

/// The name that an interface has now.
fn renamed(index: u32) -> Option<String> {
    let links = link::links().ok()?;
    links.into_iter().find(|link| link.index == index).map(|link| link.name)
}

/// `enum can_state` of `linux/can/netlink.h`; stopped and sleeping controllers are down.
fn bus_state(state: u32) -> Option<BusState> {
    match state {
        0 => Some(BusState::Active),
        1 => Some(BusState::Warning),
        2 => Some(BusState::Passive),
        3 => Some(BusState::BusOff),
        _ => None,
    }
}

/// Returns when some link has changed.
async fn changed(watch: Option<&Waiting<LinkWatch>>) {
    let Some(watch) = watch else { return std::future::pending().await };
    // `clear` reads up to WouldBlock; another error means that the runtime shuts down.
    match watch.act(Interest::READABLE, LinkWatch::clear).await {
        Err(error) if error.kind() != io::ErrorKind::WouldBlock => std::future::pending().await,
        _ => {}
    }
}
