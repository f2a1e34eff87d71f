//! Puts a descriptor on tokio's event loop.

use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::rc::Rc;

use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// Something that owns one open descriptor from its making to its drop.
///
/// # Safety
///
/// `as_raw_fd` must return the same descriptor each time, and it must stay open as long as the
/// value lives, also when the value is moved.
pub unsafe trait OwnsDescriptor: AsRawFd {}

// SAFETY: an OwnedFd is one open descriptor until it is dropped.
unsafe impl OwnsDescriptor for OwnedFd {}
// SAFETY: each holds an OwnedFd in a private field that is never replaced, and returns it.
unsafe impl OwnsDescriptor for super::tty::Tty {}
// SAFETY: as above.
unsafe impl OwnsDescriptor for super::pty::Pty {}
// SAFETY: as above.
unsafe impl OwnsDescriptor for super::opens::Opens {}
// SAFETY: as above.
unsafe impl OwnsDescriptor for super::link::LinkWatch {}
// SAFETY: as above; what is shared stays open until the last owner is gone.
unsafe impl OwnsDescriptor for Rc<super::CanSocket> {}

/// Lets the event loop wait for `interest` on a descriptor, which must be non-blocking. Call it
/// on the runtime.
pub fn register<T: OwnsDescriptor>(inner: T, interest: Interest) -> io::Result<AsyncFd<T>> {
    // SAFETY: `OwnsDescriptor` promises what is asked for: one descriptor, open as long as `inner`
    // lives, and AsyncFd owns `inner`.
    Ok(unsafe { AsyncFd::register_with_interest(inner, interest) }?)
}

/// A descriptor that tokio waits for, as long as this lives.
#[derive(Debug)]
pub struct Waiting<T: OwnsDescriptor>(AsyncFd<T>);

impl<T: OwnsDescriptor> Waiting<T> {
    /// Starts to wait. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// Where epoll is out of watches or memory.
    pub fn new(inner: T, interest: Interest) -> io::Result<Self> {
        register(inner, interest).map(Self)
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
