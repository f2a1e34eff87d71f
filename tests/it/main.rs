//! The recorder as its users meet it: the real binary, real files, real terminals, real faults.
//!
//! Each test is named after what it promises. Files are checked with [`support::mcap`], a strict
//! reader that shares no code with the recorder, and with the reference readers in Python and
//! TypeScript of `tests/lab`.

#![allow(
    unsafe_code,
    clippy::type_complexity,
    clippy::needless_range_loop,
    clippy::borrow_as_ptr,
    clippy::stable_sort_primitive,
    clippy::format_collect,
    clippy::case_sensitive_file_extension_comparisons,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::panic_in_result_fn,
    clippy::cast_possible_truncation,
    reason = "a test that cannot go on fails by panicking; what a child may use is set before exec"
)]

mod architecture;
mod blf;
mod can_rules;
mod cat;
mod cli;
mod config;
mod convert;
mod decoded;
mod disk;
mod errors;
mod export;
mod export_frames;
mod export_protocols;
mod export_trouble;
mod floods;
mod foxglove;
mod hostile;
mod hostile_logs;
mod import;
mod import_honesty;
mod kill;
mod logs;
mod mark;
mod mf4;
mod names;
mod record;
mod recover;
mod replay;
mod retention;
mod retime;
mod segments;
mod serial;
mod service;
mod simulate;
mod slow;
mod support;
mod trigger;
mod windows;
