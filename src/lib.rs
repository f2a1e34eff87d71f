//! bustape: a flight recorder for field buses.

pub mod address;
pub mod capture;
pub mod cli;
pub mod clock;
pub mod commands;
pub mod frame;
pub mod record;
pub mod recording;
pub mod simulate;
pub mod sys;
pub mod text;
