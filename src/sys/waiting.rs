//! Letting tokio wait for a descriptor of ours.

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::rc::Rc;

use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

use super::can_socket::CanSocket;
use super::link::LinkWatch;

/// What owns one descriptor for all of its life, and says so whenever it is asked.
pub trait OneDescriptor: AsFd + AsRawFd + sealed::Sealed {}

mod sealed {
    pub trait Sealed {}
}

impl OneDescriptor for OwnedFd {}
impl OneDescriptor for Rc<CanSocket> {}
impl OneDescriptor for LinkWatch {}
impl sealed::Sealed for OwnedFd {}
impl sealed::Sealed for Rc<CanSocket> {}
impl sealed::Sealed for LinkWatch {}

/// A descriptor that tokio waits for, as long as this lives.
#[derive(Debug)]
pub struct Waiting<T: OneDescriptor>(AsyncFd<T>);

impl<T: OneDescriptor> Waiting<T> {
    /// Starts to wait. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// Where epoll is out of watches or memory.
    pub fn new(inner: T, interest: Interest) -> io::Result<Self> {
        // SAFETY: a `OneDescriptor` owns its descriptor, so it is open and stays the same one
        // while `inner` lives; `inner` moves into the AsyncFd, and nobody gets it back or a
        // mutable reference to it, since the AsyncFd is private here.
        Ok(Self(unsafe { AsyncFd::register_with_interest(inner, interest) }?))
    }

    /// Waits until there is something to do, and does it. `WouldBlock` of `act` says that nothing
    /// is left, so that the next call waits for the kernel's next signal. Nothing is done if this
    /// is dropped while it waits.
    ///
    /// # Errors
    /// Those of `act`; an error of its own when the runtime shuts down.
    pub async fn act<R>(
        &self,
        interest: Interest,
        act: impl FnOnce(&T) -> io::Result<R>,
    ) -> io::Result<R> {
        // Not AsyncFd::try_io: with two interests it finds neither and never calls `act`
        // (tokio 1.54).
        let mut ready = self.0.ready(interest).await?;
        let acted = ready.try_io(|inner| act(inner.get_ref()));
        acted.unwrap_or_else(|_| Err(io::ErrorKind::WouldBlock.into()))
    }
}
