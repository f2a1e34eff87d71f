//! System calls that no safe crate offers. The only place for `unsafe`.

pub mod opens;
pub mod pty;
pub mod tty;
pub mod wait;
