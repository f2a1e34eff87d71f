//! The command line of the soak program, and the table at its end.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};

use serde_json::{Value, json};

use super::item::{Found, Item, Job};
use super::{report, runs};

const USAGE: &str = "\
usage: cargo soak [ITEM...] [options]      all items when none is named
  --list                what there is
  --seed N              all that is random comes from it (default 1)
  --count N             runs of each item (default: what is promised, see --list)
  --share N             an Nth of the promised runs
  --duration T          how long, for items measured in time: 90s, 20m, 8h
  --side-by-side N      runs at the same time (default: see --list)
  --bustape FILE        the program under test (default: the one cargo has just built)
  --report              write docs/guarantees-report.md of what target/soak/ holds
exit status: 0, 1 a promise was broken, 2 wrong usage";

/// What was typed.
pub struct Options {
    items: Vec<String>,
    list: bool,
    report: bool,
    seed: u64,
    count: Option<u64>,
    share: u64,
    duration: Option<Duration>,
    side_by_side: Option<usize>,
    bustape: PathBuf,
}

impl Options {
    /// Understands the command line.
    pub fn parse(args: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut options = Self {
            items: Vec::new(),
            list: false,
            report: false,
            seed: 1,
            count: None,
            share: 1,
            duration: None,
            side_by_side: None,
            bustape: crate::support::process::BUSTAPE.into(),
        };
        let mut args = args;
        while let Some(arg) = args.next() {
            let mut value = || args.next().ok_or(format!("{arg} needs a value\n{USAGE}"));
            let number = |text: String| text.parse::<u64>().map_err(|e| format!("{text}: {e}"));
            match arg.as_str() {
                "--list" => options.list = true,
                "--report" => options.report = true,
                "--seed" => options.seed = number(value()?)?,
                "--count" => options.count = Some(number(value()?)?),
                "--share" => options.share = number(value()?)?.max(1),
                "--side-by-side" => options.side_by_side = Some(number(value()?)?.max(1) as usize),
                "--duration" => {
                    options.duration = Some(bustape::text::parse_duration(&value()?)?);
                }
                "--bustape" => options.bustape = value()?.into(),
                "-h" | "--help" => return Err(USAGE.to_owned()),
                other if other.starts_with('-') => return Err(format!("{other}?\n{USAGE}")),
                _ => options.items.push(arg),
            }
        }
        Ok(options)
    }

    /// Runs what was asked for.
    pub fn run(&self, items: &[Item]) -> ExitCode {
        if self.list {
            for item in items {
                let count = format!("{} {}", item.count, item.unit);
                let side = item.side_by_side;
                println!("{:<14} {count:<22} {side:>2} at once  {}", item.name, item.promise);
            }
            return ExitCode::SUCCESS;
        }
        if let Some(unknown) =
            self.items.iter().find(|name| !items.iter().any(|item| item.name == **name))
        {
            eprintln!("soak: there is no item {unknown}; --list shows what there is");
            return ExitCode::from(2);
        }
        runs::catch_panics();
        let all = self.items.is_empty();
        let chosen =
            |item: &&Item| all && !self.report || self.items.iter().any(|n| n == item.name);
        let results: Vec<(&Item, Value)> =
            items.iter().filter(chosen).map(|item| (item, self.one(item))).collect();
        let mut broken = false;
        println!();
        for (item, result) in &results {
            let violations = result["violations"].as_array().unwrap();
            broken |= !violations.is_empty();
            let state = if violations.is_empty() { "holds " } else { "BROKEN" };
            println!("{state}  {:<14} {} {}", item.name, result["done"], item.unit);
            for (name, value) in report::numbers(result) {
                println!("        {name}: {value}");
            }
            for violation in violations {
                println!("        BROKEN: {}", violation.as_str().unwrap());
            }
        }
        if self.report || all {
            report::write(items);
        }
        ExitCode::from(u8::from(broken))
    }

    fn one(&self, item: &Item) -> Value {
        let folder =
            std::env::temp_dir().join(format!("soak-{}-{}", item.name, std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for the runs");
        let job = Job {
            seed: self.seed,
            count: self.count.unwrap_or((item.count / self.share).max(1)),
            side_by_side: self.side_by_side.unwrap_or(item.side_by_side),
            duration: self.duration,
            bustape: self.bustape.clone(),
            folder: folder.clone(),
        };
        eprintln!("{}: {} {}, seed {}", item.name, job.count, item.unit, job.seed);
        let started = Instant::now();
        let found = caught(item, &job);
        // Empty unless a run that failed has kept its own.
        std::fs::remove_dir(&folder).ok();
        let mut result = found.json();
        result["seed"] = json!(self.seed);
        result["asked"] = json!(job.count);
        result["seconds"] = json!(started.elapsed().as_secs());
        result["ended"] = json!(
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |d| d.as_secs())
        );
        result["program"] = json!(report::program(&job.bustape));
        result["commit"] = json!(report::commit());
        let kept = kept(item.name);
        std::fs::create_dir_all(kept.parent().unwrap()).expect("target/soak");
        let text = serde_json::to_string_pretty(&result).expect("JSON");
        std::fs::write(&kept, text).expect("target/soak can be written");
        result
    }
}

/// An item that cannot go on at all has broken its promise, too.
fn caught(item: &Item, job: &Job) -> Found {
    let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| (item.run)(job)));
    run.unwrap_or_else(|_| Found { violations: vec![runs::said()], ..Found::default() })
}

/// Where the last result of an item is kept.
pub fn kept(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("target/soak").join(format!("{name}.json"))
}
