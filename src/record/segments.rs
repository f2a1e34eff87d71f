//! Segment files: their names, `.part` while open, the next one when one is full.

use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::disk_thread::{DiskThread, Done, Job};
use crate::frame::Timestamp;
use crate::recording::definition::Facts;
use crate::recording::disk::{Created, Disk, Durable, folder_of};
use crate::recording::writer::{Head, SegmentWriter, WriterOptions};
use crate::text::compact_utc;

/// After this time a window that has not ended goes on in another file.
const LONGEST_WINDOW: Duration = Duration::from_secs(24 * 3600);

/// Least free space to start with: anything less is full within minutes.
pub const LEAST_FREE: u64 = 8 << 20;

/// A file that is finished and the next one's head are two; so many may wait for the disk.
const MOST_JOBS: usize = 8;

/// Folder for windows around triggers, in that of the recording.
pub const WINDOWS: &str = "windows";

/// Where a recording goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// One file; with splitting, `_0001` and so on go before its ending.
    File(PathBuf),
    /// A folder, and what the names in it begin with.
    Folder(PathBuf, String),
}

/// When a segment is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Split {
    /// Bytes in the file.
    pub size: Option<u64>,
    /// Age of the segment.
    pub time: Option<Duration>,
    /// At full hours or days.
    pub at: Option<Align>,
}

/// Where segments meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Align {
    /// At each full hour of UTC
    Hour,
    /// At midnight UTC
    Day,
}

impl Align {
    /// Number of the hour or day since 1970 that `time` is in. UTC without leap seconds, as all
    /// times here.
    fn number(self, time: Timestamp) -> u64 {
        let hours = time.nanos() / 3_600_000_000_000;
        match self {
            Self::Hour => hours,
            Self::Day => hours / 24,
        }
    }
}

impl Split {
    fn is_set(self) -> bool {
        self.size.is_some() || self.time.is_some() || self.at.is_some()
    }
}

/// A file of a recording could not be made or finished. The text is the whole sentence.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SegmentError(pub String);

/// The row of segment files of one recording.
pub struct Segments {
    disk: Arc<dyn Disk>,
    thread: DiskThread,
    target: Target,
    split: Split,
    options: WriterOptions,
    session: u32,
    number: u32,
    finished: Vec<PathBuf>,
    /// The segment of which a sync is under way.
    syncing: Option<PathBuf>,
    /// What was done while it had to be waited for.
    done: Vec<Done>,
}

/// The segment that is open.
pub struct Segment {
    /// Its content.
    pub writer: SegmentWriter,
    /// The name it will have.
    pub path: PathBuf,
    /// When it was opened.
    pub started: Timestamp,
    durable: Arc<dyn Durable>,
}

impl Segment {
    /// The name it has while it is open.
    pub fn part(&self) -> PathBuf {
        part_of(&self.path)
    }
}

impl Segments {
    /// Looks at the target without changing anything.
    pub fn new(
        disk: Arc<dyn Disk>,
        target: Target,
        split: Split,
        options: WriterOptions,
    ) -> Result<Self, SegmentError> {
        let folder = match &target {
            Target::File(path) => folder_of(path),
            Target::Folder(folder, _) => folder,
        };
        let free = disk.free(folder).map_err(|e| folder_error(folder, &e))?;
        if free < LEAST_FREE {
            return Err(SegmentError(format!(
                "cannot record into {}: only {} KiB are free there, at least {} are needed; \
                 make room or choose another folder",
                folder.display(),
                free >> 10,
                LEAST_FREE >> 10,
            )));
        }
        let session = match &target {
            Target::File(_) => 1,
            Target::Folder(folder, prefix) => {
                let last = last_session(folder, prefix).map_err(|e| folder_error(folder, &e))?;
                // Windows are kept for longer than segments.
                let of_windows = last_session(&folder.join(WINDOWS), prefix).unwrap_or(0);
                last.max(of_windows).saturating_add(1)
            }
        };
        Ok(Self::row(disk, target, split, options, session))
    }

    fn row(
        disk: Arc<dyn Disk>,
        target: Target,
        split: Split,
        options: WriterOptions,
        session: u32,
    ) -> Self {
        let thread = DiskThread::new(disk.clone());
        let finished = Vec::new();
        Self {
            disk,
            thread,
            target,
            split,
            options,
            session,
            number: 0,
            finished,
            syncing: None,
            done: Vec::new(),
        }
    }

    /// The row of windows of the same recording. Makes their folder.
    pub fn windows(&self) -> Result<Self, SegmentError> {
        let Target::Folder(folder, prefix) = &self.target else {
            let text = "windows around triggers need a folder: record with --dir";
            return Err(SegmentError(text.to_owned()));
        };
        let folder = folder.join(WINDOWS);
        let made = std::fs::DirBuilder::new().recursive(true).mode(0o750).create(&folder);
        made.map_err(|e| folder_error(&folder, &e))?;
        self.sync_above(&folder);
        let target = Target::Folder(folder, prefix.clone());
        // A window is one file, unless its trigger does not come to rest.
        let split = Split { size: self.split.size, time: Some(LONGEST_WINDOW), at: None };
        Ok(Self::row(self.disk.clone(), target, split, self.options, self.session))
    }

    /// A folder that is new is in the one above it. On vfat that one is asked to write the first
    /// entries of the new folder, too, and only once it has been is the new one asked itself
    /// (`fat_alloc_new_dir` in fs/fat/dir.c). Where we may not look into it, nothing can be done.
    fn sync_above(&self, folder: &Path) {
        self.disk.sync_folder(&folder.join("..")).ok();
    }

    /// Number of the recording in its folder, from 1; tells recordings apart when the machine has
    /// no clock.
    pub fn session(&self) -> u32 {
        self.session
    }

    /// Number of the segment opened last, from 1.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// The files that were finished.
    pub fn finished(&self) -> &[PathBuf] {
        &self.finished
    }

    /// Creates the next segment with its head, and makes it durable. `label` is what its name ends
    /// with; it may be empty.
    pub fn open(
        &mut self,
        time: Timestamp,
        head: &Head,
        label: &str,
    ) -> Result<Segment, SegmentError> {
        let mut segment = self.create(time, head, label)?;
        let part = segment.part();
        let synced = segment.writer.sync().and_then(|()| self.disk.sync_folder(folder_of(&part)));
        if let Err(error) = synced {
            self.discard(segment);
            return Err(create_error(&part, &error));
        }
        Ok(segment)
    }

    /// The same without waiting for the disk, which is told by [`Segments::take_done`]. Where files
    /// have no second name, the file before is waited for: two changes of a folder at once may reach the disk
    /// in any order, and a power cut between them can take a file both its names.
    pub fn open_ahead(
        &mut self,
        time: Timestamp,
        head: &Head,
        label: &str,
    ) -> Result<Segment, SegmentError> {
        if self.is_waiting() && !self.disk.has_links(self.folder()) {
            let done = self.wait();
            self.done.extend(done);
        }
        let segment = self.create(time, head, label)?;
        self.give_sync(&segment, true, time);
        Ok(segment)
    }

    fn create(
        &mut self,
        time: Timestamp,
        head: &Head,
        label: &str,
    ) -> Result<Segment, SegmentError> {
        self.number += 1;
        let path = self.path(time, label);
        let part = part_of(&path);
        for existing in [&path, &part] {
            if existing.symlink_metadata().is_ok() {
                return Err(SegmentError(format!(
                    "cannot create {}: {} exists and is not overwritten; choose another name{}",
                    path.display(),
                    existing.display(),
                    if *existing == part {
                        ", or first finish it with \"bustape recover --in-place\""
                    } else {
                        ""
                    },
                )));
            }
        }
        if self.number == 1 {
            self.sync_above(folder_of(&part));
        }
        let created = self.disk.create(&part).map_err(|e| create_error(&part, &e))?;
        let Created { file, durable } = created;
        match SegmentWriter::create(file, self.options, head) {
            Ok(writer) => Ok(Segment { writer, path, started: time, durable }),
            Err(error) => {
                // Nothing is in it yet, so nothing is lost with it.
                self.disk.remove(&part).ok();
                Err(create_error(&part, &error))
            }
        }
    }

    /// True when `segment` should be followed by the next one.
    pub fn is_full(&self, segment: &Segment, now: Timestamp) -> bool {
        let too_long = self
            .split
            .time
            .is_some_and(|limit| u128::from(now.since(segment.started)) >= limit.as_nanos());
        let too_big = self.split.size.is_some_and(|limit| segment.writer.expected_size() >= limit);
        let next = |align: Align| align.number(now) > align.number(segment.started);
        too_long || too_big || self.split.at.is_some_and(next)
    }

    /// Makes safe what is in the open segment up to `time`, unless that is under way.
    pub fn sync(&mut self, segment: &Segment, time: Timestamp) {
        if self.syncing.as_ref() != Some(&segment.path) {
            self.give_sync(segment, false, time);
        }
    }

    fn give_sync(&mut self, segment: &Segment, new: bool, time: Timestamp) {
        self.syncing = Some(segment.path.clone());
        let (part, file) = (segment.part(), segment.durable.clone());
        self.thread.give(Job::Sync { part, file, new, time });
    }

    /// Writes the end of a segment. It gets its name when it is safe, which is told by
    /// [`Segments::take_done`].
    pub fn finish(&mut self, mut segment: Segment, summary: Facts) -> Result<(), SegmentError> {
        let part = segment.part();
        segment.writer.finish(summary).map_err(|e| write_error(&part, &e))?;
        self.thread.give(Job::Finish { part, path: segment.path, file: segment.durable });
        Ok(())
    }

    /// True while the disk is waited for.
    pub fn is_waiting(&self) -> bool {
        self.thread.jobs() > 0
    }

    /// True when the disk does not come after with finishing files: each that waits is held open, so
    /// the open one goes on instead.
    pub fn is_behind(&self) -> bool {
        self.thread.jobs() > MOST_JOBS
    }

    /// What the disk has done since this was last asked.
    pub fn take_done(&mut self) -> Vec<Done> {
        let done = self.thread.take_done();
        let mut all = std::mem::take(&mut self.done);
        all.extend(self.enter(done));
        all
    }

    /// Waits until the disk has done everything.
    pub fn wait(&mut self) -> Vec<Done> {
        let done = self.thread.wait();
        let mut all = std::mem::take(&mut self.done);
        all.extend(self.enter(done));
        all
    }

    fn folder(&self) -> &Path {
        match &self.target {
            Target::File(path) => folder_of(path),
            Target::Folder(folder, _) => folder,
        }
    }

    fn enter(&mut self, done: Vec<Done>) -> Vec<Done> {
        for done in &done {
            match done {
                Done::Synced { part, .. } | Done::Unsafe { part, .. } => {
                    self.syncing.take_if(|path| part_of(path) == *part);
                }
                Done::Finished(path) => self.finished.push(path.clone()),
                Done::Unfinished(_) => {}
            }
        }
        done
    }

    /// Gives a segment whose end is written its name.
    pub fn name(&mut self, segment: Segment) -> Result<(), SegmentError> {
        let part = segment.part();
        let named = self.disk.rename(&part, &segment.path);
        named.map_err(|error| rename_error(&part, &segment.path, &error))?;
        self.finished.push(segment.path);
        Ok(())
    }

    /// Removes a segment into which nothing was recorded.
    pub fn discard(&mut self, segment: Segment) {
        self.disk.remove(&segment.part()).ok();
    }

    fn path(&self, time: Timestamp, label: &str) -> PathBuf {
        let number = self.number;
        match &self.target {
            Target::File(path) if !self.split.is_set() && number == 1 => path.clone(),
            Target::File(path) => {
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                path.with_file_name(format!("{stem}_{number:04}.mcap"))
            }
            Target::Folder(folder, prefix) => {
                let (session, time) = (self.session, compact_utc(time));
                let label = if label.is_empty() { String::new() } else { format!("_{label}") };
                folder.join(format!("{prefix}_s{session:04}_{number:04}_{time}{label}.mcap"))
            }
        }
    }
}

/// The highest session number in a folder, 0 if there is none.
fn last_session(folder: &Path, prefix: &str) -> io::Result<u32> {
    let mut last = 0;
    for entry in std::fs::read_dir(folder)? {
        let name = entry?.file_name();
        let number = name
            .to_str()
            .and_then(|name| name.strip_prefix(prefix)?.strip_prefix("_s")?.split('_').next())
            .and_then(|digits| digits.parse::<u32>().ok());
        last = last.max(number.unwrap_or(0));
    }
    Ok(last)
}

/// The name a file has while it is written.
pub(super) fn part_of(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    name.into()
}

fn folder_error(folder: &Path, error: &io::Error) -> SegmentError {
    let next = match error.kind() {
        io::ErrorKind::NotFound => format!("create it with \"mkdir -p {}\"", folder.display()),
        io::ErrorKind::PermissionDenied => "give this user the right to read it".to_owned(),
        _ => "choose another folder".to_owned(),
    };
    SegmentError(format!("cannot record into {}: {error}; {next}", folder.display()))
}

fn create_error(path: &Path, error: &io::Error) -> SegmentError {
    let next = match error.kind() {
        io::ErrorKind::PermissionDenied => "give this user the right to write in its folder",
        io::ErrorKind::StorageFull => "make room or choose another disk",
        io::ErrorKind::ReadOnlyFilesystem => "choose a folder on a writable file system",
        _ => "choose another place with -o or -d",
    };
    SegmentError(format!("cannot create {}: {error}; {next}", path.display()))
}

/// The sentence for a file that cannot get its name.
pub fn rename_error(part: &Path, path: &Path, error: &io::Error) -> SegmentError {
    SegmentError(format!(
        "cannot rename {} to {}: {error}; the recording is complete under the first name",
        part.display(),
        path.display(),
    ))
}

/// The sentence for a failed write or sync.
pub fn write_error(path: &Path, error: &io::Error) -> SegmentError {
    SegmentError(format!(
        "cannot write {}: {error}; what it holds up to here can be read, and made into a finished \
         file with \"bustape convert\"",
        path.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_meet_at_full_hours_and_days_of_utc() {
        let time = |text: &str| crate::text::parse_moment(text, Timestamp(0)).unwrap();
        let noon = time("2026-11-22T12:59:59.999999999Z");
        let one = time("2026-11-22T13:00:00Z");
        let midnight = time("2026-11-23T00:00:00Z");
        assert!(Align::Hour.number(one) > Align::Hour.number(noon));
        assert_eq!(Align::Day.number(one), Align::Day.number(noon));
        assert!(Align::Day.number(midnight) > Align::Day.number(one));
        assert_eq!(Align::Hour.number(one.plus(3_599_999_999_999)), Align::Hour.number(one));
    }
}
