//! bustape: a flight recorder for field buses.

pub mod capture;
pub mod clock;
pub mod frame;
pub mod record;
pub mod simulate;
