//! Ctrl-C and SIGTERM, for commands that must tidy up before they end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result};
use tokio::signal::unix::{SignalKind, signal};

/// Exit status of a program that a signal ended (128 + SIGINT), as shells count.
const INTERRUPTED: i32 = 130;

/// Tells whether somebody wants the command to end.
#[derive(Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// From now on SIGINT and SIGTERM only set a flag; the second one ends the process at once.
    pub fn watch() -> Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .build()
            .context("cannot wait for signals")?;
        let (mut interrupt, mut terminate) = {
            let _inside = runtime.enter();
            let listen = |kind| signal(kind).context("cannot wait for signals");
            (listen(SignalKind::interrupt())?, listen(SignalKind::terminate())?)
        };
        let set = Arc::clone(&flag);
        std::thread::spawn(move || {
            runtime.block_on(async {
                loop {
                    tokio::select! {
                        _ = interrupt.recv() => {}
                        _ = terminate.recv() => {}
                    }
                    if set.swap(true, Ordering::Relaxed) {
                        std::process::exit(INTERRUPTED);
                    }
                }
            });
        });
        Ok(Self(flag))
    }

    /// An error once a signal has come.
    pub fn check(&self) -> Result<()> {
        anyhow::ensure!(!self.0.load(Ordering::Relaxed), "interrupted; what was begun is removed");
        Ok(())
    }
}
