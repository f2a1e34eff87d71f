//! What one item is, and what it found.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};

/// A promise, and the program that tries to break it.
pub struct Item {
    /// Its name on the command line.
    pub name: &'static str,
    /// The promise in one line, without the number of runs.
    pub promise: &'static str,
    /// How many runs were promised.
    pub count: u64,
    /// What is counted: kills, files, cycles.
    pub unit: &'static str,
    /// How many of them go on side by side.
    pub side_by_side: usize,
    /// Does `Job::count` runs.
    pub run: fn(&Job) -> Found,
}

/// What an item is to do.
pub struct Job {
    /// All that is random comes from here.
    pub seed: u64,
    /// How many runs.
    pub count: u64,
    /// How many side by side.
    pub side_by_side: usize,
    /// How long, for items that are measured in time.
    pub duration: Option<Duration>,
    /// The program under test.
    pub bustape: PathBuf,
    /// A folder of its own, removed afterwards.
    pub folder: PathBuf,
}

/// What an item found.
#[derive(Default)]
pub struct Found {
    /// Runs that were done.
    pub done: u64,
    /// How many there are at all, where that is fewer than the item's number.
    pub all: Option<u64>,
    /// Names and numbers for the report.
    pub numbers: Vec<(String, String)>,
    /// Broken promises, each with what is needed to see it again.
    pub violations: Vec<String>,
}

impl Found {
    /// Adds a line for the report.
    pub fn number(&mut self, name: &str, value: impl ToString) {
        self.numbers.push((name.to_owned(), value.to_string()));
    }

    /// Counts a broken promise unless `holds`.
    pub fn require(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.violations.push(what());
        }
    }

    /// As it is kept in `target/soak/`.
    pub fn json(&self) -> Value {
        let numbers: Vec<Value> = self.numbers.iter().map(|(k, v)| json!([k, v])).collect();
        json!({ "done": self.done, "all": self.all, "numbers": numbers, "violations": self.violations })
    }
}

/// The value below which `share` of them are, and the largest; 0 for none.
pub fn spread(values: &mut [f64], share: f64) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = ((values.len() as f64 - 1.0) * share).round().max(0.0) as usize;
    (values.get(at).copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0))
}
