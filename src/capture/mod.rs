//! Sources: something outside becomes stamped frames.
//!
//! A [`Source`] is opened before the recording's file exists, so that a wrong name leaves nothing
//! behind, and runs until it is told to stop. It looks after itself: when its link goes away it
//! records a gap, waits, and goes on when the link is back. Capture never touches the disk.

pub mod serial;
pub mod slcan;
pub mod socketcan;

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;

use crate::frame::Unit;
use crate::queue::Inlet;

/// What is known of a bus when it is opened; goes into the metadata `bustape.bus.<name>`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BusFacts {
    /// What its loss is counted in: frames for CAN, bytes for serial.
    pub unit: Option<Unit>,
    /// Nominal bit rate, bit/s, where it is known.
    pub bitrate: Option<u32>,
    /// Bit rate of the data phase of CAN FD, bit/s, where it is known.
    pub data_bitrate: Option<u32>,
    /// Everything else, by name: `kind`, `driver`, `settings`, `timestamps`, `filters`, ...
    pub more: BTreeMap<String, String>,
}

/// Tells every source to finish. Cloned into each of them.
#[derive(Clone)]
pub struct Stop(tokio::sync::watch::Receiver<bool>);

impl Stop {
    /// A switch and the thing that watches it.
    pub fn new() -> (tokio::sync::watch::Sender<bool>, Self) {
        let (switch, watch) = tokio::sync::watch::channel(false);
        (switch, Self(watch))
    }

    /// Returns when it is time to finish.
    pub async fn requested(&mut self) {
        // An error means that the switch is gone: then nobody wants more either.
        self.0.wait_for(|stop| *stop).await.map(|_| ()).unwrap_or_default();
    }

    /// True when it is time to finish.
    pub fn is_requested(&self) -> bool {
        *self.0.borrow()
    }
}

/// What [`Source::run`] returns.
pub type Running<'a> = Pin<Box<dyn Future<Output = Result<(), CaptureError>> + 'a>>;

/// Something frames come from. Opened, but not yet read.
pub trait Source {
    /// What is known of the bus.
    fn facts(&self) -> BusFacts;

    /// Reads into `inlet` until `stop`, then takes what the kernel still holds, counts what it
    /// dropped, and returns. An error ends this source only; the others go on.
    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a;
}

/// Why a bus cannot be captured. The text is the whole sentence: operation, object, next step.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct CaptureError(pub String);
