//! Runs commands when triggers fire, on a thread of its own.

use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::Fired;
use crate::text::rfc3339;

/// Most commands that run at once, and as many wait.
const MOST: usize = 8;
/// Time between looks at which have ended.
const LOOK: Duration = Duration::from_millis(100);

/// Where commands are run. Dropping it kills those that still run.
pub struct Commands {
    orders: Option<SyncSender<Fired>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Commands {
    /// Starts the thread. `say` gets a sentence about each command that fails.
    pub fn start(say: impl Fn(String) + Send + 'static) -> std::io::Result<Self> {
        let (orders, incoming) = sync_channel(MOST);
        let thread = std::thread::Builder::new().name("triggers".to_owned());
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = thread.spawn(move || work(&incoming, &stopped, &say))?;
        Ok(Self { orders: Some(orders), stop, thread: Some(thread) })
    }

    /// Runs what `fired` asks for. False when too many run already; it never waits.
    pub fn run(&self, fired: &Fired) -> bool {
        self.orders.as_ref().is_some_and(|orders| orders.try_send(fired.clone()).is_ok())
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

fn work(incoming: &Receiver<Fired>, stop: &AtomicBool, say: &dyn Fn(String)) {
    let mut running: Vec<(String, Child)> = Vec::new();
    while !stop.load(Relaxed) {
        running.retain_mut(|(name, child)| match child.try_wait() {
            Ok(None) => true,
            Ok(Some(status)) if status.success() => false,
            Ok(Some(status)) => {
                say(format!("the command of trigger {name} has ended with {status}"));
                false
            }
            Err(_) => false,
        });
        if running.len() >= MOST {
            std::thread::sleep(LOOK);
            continue;
        }
        match incoming.recv_timeout(LOOK) {
            Ok(fired) => match spawn(&fired) {
                Ok(child) => running.push((fired.name, child)),
                Err(error) => say(format!(
                    "cannot run {} for trigger {}: {error}",
                    fired.run.first().map_or("", String::as_str),
                    fired.name
                )),
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    for (_, mut child) in running {
        child.kill().ok();
        child.wait().ok();
    }
}

fn spawn(fired: &Fired) -> std::io::Result<Child> {
    let mut words = fired.run.iter();
    let mut command = Command::new(words.next().map_or("", String::as_str));
    command.args(words).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.env("BUSTAPE_TRIGGER", &fired.name).env("BUSTAPE_CONDITION", &fired.condition);
    command.env("BUSTAPE_TIME", rfc3339(fired.time));
    command.env("BUSTAPE_BUS", fired.bus.as_deref().unwrap_or_default());
    command.env("BUSTAPE_VALUE", fired.value.map(|value| value.to_string()).unwrap_or_default());
    // Not its business to speak for the service.
    command.env_remove("NOTIFY_SOCKET").env_remove("WATCHDOG_USEC");
    command.spawn()
}
