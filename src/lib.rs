//! bustape: a flight recorder for field buses.

#![cfg_attr(
    test,
    allow(
        clippy::cast_possible_truncation,
        clippy::naive_bytecount,
        clippy::panic_in_result_fn,
        clippy::unused_self,
        reason = "tests say what they mean the short way"
    )
)]

pub mod address;
pub mod capture;
pub mod channels;
pub mod cli;
pub mod clock;
pub mod commands;
pub mod decode;
pub mod export;
pub mod frame;
pub mod import;
pub mod permit;
pub mod protocol;
pub mod queue;
pub mod record;
pub mod recording;
pub mod replay;
pub mod simulate;
pub mod sys;
pub mod text;
pub mod trigger;
