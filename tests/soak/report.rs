//! `docs/guarantees-report.md`, of what the items have found.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::item::Item;
use super::options::kept;

const HEAD: &str = "\
# What the last full runs found

Made by `cargo soak --report` of what `cargo soak` found; [guarantees.md](guarantees.md) says what is
promised and which tests hold it. Each item names its own day, program and seed, for they can run apart.
Where fewer runs were done than are promised, the first column says so.
";

const REMARKS: &str = "\n## Remarks\n";

/// Writes the report.
pub fn write(items: &[Item]) {
    let mut text = HEAD.to_owned();
    let _ = writeln!(text, "\nMachine: {}.", machine());
    let _ =
        writeln!(text, "\n| item | runs | broken | time | day (UTC) | commit, program | seed |");
    let _ = writeln!(text, "|---|---|---|---|---|---|---|");
    let mut details = String::new();
    for item in items {
        let Some(result) = std::fs::read_to_string(kept(item.name)).ok() else {
            let _ = writeln!(text, "| {} | **not run** | | | | | |", item.name);
            continue;
        };
        let result: Value = serde_json::from_str(&result).expect("our own JSON");
        row(&mut text, item, &result);
        let _ = writeln!(details, "\n## {}\n\n{}.\n", item.name, item.promise);
        for (name, value) in numbers(&result) {
            let _ = writeln!(details, "- {name}: {value}");
        }
        for violation in result["violations"].as_array().into_iter().flatten() {
            let lines = violation.as_str().unwrap_or_default().lines();
            let _ = writeln!(details, "- **broken**: {}", lines.collect::<Vec<_>>().join(" "));
        }
    }
    text.push_str(&details);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guarantees-report.md");
    // What a person has to say about these runs stays.
    let before = std::fs::read_to_string(&path).unwrap_or_default();
    if let Some(at) = before.find(REMARKS) {
        text.push_str(&before[at..]);
    }
    std::fs::write(&path, text).expect("the report can be written");
    println!("\n{}", path.display());
}

fn row(text: &mut String, item: &Item, result: &Value) {
    let number = |key: &str| result[key].as_u64().unwrap_or(0);
    let done = number("done");
    let all = result["all"].as_u64().unwrap_or(item.count);
    let of = if done < all { format!(" of {all}") } else { String::new() };
    let broken = result["violations"].as_array().map_or(0, Vec::len);
    let time = std::time::UNIX_EPOCH + std::time::Duration::from_secs(number("ended"));
    let day = jiff::Timestamp::try_from(time).map(|t| t.strftime("%Y-%m-%d %H:%M").to_string());
    let _ = writeln!(
        text,
        "| [{}](#{}) | {done}{of} {} | {broken} | {} s | {} | {}, {} | {} |",
        item.name,
        item.name,
        item.unit,
        number("seconds"),
        day.unwrap_or_default(),
        result["commit"].as_str().unwrap_or(""),
        result["program"].as_str().unwrap_or(""),
        number("seed"),
    );
}

/// The numbers of a result.
pub fn numbers(result: &Value) -> impl Iterator<Item = (&str, &str)> {
    let list = result["numbers"].as_array().into_iter().flatten();
    list.filter_map(|pair| Some((pair[0].as_str()?, pair[1].as_str()?)))
}

/// Which build a program is: its folder below `target` and its version.
pub fn program(path: &Path) -> String {
    let build = if path.components().any(|part| part.as_os_str() == "release") {
        "release build"
    } else {
        "development build"
    };
    format!("{} {build}", first_line(Command::new(path).arg("--version")))
}

/// The commit of the tree, with a `+` if there are changes beside it.
pub fn commit() -> String {
    let git = |args: &[&str]| {
        first_line(Command::new("git").args(args).current_dir(env!("CARGO_MANIFEST_DIR")))
    };
    let changed = if git(&["status", "--porcelain", "src"]).is_empty() { "" } else { "+" };
    format!("{}{changed}", git(&["rev-parse", "--short", "HEAD"]))
}

fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let system = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let system = system.lines().find_map(|line| line.strip_prefix("PRETTY_NAME=")).unwrap_or("");
    let kernel = first_line(Command::new("uname").arg("-r"));
    let model = model.map_or("", |(_, name)| name);
    let version = |name: &str, option: &str| first_line(Command::new(name).arg(option));
    format!(
        "{cores} × {model}, kernel {kernel}, {}, {}, {}",
        system.trim_matches('"'),
        version("rustc", "--version"),
        version("strace", "--version"),
    )
}

fn first_line(command: &mut Command) -> String {
    let output = command.output().map(|output| output.stdout).unwrap_or_default();
    String::from_utf8_lossy(&output).lines().next().unwrap_or("").to_owned()
}
