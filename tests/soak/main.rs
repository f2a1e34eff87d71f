//! The field recorder's promises at full length: `cargo soak`.
//!
//! Each item is a promise of `docs/guarantees.md` with the number of runs it is promised for. The
//! ordinary tests have a short form of each; this program is for hours. It prints a table, keeps
//! what each item found in `target/soak/`, writes `docs/guarantees-report.md` of it with `--report`,
//! and exits 1 if a promise was broken.

#![allow(
    dead_code,
    unused_imports,
    unsafe_code,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::panic_in_result_fn,
    clippy::type_complexity,
    clippy::cast_possible_truncation,
    clippy::borrow_as_ptr,
    clippy::stable_sort_primitive,
    clippy::format_collect,
    clippy::case_sensitive_file_extension_comparisons,
    clippy::needless_range_loop,
    reason = "a run that cannot go on ends by panicking, which is counted; shared parts of the tests"
)]

mod adapter;
mod books;
mod calls;
#[path = "../it/disk.rs"]
mod disk;
mod disklog;
mod disks;
mod feed;
#[path = "../it/floods.rs"]
mod floods;
mod fuzz;
mod guest;
mod hostile;
#[path = "../it/hostile.rs"]
mod hostile_tests;
mod item;
mod kills;
#[path = "../socketcan/lab.rs"]
mod lab;
mod long;
mod options;
mod power;
#[path = "../it/record.rs"]
mod record;
mod report;
mod runs;
mod serial;
mod signals;
#[path = "../it/support/mod.rs"]
mod support;

use std::process::ExitCode;

use item::Item;
use options::Options;

/// All items, in the order of the table.
const ITEMS: &[Item] = &[
    kills::ITEM,
    calls::KILLED,
    calls::FAILED,
    calls::SYNCS,
    books::ITEM,
    signals::ITEM,
    disks::STALLS,
    disks::FULL,
    disks::RING,
    serial::ITEM,
    power::EXT4,
    power::VFAT,
    serial::FLOODS,
    guest::DROPS,
    guest::LINKS,
    guest::STEPS,
    guest::REPLAY_STEPS,
    fuzz::RECORDINGS,
    fuzz::CUTS,
    fuzz::DEFINITIONS,
    long::SEAMS,
    long::SOAK,
];

fn main() -> ExitCode {
    if let Some(code) = fuzz::child() {
        return code;
    }
    if let Some(code) = guest::child() {
        return code;
    }
    let options = match Options::parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(sentence) => {
            eprintln!("soak: {sentence}");
            return ExitCode::from(2);
        }
    };
    options.run(ITEMS)
}
