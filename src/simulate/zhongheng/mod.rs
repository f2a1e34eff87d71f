//! A telecom rectifier system behind an RS232 line: a Zhongheng 09-series monitor (the slave), the
//! 48 V plant it looks after, and a supervision computer that polls it (the master).
//!
//! Everything follows the "Zhongheng 09-series RS232 protocol"; sections are named where they are
//! used. Where the document is silent, the choice made here and its reason stand in a comment.
//!
//! | where | what |
//! |---|---|
//! | [`frame`] | framing, escaping, CRC (section 3) |
//! | [`layout`], [`settings_table`], [`readings_table`] | the 32 commands, field by field (section 8) |
//! | [`plant`], [`rectifier`], [`alarm`] | the simulated 48 V plant and its alarms |
//! | [`slave`], [`fault`] | answers, and what can go wrong with them |
//! | [`master`] | asks |

pub mod alarm;
pub mod fault;
pub mod frame;
pub mod layout;
pub mod master;
pub mod plant;
pub mod readings_table;
pub mod rectifier;
pub mod settings_table;
pub mod slave;
mod values;

pub use master::Master;
pub use slave::Slave;

/// Baud rate, 8N1 (section 1: "configurable, 19200 preferred").
pub const BAUD: u32 = 19_200;

#[cfg(test)]
mod tests;
