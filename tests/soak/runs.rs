//! Many runs side by side, of which none stops the others.

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::item::{Found, Job};
use crate::support::bytes::Random;

/// Violations that are told in full; the rest are counted.
const TOLD: usize = 20;

/// One run of many.
pub struct Run<'a> {
    /// From 0.
    pub number: u64,
    /// Its own generator.
    pub random: Random,
    /// Its own folder, removed when the run was sound and kept when not.
    pub folder: &'a Path,
    /// The program under test.
    pub bustape: &'a Path,
}

thread_local! {
    static SAID: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Panics of runs are kept for the table instead of being printed.
pub fn catch_panics() {
    std::panic::set_hook(Box::new(|panic| {
        SAID.with(|said| *said.borrow_mut() = panic.to_string());
    }));
}

/// What the last panic on this thread said.
pub fn said() -> String {
    SAID.with(|said| said.take())
}

/// Does `job.count` runs. A run that panics has broken the promise; the others give results.
pub fn runs<R: Send>(job: &Job, work: impl Fn(Run<'_>) -> R + Sync) -> (Found, Vec<R>) {
    let next = AtomicU64::new(0);
    let found = Mutex::new((Found::default(), Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..job.side_by_side {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Relaxed);
                    if number >= job.count {
                        return;
                    }
                    let result = one(job, number, &work);
                    let mut found = found.lock().unwrap();
                    found.0.done += 1;
                    match result {
                        Ok(result) => found.1.push(result),
                        Err(why) => {
                            let kept = job.folder.join(number.to_string());
                            eprintln!("  BROKEN (kept in {}): {why}", kept.display());
                            found.0.violations.push(why);
                        }
                    }
                    if found.0.done.is_multiple_of((job.count / 10).max(1)) {
                        let broken = found.0.violations.len();
                        eprintln!("  {} of {}, {broken} broken", found.0.done, job.count);
                    }
                }
            });
        }
    });
    let (mut found, results) = found.into_inner().unwrap();
    let more = found.violations.len().saturating_sub(TOLD);
    found.violations.truncate(TOLD);
    if more > 0 {
        found.violations.push(format!("and {more} more"));
    }
    (found, results)
}

fn one<R>(job: &Job, number: u64, work: &impl Fn(Run<'_>) -> R) -> Result<R, String> {
    let folder: PathBuf = job.folder.join(number.to_string());
    std::fs::create_dir_all(&folder).expect("a folder");
    let random = Random::new(job.seed << 32 | number);
    let run = Run { number, random, folder: &folder, bustape: &job.bustape };
    let result = catch_unwind(AssertUnwindSafe(|| work(run)));
    match result {
        Ok(result) => {
            std::fs::remove_dir_all(&folder).ok();
            Ok(result)
        }
        Err(_) => {
            // Where this machine has its temporary folders is nothing to anybody else.
            let said = said().replace(&format!("{}/", folder.display()), "");
            Err(format!("run {number} of seed {}: {said}", job.seed))
        }
    }
}
