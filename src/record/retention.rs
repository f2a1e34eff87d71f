//! Room on the disk: which finished segments go when there is not enough, and when to stop.
//!
//! Decided before anything is written. The oldest goes first, by session and segment number, so that
//! a machine without a clock does not delete the newest. Never deleted are: the open segment, files
//! that somebody is writing, segments marked with `bustape keep` or holding an event, and the one
//! before such a one. Only files named as this recorder names them are looked at.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::leftovers::final_name;
use crate::frame::Timestamp;
use crate::recording::disk::{Disk, is_locked};
use crate::recording::segment::Segment;
use crate::recording::writer::EVENT_TOPIC;
use crate::text::{self, parse_compact_utc};

/// Names before this moment (2020-01-01) come from a machine that had no clock: their age is unknown.
const CLOCK_WORKED: u64 = 1_577_836_800_000_000_000;
/// Time between looks at the age of files.
const LOOK: u64 = 60_000_000_000;

/// What to do when the disk is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum WhenFull {
    /// Finish the file and end the recording
    #[default]
    Stop,
    /// Delete the oldest segment and go on
    Ring,
}

/// How much may be there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of all segments together.
    pub keep_size: Option<u64>,
    /// How long a segment is kept.
    pub keep_time: Option<Duration>,
    /// Bytes that stay free on the disk.
    pub min_free: u64,
    /// What to do when there are not as many.
    pub when_full: WhenFull,
}

/// The segments in a folder, and how many may be there.
pub struct Retention {
    disk: Box<dyn Disk>,
    folder: PathBuf,
    prefix: String,
    limits: Limits,
    /// Oldest first.
    stock: Vec<Stocked>,
    /// Which finished files hold an event.
    events: BTreeMap<PathBuf, bool>,
    last_look: Timestamp,
    /// It was said that the budget cannot be kept, and since then nothing could be deleted for it.
    said: bool,
    /// So it was when the folder was looked at last: until it changes nothing is to be gained.
    gave_way: bool,
}

/// A segment in the folder.
struct Stocked {
    session: u32,
    number: u32,
    path: PathBuf,
    /// With what a recovery set aside.
    bytes: u64,
    started: Option<Timestamp>,
}

/// The open segment, as far as it matters here.
#[derive(Clone, Copy, Debug)]
pub struct Open<'a> {
    /// Its name when finished; empty if there is none yet.
    pub path: &'a Path,
    /// Bytes in it.
    pub bytes: u64,
    /// True if it holds an event.
    pub holds_event: bool,
}

/// Whether there is room, and what was done for it.
#[derive(Debug, Default)]
pub struct Room {
    /// A sentence for each file that was deleted, or could not be.
    pub said: Vec<String>,
    /// Why nothing more may be written, if so.
    pub full: Option<String>,
}

enum Reason {
    Size,
    Time,
    Free(u64),
}

impl Retention {
    /// Looks after the segments in `folder` whose names begin with `prefix`.
    pub fn new(disk: Box<dyn Disk>, folder: PathBuf, prefix: String, limits: Limits) -> Self {
        let mut retention = Self {
            disk,
            folder,
            prefix,
            limits,
            stock: Vec::new(),
            events: BTreeMap::new(),
            last_look: Timestamp(0),
            said: false,
            gave_way: false,
        };
        retention.refresh();
        retention
    }

    /// Looks at the folder again: a segment was finished.
    pub fn refresh(&mut self) {
        self.gave_way = false;
        self.read_folder();
    }

    fn read_folder(&mut self) {
        // A folder that cannot be read now has no segment to delete either.
        let Ok(entries) = std::fs::read_dir(&self.folder) else { return };
        self.stock.clear();
        let mut aside = BTreeMap::<PathBuf, u64>::new();
        for entry in entries.flatten() {
            let bytes = entry.metadata().map_or(0, |about| about.len());
            let path = entry.path();
            let name = entry.file_name();
            let Some(name) = name.to_str() else { continue };
            if let Some((original, _)) = name.split_once(".mcap.damaged") {
                let original = format!("{original}.mcap");
                *aside.entry(self.folder.join(original)).or_default() += bytes;
            } else if let Some((session, number, started)) = self.parts_of(name) {
                self.stock.push(Stocked { session, number, path, bytes, started });
            }
        }
        for stocked in &mut self.stock {
            stocked.bytes += aside.get(&final_name(&stocked.path)).unwrap_or(&0);
        }
        self.stock
            .sort_by(|a, b| (a.session, a.number, &a.path).cmp(&(b.session, b.number, &b.path)));
    }

    /// Session, number and start of a segment, from its name.
    fn parts_of(&self, name: &str) -> Option<(u32, u32, Option<Timestamp>)> {
        let name = name.strip_suffix(".part").unwrap_or(name).strip_suffix(".mcap")?;
        let rest = name.strip_prefix(&self.prefix)?.strip_prefix("_s")?;
        let mut parts = rest.split('_');
        let (session, number, stamp) = (parts.next()?, parts.next()?, parts.next()?);
        let digits = |text: &str| text.len() >= 4 && text.bytes().all(|b| b.is_ascii_digit());
        let ours = parts.next().is_none() && digits(session) && digits(number);
        let started = parse_compact_utc(stamp).filter(|_| ours)?;
        let started = Some(started).filter(|time| time.nanos() >= CLOCK_WORKED);
        Some((session.parse().ok()?, number.parse().ok()?, started))
    }

    /// Makes room for `need` more bytes, if that is allowed.
    pub fn make_room(&mut self, need: u64, open: Open<'_>, now: Timestamp) -> Room {
        let mut room = Room::default();
        if self.limits.keep_time.is_some() && now.since(self.last_look) >= LOOK {
            self.last_look = now;
            self.refresh();
            while let Some(old) = self.oldest(open, Some(now)) {
                room.said.push(self.delete(old, &Reason::Time));
            }
        }
        let mut fresh = false;
        while let Some(reason) = self.short_of(need, open) {
            if let (Reason::Free(free), WhenFull::Stop) = (&reason, self.limits.when_full) {
                room.full = Some(self.full(*free));
                return room;
            }
            if !std::mem::replace(&mut fresh, true) {
                self.read_folder();
                continue;
            }
            let Some(oldest) = self.oldest(open, None) else {
                self.nothing_to_delete(&reason, &mut room);
                return room;
            };
            room.said.push(self.delete(oldest, &reason));
        }
        room
    }

    fn nothing_to_delete(&mut self, reason: &Reason, room: &mut Room) {
        match reason {
            Reason::Free(free) => room.full = Some(self.full(*free)),
            Reason::Size => {
                self.gave_way = true;
                if !std::mem::replace(&mut self.said, true) {
                    room.said.push(format!(
                        "the segments in {} are larger than --keep-size, and all that are left are \
                         being written, kept or hold events; recording goes on",
                        self.folder.display()
                    ));
                }
            }
            Reason::Time => {}
        }
    }

    fn full(&self, free: u64) -> String {
        format!(
            "the disk of {} is full: {} are free, --min-free is {}; the recording was finished",
            self.folder.display(),
            text::size(free),
            text::size(self.limits.min_free)
        )
    }

    /// What there is too much or too little of.
    fn short_of(&self, need: u64, open: Open<'_>) -> Option<Reason> {
        if let Ok(free) = self.disk.free(&self.folder)
            && free < self.limits.min_free.saturating_add(need)
        {
            return Some(Reason::Free(free));
        }
        let others = self.stock.iter().filter(|stocked| final_name(&stocked.path) != open.path);
        let bytes = others.map(|stocked| stocked.bytes).sum::<u64>();
        if self.limits.keep_size.is_some_and(|limit| bytes + open.bytes + need > limit) {
            return Some(Reason::Size).filter(|_| !self.gave_way);
        }
        None
    }

    /// The oldest segment that may be deleted; with a time only one that is too old then.
    fn oldest(&self, open: Open<'_>, now: Option<Timestamp>) -> Option<usize> {
        let mut next_is_kept = open.holds_event;
        let mut found = None;
        for (index, stocked) in self.stock.iter().enumerate().rev() {
            let is_open = final_name(&stocked.path) == open.path;
            let kept = if is_open { open.holds_event } else { self.is_kept(&stocked.path) };
            let due = now.is_none_or(|now| self.is_old(index, now));
            if due && !is_open && !kept && !next_is_kept && is_free(&stocked.path) {
                found = Some(index);
            }
            next_is_kept = kept;
        }
        found
    }

    /// A segment ended when the one behind it began.
    fn is_old(&self, index: usize, now: Timestamp) -> bool {
        let started = |index: usize| self.stock.get(index)?.started;
        let (Some(_), Some(end)) = (started(index), started(index + 1)) else { return false };
        let limit = self.limits.keep_time.map_or(u128::MAX, |limit| limit.as_nanos());
        u128::from(now.since(end)) > limit
    }

    fn is_kept(&self, path: &Path) -> bool {
        let known = self.events.get(path).copied();
        keep_mark(path).symlink_metadata().is_ok() || known.unwrap_or_else(|| holds_event(path))
    }

    fn delete(&mut self, index: usize, reason: &Reason) -> String {
        let stocked = self.stock.remove(index);
        self.said &= !matches!(reason, Reason::Size);
        let name = final_name(&stocked.path);
        let why = match reason {
            Reason::Size => "to stay within --keep-size",
            Reason::Time => "since it is older than --keep-time",
            Reason::Free(_) => "since the disk is full",
        };
        let removed = self.disk.remove(&stocked.path);
        for number in std::iter::once(String::new()).chain((2..10).map(|n| format!(".{n}"))) {
            let mut aside = name.clone().into_os_string();
            aside.push(format!(".damaged{number}"));
            self.disk.remove(Path::new(&aside)).ok();
        }
        self.events.remove(&stocked.path);
        match removed {
            Ok(()) => {
                format!("deleted {} ({}) {why}", stocked.path.display(), text::size(stocked.bytes))
            }
            Err(error) => format!("cannot delete {} {why}: {error}", stocked.path.display()),
        }
    }

    /// Looks which segments hold events, so that it need not be done when there is no room.
    pub fn note_events(&mut self) {
        let paths: Vec<PathBuf> = self.stock.iter().map(|stocked| stocked.path.clone()).collect();
        for path in paths {
            if !self.events.contains_key(&path) && path.extension().is_some_and(|e| e == "mcap") {
                let holds = holds_event(&path);
                self.events.insert(path, holds);
            }
        }
        let stock = &self.stock;
        self.events.retain(|path, _| stock.iter().any(|stocked| stocked.path == *path));
    }
}

/// The file whose being there keeps a segment: `NAME.mcap.keep`.
pub fn keep_mark(segment: &Path) -> PathBuf {
    let mut name = final_name(segment).into_os_string();
    name.push(".keep");
    name.into()
}

/// True if a segment has a message on `/bustape/event`. One that cannot be read has none.
fn holds_event(path: &Path) -> bool {
    Segment::open(path).is_ok_and(|segment| {
        let mut channels = segment.channels.values().filter(|c| c.topic == EVENT_TOPIC);
        channels.any(|channel| segment.statistics.channels.get(&channel.id).is_some_and(|n| *n > 0))
    })
}

/// True if nobody is writing the file.
fn is_free(path: &Path) -> bool {
    !File::open(path).is_ok_and(|file| is_locked(&file))
}
