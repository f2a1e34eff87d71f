//! Devices that do not exist: a hybrid solar power station and a telecom rectifier system.
//!
//! They feed `bustape demo` and the addresses `sim:hmi-can` and `sim:zhongheng-09`. Everything but
//! [`source`] is pure: no clock, no files, no sockets. Time is an argument and chance comes from a
//! seed, so the same seed gives the same bytes.
//!
//! | where | what |
//! |---|---|
//! | [`random`], [`battery`], [`mains`] | what both simulations are made of |
//! | [`station`] | the physics of the solar power station |

pub mod battery;
pub mod hmi_can;
pub mod mains;
pub mod random;
pub mod station;

/// Simulated time advances in steps of this many seconds.
pub const STEP_SECONDS: f64 = 1.0;
