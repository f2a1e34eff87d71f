//! Serial lines: ports, taps, bridges and pseudo-terminals.
//!
//! Every read becomes one frame, exactly as the kernel returned it and stamped right after the
//! read. That stamp can be no better than the way to it: a USB bridge collects bytes for up to its
//! latency timer (16 ms on common ones, 1 ms with `lowlatency`).
//!
//! Modem lines: the kernel raises DTR and RTS when a port is opened, and no program can prevent it
//! (boards that reset on DTR will). Nothing here changes them afterwards, and a port that only
//! listens leaves them as they are when it is closed. Breaks, rates and modem lines that an
//! application sets on the pseudo-terminal of a bridge do not reach the real port.

mod address;
mod application;
mod bridge;
mod identity;
pub(super) mod last;
mod link;
mod listen;
pub mod marks;
pub(super) mod open;
pub(super) mod port;
mod ports;
mod pty;
mod relay;
mod settings;
pub(super) mod supervise;
mod trouble;

pub use address::SerialAddress;
pub use bridge::Bridge;
pub(crate) use link::Link;
pub use listen::Listen;
pub(crate) use open::{PortSpec, Use};
pub use ports::{PortInfo, serial_ports};
pub use pty::PtySource;
pub(crate) use pty::linked;
pub use settings::{FlowControl, Parity, SerialSettings, SettingsError, StopBits};
