//! System calls. The only place with unsafe code; every unsafe block says why it is sound.

#![allow(unsafe_code, reason = "this is the one place for it")]
#![allow(
    clippy::cast_possible_truncation,
    reason = "constants and sizes of the kernel's structures"
)]

mod can_batch;
mod can_socket;
mod clock;
pub mod link;
mod netlink;
pub mod opens;
mod priority;
pub mod pty;
pub mod tty;
pub mod wait;

pub use can_batch::{CanBatch, RawMessage};
pub use can_socket::CanSocket;
pub use clock::SystemClock;
pub use priority::yield_to_others;
pub use wait::Waiting;
