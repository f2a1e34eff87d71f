//! Which folders an export may replace: those that hold nothing but what an export writes.

use std::fs;
use std::path::Path;

use super::output::{OutputError, failed};

/// Rows of tables that wait for their file.
pub const WAITING_ROWS: &str = "rows.part";
/// Endings of the files in folders.
const ENDINGS: [&str; 4] = ["parquet", "csv", "jsonl", "influx"];

/// An error if `folder` holds anything that no export puts there.
pub(super) fn refuse(folder: &Path) -> Result<(), OutputError> {
    let Ok(about) = folder.symlink_metadata() else { return Ok(()) };
    let foreign = |path: &Path| {
        OutputError(format!(
            "{} is not the work of an export, so {} is not replaced; choose another name",
            path.display(),
            folder.display()
        ))
    };
    if !about.is_dir() {
        return Err(foreign(folder));
    }
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).map_err(|e| failed("read", &inside, &e))? {
            let entry = entry.map_err(|e| failed("read", &inside, &e))?;
            let (path, kind) = (entry.path(), entry.file_type());
            let ours = path.strip_prefix(folder).is_ok_and(is_ours);
            match kind {
                Ok(kind) if kind.is_dir() => folders.push(path),
                Ok(kind) if kind.is_file() && ours => {}
                _ => return Err(foreign(&path)),
            }
        }
    }
    Ok(())
}

/// True for the path that a file of an export has in its folder. The ending alone says too little:
/// an unfinished recording ends in `.part`, too, and notes of a person may well be a CSV file.
fn is_ours(path: &Path) -> bool {
    let Some(parts) = path.iter().map(|part| part.to_str()).collect::<Option<Vec<_>>>() else {
        return false;
    };
    let name = |part: &str| {
        let part = part.strip_suffix(".part").unwrap_or(part);
        let (stem, ending) = part.rsplit_once('.')?;
        Some((stem.to_owned(), ENDINGS.into_iter().find(|known| *known == ending)?))
    };
    match parts[..] {
        [WAITING_ROWS] => true,
        [file] => name(file).is_some_and(|(stem, _)| is_period(&stem)),
        [_, file] => name(file).is_some_and(|(_, ending)| ending == "csv"),
        [bus, message, file] => {
            bus.starts_with("bus=")
                && message.starts_with("message=")
                && name(file)
                    .is_some_and(|(stem, end)| end == "parquet" && stem.starts_with("part-"))
        }
        _ => false,
    }
}

/// True for `2026-11-22` and `2026-11-22T03`, also with the number of a part: `2026-11-22-1`.
fn is_period(stem: &str) -> bool {
    let like = |text: &str, form: &str| {
        text.len() == form.len()
            && text.bytes().zip(form.bytes()).all(|(byte, form)| match form {
                b'0' => byte.is_ascii_digit(),
                mark => byte == mark,
            })
    };
    let date = "0000-00-00";
    let (Some(day), Some(rest)) = (stem.get(..date.len()), stem.get(date.len()..)) else {
        return false;
    };
    let hour = rest.get(..3).filter(|hour| like(hour, "T00"));
    let number = hour.map_or(rest, |_| &rest[3..]);
    let numbered = number.strip_prefix('-').is_some_and(|digits| {
        !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit())
    });
    like(day, date) && (number.is_empty() || numbered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_exports_write_is_theirs_and_nothing_else_is() {
        for ours in [
            "bus=can0/message=Engine/part-0000.parquet",
            "bus=can0/message=Engine/part-2026-11-22T03-0001.parquet.part",
            "can0/Engine.csv",
            "can0/Engine-2026-11-22.csv.part",
            "2026-11-22.csv",
            "2026-11-22T03.jsonl.part",
            "2026-11-22-1.parquet",
            "2026-11-22T03.influx",
            "rows.part",
        ] {
            assert!(is_ours(Path::new(ours)), "{ours}");
        }
        for foreign in [
            "trip.mcap.part",
            "x.mcap",
            "notes.csv",
            "part-0000.parquet",
            "can0/rows.part",
            "can0/x.mcap.part",
            "a/b/c.csv",
            "2026-11-22.txt",
            "2026-11-22T03x.csv",
            "2026-11-2.csv",
            ".part",
        ] {
            assert!(!is_ours(Path::new(foreign)), "{foreign}");
        }
    }
}
