//! Puts a descriptor on tokio's event loop.

use std::io;
use std::os::fd::{AsRawFd, OwnedFd};

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

/// Lets the event loop wait for `interest` on a descriptor, which must be non-blocking. Call it
/// on the runtime.
pub fn register<T: OwnsDescriptor>(inner: T, interest: Interest) -> io::Result<AsyncFd<T>> {
    // SAFETY: `OwnsDescriptor` promises what is asked for: one descriptor, open as long as `inner`
    // lives, and AsyncFd owns `inner`.
    Ok(unsafe { AsyncFd::register_with_interest(inner, interest) }?)
}
