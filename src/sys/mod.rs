//! System calls. The only place with unsafe code; every unsafe block says why it is sound.

mod can_batch;
mod can_socket;
mod clock;
pub mod link;
mod netlink;
mod waiting;

pub use can_batch::{CanBatch, RawMessage};
pub use can_socket::CanSocket;
pub use clock::SystemClock;
pub use waiting::{OneDescriptor, Waiting};
