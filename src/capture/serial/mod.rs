//! Serial lines: ports, taps, bridges and pseudo-terminals.
mod address;
pub mod marks;
mod settings;
pub use address::SerialAddress;
pub use settings::{FlowControl, Parity, SerialSettings, SettingsError, StopBits};
