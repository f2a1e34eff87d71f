//! Waiting for a socket, by the frame or by the clock.

use std::io;
use std::rc::Rc;
use std::time::Duration;

use tokio::io::Interest;

use crate::sys::{CanBatch, CanSocket, Waiting};

/// A socket and the way it is waited for.
pub(super) struct Port {
    socket: Rc<CanSocket>,
    /// `None` while napping: a registered socket would wake the thread for each frame.
    registered: Option<Waiting<Rc<CanSocket>>>,
    nap: Duration,
}

impl Port {
    pub(super) fn new(socket: CanSocket) -> io::Result<Self> {
        let mut port = Self { socket: Rc::new(socket), registered: None, nap: Duration::ZERO };
        port.nap(None)?;
        Ok(port)
    }

    /// How long to wait for the clock instead of for frames, if at all. tokio's clock has steps of
    /// 1 ms, so a nap may last that much longer.
    pub(super) fn nap(&mut self, nap: Option<Duration>) -> io::Result<()> {
        if let Some(nap) = nap {
            self.nap = nap;
            self.registered = None;
        } else if self.registered.is_none() {
            self.registered = Some(Waiting::new(Rc::clone(&self.socket), interest())?);
        }
        Ok(())
    }

    /// Waits until it is time to read, and reads once. Nothing is read, nor lost, if this is
    /// dropped while it waits.
    pub(super) async fn receive(&self, batch: &mut CanBatch) -> io::Result<usize> {
        let Some(registered) = &self.registered else {
            if batch.is_full() {
                // The rest is there already. Other sources get their turn now and then.
                tokio::task::coop::consume_budget().await;
            } else {
                tokio::time::sleep(self.nap).await;
            }
            return self.socket.receive(batch);
        };
        let mut received = Ok(0);
        let told = registered.act(interest(), |socket| {
            received = socket.receive(batch);
            match &received {
                // Frames may wait behind an error.
                Err(error) if error.kind() != io::ErrorKind::WouldBlock => Ok(()),
                Ok(_) if batch.is_full() => Ok(()),
                // Anything less means that the kernel holds no more: wait for its next signal,
                // without another system call to find that out.
                _ => Err(io::ErrorKind::WouldBlock.into()),
            }
        });
        match told.await {
            Err(error) if error.kind() != io::ErrorKind::WouldBlock => Err(error),
            _ => received,
        }
    }

    /// The socket, to read from it whether it is ready or not.
    pub(super) fn socket(&self) -> &CanSocket {
        &self.socket
    }
}

/// An interface that goes down is signalled as an error only.
fn interest() -> Interest {
    Interest::READABLE | Interest::ERROR
}
