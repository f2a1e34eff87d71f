//! What a crash leaves: `.part` files that nobody writes any more, made into finished recordings.
//!
//! `NAME.mcap.part` becomes `NAME.mcap`; the original is set aside as `NAME.mcap.damaged` and never
//! changed. In between stands `NAME.mcap.recovery`, which a later run removes if this one is cut off.
//! Whatever is being recorded is locked (`flock`), and so left alone.

use std::fs::{File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use super::segments::{SegmentError, part_of};
use crate::recording::disk::{Disk, RealDisk, folder_of, holder};
use crate::recording::rewrite::{Change, Report, Rewrite, RewriteError};
use crate::recording::segment::Segment;

/// How a file was recovered.
pub enum Recovered {
    /// It is sound and has its name: nothing was to be done.
    Sound(Report),
    /// A sound copy stands in its place.
    Anew {
        /// The sound copy.
        file: PathBuf,
        /// Where the original is now; `None` if it was sound and only got its name.
        aside: Option<PathBuf>,
        /// What was kept and lost.
        report: Report,
    },
    /// The recorder was cut off before it had written anything that can be recognised. Its file is set
    /// aside so that nobody finds it again; one without a byte is removed.
    Nothing {
        /// Where the original is now.
        aside: Option<PathBuf>,
    },
    /// It was told to stop before it was done; all is as before.
    Stopped,
}

/// Asked now and then, with the byte that was reached, whether to go on.
pub type GoOn<'a> = &'a mut dyn FnMut(u64) -> bool;

/// Writes `input` anew as `output`, which must not exist. `None` if it was told to stop.
pub fn rewrite(
    input: &Path,
    output: &Path,
    change: Option<&mut dyn Change>,
    go_on: GoOn<'_>,
) -> Result<Option<Report>, SegmentError> {
    let part = part_of(output);
    for existing in [output, &part] {
        if existing.symlink_metadata().is_ok() {
            return Err(SegmentError(format!(
                "cannot create {}: {} exists and is not overwritten; choose another name",
                output.display(),
                existing.display(),
            )));
        }
    }
    let Some(report) = write(input, &part, change, go_on)? else { return Ok(None) };
    if report.is_empty() {
        return Err(nothing(input));
    }
    RealDisk.rename(&part, output).map_err(|e| {
        SegmentError(format!("cannot rename {} to {}: {e}", part.display(), output.display()))
    })?;
    Ok(Some(report))
}

fn nothing(input: &Path) -> SegmentError {
    SegmentError(format!(
        "{} holds nothing that can be recognised as a part of a recording",
        input.display()
    ))
}

/// Writes and syncs `output`; nothing is left of it after an error, or when nothing was found.
fn write(
    input: &Path,
    output: &Path,
    change: Option<&mut dyn Change>,
    go_on: GoOn<'_>,
) -> Result<Option<Report>, SegmentError> {
    let failed = |error: &io::Error| {
        let output = output.display();
        SegmentError(format!("cannot write {output}: {error}; {} is as it was", input.display()))
    };
    let out = RealDisk.create(output).map(|created| created.file).map_err(|e| failed(&e))?;
    let done = match Rewrite::run(input, out, change, go_on) {
        Ok(Some((_, report))) if report.is_empty() => Ok(Some(report)),
        Ok(Some((mut container, report))) => {
            container.sync().map(|()| Some(report)).map_err(|e| failed(&e))
        }
        Ok(None) => Ok(None),
        Err(RewriteError::Read(error)) => Err(SegmentError(error.to_string())),
        Err(RewriteError::Write(error)) => Err(failed(&error)),
    };
    if !matches!(&done, Ok(Some(report)) if !report.is_empty()) {
        RealDisk.remove(output).ok();
    }
    done
}

/// Puts a sound copy in the place of `input` and sets the original aside.
pub fn recover_in_place(input: &Path, go_on: GoOn<'_>) -> Result<Recovered, SegmentError> {
    // Held to the end, so that nobody else begins to do the same.
    let _lock = lock(input)?;
    let name = final_name(input);
    let is_part = name != input;
    if is_part && name.symlink_metadata().is_ok() {
        if is_empty(input) || !is_empty(&name) {
            return finish_renaming(input, &name);
        }
        RealDisk.remove(&name).map_err(|e| cannot("remove", &name, &e))?;
    }
    let copy = with_ending(&name, ".recovery");
    if copy.exists() {
        // Left behind by a run that was cut off, or at work just now.
        drop(lock(&copy)?);
        RealDisk.remove(&copy).map_err(|e| cannot("remove", &copy, &e))?;
    }
    let Some(report) = write(input, &copy, None, go_on)? else { return Ok(Recovered::Stopped) };
    if report.is_empty() {
        return if is_part { set_nothing_aside(input, &name) } else { Err(nothing(input)) };
    }
    if report.is_whole() && report.index_bytes == 0 && has_end(input)? {
        RealDisk.remove(&copy).map_err(|e| cannot("remove", &copy, &e))?;
        if !is_part {
            return Ok(Recovered::Sound(report));
        }
        RealDisk.rename(input, &name).map_err(|e| cannot("rename", input, &e))?;
        return Ok(Recovered::Anew { file: name, aside: None, report });
    }
    let aside = free_name(&with_ending(&name, ".damaged"))?;
    if is_part {
        // At every moment one of the two has a name that readers look for.
        RealDisk.rename(&copy, &name).map_err(|e| cannot("rename", &copy, &e))?;
        RealDisk.rename(input, &aside).map_err(|e| cannot("rename", input, &e))?;
    } else {
        let linked = std::fs::hard_link(input, &aside).is_ok();
        if !linked {
            RealDisk.rename(input, &aside).map_err(|e| cannot("rename", input, &e))?;
        }
        std::fs::rename(&copy, &name).map_err(|e| cannot("rename", &copy, &e))?;
        RealDisk
            .sync_folder(folder_of(&name))
            .map_err(|e| cannot("sync the folder of", &name, &e))?;
    }
    Ok(Recovered::Anew { file: name, aside: Some(aside), report })
}

/// The sentence for a file into which nothing had been written.
pub fn nothing_in(file: &Path, aside: Option<&Path>) -> String {
    let name = file.display();
    match aside {
        Some(aside) => format!(
            "{name} was left before anything was recorded into it; it is now {}",
            aside.display()
        ),
        None => format!("{name} was left empty, and was removed"),
    }
}

fn set_nothing_aside(part: &Path, name: &Path) -> Result<Recovered, SegmentError> {
    if is_empty(part) {
        RealDisk.remove(part).map_err(|e| cannot("remove", part, &e))?;
        return Ok(Recovered::Nothing { aside: None });
    }
    let aside = free_name(&with_ending(name, ".damaged"))?;
    RealDisk.rename(part, &aside).map_err(|e| cannot("rename", part, &e))?;
    Ok(Recovered::Nothing { aside: Some(aside) })
}

/// The recorder, or a recovery, was cut off between giving a file its name and taking the other.
fn finish_renaming(part: &Path, name: &Path) -> Result<Recovered, SegmentError> {
    let report = Report::default();
    let file = name.to_owned();
    if crate::recording::disk::is_same(part, name) || is_empty(part) {
        RealDisk.remove(part).map_err(|e| cannot("remove", part, &e))?;
        return Ok(Recovered::Anew { file, aside: None, report });
    }
    let aside = free_name(&with_ending(name, ".damaged"))?;
    RealDisk.rename(part, &aside).map_err(|e| cannot("rename", part, &e))?;
    Ok(Recovered::Anew { file, aside: Some(aside), report })
}

/// True if a reader finds its way by the end of the file: a kill may have come while that was written.
fn has_end(path: &Path) -> Result<bool, SegmentError> {
    Segment::of_summary(path).map(|end| end.is_some()).map_err(|e| SegmentError(e.to_string()))
}

/// True for a file without a byte. Where a power cut has left both names of a file on vfat, which has no
/// links, the check of the disk takes what it holds from one of them.
fn is_empty(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|about| about.is_file() && about.len() == 0)
}

/// The `.part` files in a folder that nobody writes any more, by name.
pub fn leftovers(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        let name = entry.file_name();
        let is_part = name.to_str().is_some_and(|name| name.ends_with(".mcap.part"));
        if is_part && entry.file_type()?.is_file() && lock(&path).is_ok() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Locks a file, unless somebody is writing it. The lock ends with the returned file.
pub fn lock(path: &Path) -> Result<File, SegmentError> {
    let file = File::open(path).map_err(|e| cannot("read", path, &e))?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let by = holder(path).map_or(String::new(), |pid| format!(" by process {pid}"));
            Err(SegmentError(format!("{} is being written{by}; stop that first", path.display())))
        }
        // Where a file system has no locks, nobody can be asked.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
    }
}

/// The name a file has when it is finished.
pub fn final_name(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|ending| ending == "part") {
        return path.with_extension("");
    }
    path.to_owned()
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// `path`, or with a number behind it, so that nothing is overwritten.
fn free_name(path: &Path) -> Result<PathBuf, SegmentError> {
    let numbered = (2..1000).map(|number| with_ending(path, &format!(".{number}")));
    let mut names = std::iter::once(path.to_owned()).chain(numbered);
    names.find(|name| name.symlink_metadata().is_err()).ok_or_else(|| {
        SegmentError(format!("there are a thousand files {}.*; remove some", path.display()))
    })
}

fn cannot(what: &str, path: &Path, error: &io::Error) -> SegmentError {
    SegmentError(format!("cannot {what} {}: {error}", path.display()))
}
