//! Where results go: a file or folder that has its name only once it is complete, or stdout.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::foreign;

/// An output cannot be made or finished. The text is the whole sentence.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct OutputError(pub String);

/// `NAME.part`.
pub fn part_of(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".part");
    name.into()
}

/// An error of the system with the file it is about in its text; its kind stays.
pub fn about(path: &Path, error: &io::Error) -> io::Error {
    let next = match error.kind() {
        io::ErrorKind::StorageFull => "; make room or choose another disk",
        _ => "",
    };
    io::Error::new(error.kind(), format!("cannot write {}: {error}{next}", path.display()))
}

/// A file being written, or stdout. Removed when dropped before [`Output::finish`].
#[derive(Debug)]
pub struct Output {
    /// The file, and the name it gets in the end.
    file: Option<(File, PathBuf)>,
    finished: bool,
}

impl Output {
    /// Creates `path`.part; `-` is stdout. An existing `path` is replaced in the end if `force`.
    pub fn create(path: &Path, force: bool) -> Result<Self, OutputError> {
        if path.as_os_str() == "-" {
            return Ok(Self { file: None, finished: false });
        }
        refuse_existing(path, force)?;
        let part = part_of(path);
        // Read access too, since some formats look back at their own beginning.
        let mut options = File::options();
        options.read(true).write(true).create_new(!force).create(force).truncate(force);
        let file = options.open(&part).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => OutputError(format!(
                "{} exists: another export is running, or was killed; remove it or use --force",
                part.display()
            )),
            _ => failed("create", &part, &error),
        })?;
        Ok(Self { file: Some((file, path.to_owned())), finished: false })
    }

    /// Makes the file durable and gives it its name.
    pub fn finish(mut self) -> Result<(), OutputError> {
        self.finished = true;
        let Some((file, path)) = &self.file else { return Ok(()) };
        let part = part_of(path);
        file.sync_all().and_then(|()| fs::rename(&part, path)).map_err(|error| {
            fs::remove_file(&part).ok();
            OutputError(about(path, &error).to_string())
        })?;
        sync_above(path)
    }

    fn with<T>(&mut self, act: impl FnOnce(&mut File) -> io::Result<T>) -> io::Result<T> {
        let not_stdout = || io::Error::new(io::ErrorKind::Unsupported, "stdout cannot be rewound");
        let (file, path) = self.file.as_mut().ok_or_else(not_stdout)?;
        act(file).map_err(|error| about(path, &error))
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let (Some((_, path)), false) = (&self.file, self.finished) {
            fs::remove_file(part_of(path)).ok();
        }
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.file {
            Some(_) => self.with(|file| file.write(bytes)),
            None => io::stdout().write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.file {
            Some(_) => self.with(Write::flush),
            None => io::stdout().flush(),
        }
    }
}

impl Read for Output {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.with(|file| file.read(bytes))
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.with(|file| file.seek(to))
    }
}

/// A folder being filled, as `NAME.part`. Removed when dropped before [`OutputFolder::finish`].
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    part: PathBuf,
    force: bool,
    finished: bool,
}

impl OutputFolder {
    /// Creates `path`.part. An existing `path` is replaced in the end if `force`, and if it holds
    /// nothing but files that an export made.
    pub fn create(path: &Path, force: bool) -> Result<Self, OutputError> {
        let empty = fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
        if !empty {
            refuse_existing(path, force)?;
            foreign::refuse(path)?;
        }
        let part = part_of(path);
        if force && part.is_dir() {
            foreign::refuse(&part)?;
            fs::remove_dir_all(&part).map_err(|e| failed("remove", &part, &e))?;
        }
        fs::create_dir(&part).map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => OutputError(format!(
                "{} exists: another export is running, or was killed; remove it or use --force",
                part.display()
            )),
            _ => failed("create", &part, &error),
        })?;
        Ok(Self { path: path.to_owned(), part, force, finished: false })
    }

    /// Where the files go for now.
    pub fn part(&self) -> &Path {
        &self.part
    }

    /// Gives the folder its name, after each `NAME.part` in it has become `NAME`. All of it is on the
    /// disk before the folder that it replaces is removed.
    pub fn finish(mut self) -> Result<(), OutputError> {
        name_parts(&self.part)?;
        if self.force && self.path.is_dir() {
            foreign::refuse(&self.path)?;
            fs::remove_dir_all(&self.path).map_err(|e| failed("replace", &self.path, &e))?;
        }
        fs::rename(&self.part, &self.path).map_err(|e| failed("create", &self.path, &e))?;
        self.finished = true;
        sync_above(&self.path)
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        if !self.finished {
            fs::remove_dir_all(&self.part).ok();
        }
    }
}

/// Makes each file durable before it gets its name, and each folder after that.
fn name_parts(folder: &Path) -> Result<(), OutputError> {
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).map_err(|e| failed("read", &inside, &e))? {
            let path = entry.map_err(|e| failed("read", &inside, &e))?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "part") {
                sync(&path)?;
                fs::rename(&path, path.with_extension(""))
                    .map_err(|e| failed("name", &path, &e))?;
            }
        }
        sync(&inside)?;
    }
    Ok(())
}

/// Makes a file durable, or the names in a folder.
fn sync(path: &Path) -> Result<(), OutputError> {
    let synced = File::open(path).and_then(|file| file.sync_all());
    synced.map_err(|e| failed("write to the disk", path, &e))
}

/// Makes a new name durable.
fn sync_above(path: &Path) -> Result<(), OutputError> {
    let above = path.parent().filter(|above| !above.as_os_str().is_empty());
    let above = above.unwrap_or(Path::new("."));
    // A folder that may be written but not read cannot be opened for this; the file is there.
    let unreadable = |e: io::Error| e.kind() == io::ErrorKind::PermissionDenied;
    if File::open(above).is_err_and(unreadable) { Ok(()) } else { sync(above) }
}

pub(super) fn failed(what: &str, path: &Path, error: &io::Error) -> OutputError {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let next = match folder {
        Some(folder) if error.kind() == io::ErrorKind::NotFound && !folder.exists() => {
            format!("; create the folder {} first", folder.display())
        }
        _ => String::new(),
    };
    OutputError(format!("cannot {what} {}: {error}{next}", path.display()))
}

fn refuse_existing(path: &Path, force: bool) -> Result<(), OutputError> {
    if !force && path.symlink_metadata().is_ok() {
        return Err(OutputError(format!(
            "{} exists and is not overwritten; choose another name or use --force",
            path.display()
        )));
    }
    Ok(())
}
