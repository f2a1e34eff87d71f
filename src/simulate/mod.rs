//! Devices that do not exist: a hybrid solar power station and a telecom rectifier system.
//!
//! They feed `bustape demo`, `bustape simulate` and the addresses `sim:hmi-can` and
//! `sim:zhongheng-09`. Everything but the last two rows below is pure: no clock, no files, no
//! sockets. Time is an argument and chance comes from a seed, so the same seed gives the same bytes.
//!
//! | where | what |
//! |---|---|
//! | [`random`], [`battery`], [`mains`] | what both simulations are made of |
//! | [`station`] | the physics of the solar power station |
//! | [`hmi_can`] | its CAN bus: state, events, the operator's panel |
//! | [`zhongheng`] | a telecom rectifier plant behind its RS232 monitor |
//! | [`faults`] | how often something goes wrong |
//! | [`source`], [`rectifier_line`] | both as sources, in real time |
//! | [`mod@line`], [`hmi_can::onto_can`] | both on lines and buses of the kernel |

#![allow(clippy::cast_possible_truncation, reason = "physics in f64 becomes fields of a protocol")]

pub mod battery;
pub mod faults;
pub mod hmi_can;
pub mod line;
pub mod mains;
pub mod random;
pub mod rectifier_line;
pub mod source;
pub mod station;
pub mod zhongheng;

/// Simulated time advances in steps of this many seconds.
pub const STEP_SECONDS: f64 = 1.0;
