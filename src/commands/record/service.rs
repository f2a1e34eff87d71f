//! What a service manager is told: ready, how it goes, still alive, stopping (sd_notify(3)).
//!
//! Alive means that the writer has gone round since it was last asked: a recorder whose disk hangs is
//! restarted by its unit's `WatchdogSec=`.

use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

use crate::queue::Totals;
use crate::record::State;
use crate::text::{grouped, size};

/// The service manager, where there is one.
pub struct Service {
    socket: Option<UnixDatagram>,
    /// Between two signs of life.
    interval: Option<Duration>,
    alive: Instant,
    /// The writer's rounds at the last sign of life.
    rounds: u64,
    told: Option<Instant>,
}

impl Service {
    /// Finds it by `NOTIFY_SOCKET` and `WATCHDOG_USEC`.
    pub fn find() -> Self {
        let socket = std::env::var("NOTIFY_SOCKET").ok().and_then(|name| connect(&name));
        let number = |name: &str| std::env::var(name).ok()?.parse::<u64>().ok();
        let ours = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        // Half of it, as sd_watchdog_enabled(3) advises; the writer needs some of that.
        let interval = number("WATCHDOG_USEC").filter(|micros| *micros > 0 && ours);
        let interval = interval.map(|micros| Duration::from_micros(micros / 3));
        Self { socket, interval, alive: Instant::now(), rounds: 0, told: None }
    }

    /// Frames are taken and written.
    pub fn ready(&self) {
        self.say("READY=1");
    }

    /// The last file is being finished.
    pub fn stopping(&self) {
        self.say("STOPPING=1\nSTATUS=finishing the file");
    }

    /// Called several times a second.
    pub fn go_on(&mut self, totals: &[Totals], state: &State) {
        let now = Instant::now();
        let due = self.interval.is_some_and(|interval| now - self.alive >= interval);
        if due && state.rounds != self.rounds {
            (self.alive, self.rounds) = (now, state.rounds);
            self.say("WATCHDOG=1");
        }
        if self.socket.is_none() || self.told.is_some_and(|told| now - told < STATUS_EVERY) {
            return;
        }
        self.told = Some(now);
        let file = state.file.file_name().unwrap_or_default().to_string_lossy();
        self.say(&format!(
            "STATUS={} buses, {} received, {} dropped, {} in {}",
            totals.len(),
            grouped(totals.iter().map(|totals| totals.received).sum()),
            grouped(totals.iter().map(Totals::lost).sum()),
            size(state.earlier_bytes + state.file_bytes),
            crate::text::printable(&file),
        ));
    }

    fn say(&self, text: &str) {
        if let Some(socket) = &self.socket {
            // Whether anybody listens is not our concern.
            socket.send(text.as_bytes()).ok();
        }
    }
}

/// Time between two sentences for `systemctl status`.
const STATUS_EVERY: Duration = Duration::from_secs(5);

/// A path, or after `@` a name in the abstract namespace (unix(7)).
fn connect(name: &str) -> Option<UnixDatagram> {
    let address = match name.strip_prefix('@') {
        Some(name) => SocketAddr::from_abstract_name(name).ok()?,
        None => SocketAddr::from_pathname(name).ok()?,
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.connect_addr(&address).ok()?;
    // A manager that does not read must not hold up the recording.
    socket.set_nonblocking(true).ok()?;
    Some(socket)
}
