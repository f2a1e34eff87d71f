//! BLF, the binary log of Vector's tools and of many loggers.
//!
//! Vector publishes no specification of the file; the facts are those of its header
//! `binlog_objects.h` (kinds of objects and their fields) and of the public readers python-can
//! (`can/io/blf.py`) and Wireshark (`wiretap/blf.c`). All numbers have their lowest byte first.
//!
//! A file is a head with statistics (144 bytes from `LOGG` on) and objects (from `LOBJ` on). Objects
//! of kind 10 are containers; their contents, mostly compressed by zlib, are put together to one
//! stream of further objects, which may begin in one container and end in the next.

mod containers;
mod error_code;
mod head;
mod message;
mod object;

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};

use self::containers::{Containers, Found};
use self::head::Head;
use self::message::Told;
use self::object::{BASE, Base, Object, PADDING};
use super::names::Names;
use super::{ImportError, LogFrame, LogReader, Skipped};
use crate::frame::{Frame, Gap, GapReason, Stamped, Timestamp, Unit};

/// Frames given at a time.
const BATCH: usize = 4096;

/// True if a file that begins so is a BLF log.
pub fn recognises(head: &[u8]) -> bool {
    head.starts_with(b"LOGG")
}

/// Opens a log.
///
/// # Errors
/// It cannot be read, or is no BLF log.
pub fn open<R: Read + Seek>(mut input: R) -> Result<impl LogReader + use<R>, ImportError> {
    let mut bytes = Vec::with_capacity(head::LEAST);
    input.seek(SeekFrom::Start(0))?;
    input.by_ref().take(head::LEAST as u64).read_to_end(&mut bytes)?;
    let head = head::parse(&bytes)?;
    Ok(Blf {
        file: Containers::new(input, head.objects_at)?,
        head,
        stream: Vec::new(),
        at: 0,
        lost_place: false,
        after: After::More,
        ended: false,
        objects: 0,
        buses: Names::default(),
        others: BTreeMap::new(),
        odd_dlcs: 0,
        skipped: Skipped::default(),
        notes: Vec::new(),
    })
}

/// What comes behind the stream so far.
#[derive(Clone, Copy, PartialEq, Eq)]
enum After {
    More,
    Hole,
    End,
}

struct Blf<R> {
    file: Containers<R>,
    head: Head,
    /// Contents of containers that are not yet taken: from `at` on.
    stream: Vec<u8>,
    at: usize,
    /// The stream goes on somewhere inside an object, and that has been counted.
    lost_place: bool,
    after: After,
    ended: bool,
    /// Objects seen, numbered from 1.
    objects: u64,
    buses: Names,
    /// Objects that carry no frame, by kind.
    others: BTreeMap<u32, u64>,
    /// Frames whose DLC was above 15.
    odd_dlcs: u64,
    skipped: Skipped,
    notes: Vec<String>,
}

impl<R: Read + Seek> LogReader for Blf<R> {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let full = into.len() + BATCH;
        loop {
            while self.take_object(into) {
                if into.len() >= full {
                    return Ok(true);
                }
            }
            match self.after {
                After::More => self.more(into)?,
                After::Hole => {
                    self.stream.clear();
                    (self.at, self.lost_place, self.after) = (0, true, After::More);
                }
                After::End if Base::parse(&self.stream[self.at..]).is_some() => self.cut_object(),
                After::End => {
                    self.end();
                    return Ok(false);
                }
            }
        }
    }

    fn buses(&self) -> &[String] {
        self.buses.list()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn times_are_relative(&self) -> bool {
        self.head.start.is_none()
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}

impl<R: Read + Seek> Blf<R> {
    /// Gets more of the stream.
    fn more(&mut self, into: &mut Vec<LogFrame>) -> Result<(), ImportError> {
        self.stream.drain(..self.at);
        self.at = 0;
        self.after = match self.file.next(&mut self.stream, &mut self.skipped)? {
            Found::Contents => After::More,
            Found::Hole => After::Hole,
            Found::Object(bytes) => {
                if let Some(base) = Base::parse(&bytes) {
                    self.take(base, &bytes, into);
                }
                After::More
            }
            Found::End => After::End,
        };
        Ok(())
    }
}

impl<R> Blf<R> {
    /// Takes one object from the stream; `false` when it has no whole one.
    fn take_object(&mut self, into: &mut Vec<LogFrame>) -> bool {
        let Some(base) = self.find() else { return false };
        let rest = &self.stream[self.at..];
        let size = base.size as usize;
        let enough = size + if base.is_traffic() { 0 } else { PADDING + BASE };
        let believed = size <= base.longest() && (base.is_traffic() || followed(rest, size));
        if believed && rest.len() < enough && (self.after == After::More || rest.len() < size) {
            return false;
        }
        if !believed {
            self.odd(|| format!("no object follows where this one of {size} bytes should end"));
            self.at += object::SIGNATURE.len();
            self.lost_place = true;
            return true;
        }
        let inside = if base.is_traffic() { object::begins_inside(&rest[..size]) } else { None };
        if inside.is_some() {
            self.odd(|| format!("its {size} bytes reach over the beginning of the next object"));
        }
        let end = self.at + inside.unwrap_or(size);
        // Out of its place for as long as the object is looked at.
        let stream = std::mem::take(&mut self.stream);
        self.take(base, &stream[self.at..end], into);
        self.stream = stream;
        self.at = end;
        true
    }

    /// Goes to the next beginning of an object in the stream.
    fn find(&mut self) -> Option<Base> {
        let rest = &self.stream[self.at..];
        let found = rest
            .windows(BASE)
            .enumerate()
            .find_map(|(index, bytes)| Some((index, Base::parse(bytes)?)));
        if let Some((index, base)) = found {
            self.pass(index);
            self.at += index;
            self.lost_place = false;
            return Some(base);
        }
        // What cannot be a beginning is passed over, so that it is not searched again.
        let passed = rest.len().saturating_sub(BASE + PADDING);
        if passed > 0 {
            self.pass(passed + PADDING);
            self.at += passed;
            self.lost_place = true;
        }
        None
    }

    /// Counts `bytes` that are no object, unless they only round one up.
    fn pass(&mut self, bytes: usize) {
        if bytes > PADDING && !self.lost_place {
            let object = self.objects;
            self.skipped.add(
                || format!("behind object {object}"),
                || format!("{bytes} bytes or more are no object"),
            );
        }
    }

    fn odd(&mut self, reason: impl FnOnce() -> String) {
        let object = self.objects + 1;
        self.skipped.add(|| format!("object {object}"), reason);
    }

    fn take(&mut self, base: Base, bytes: &[u8], into: &mut Vec<LogFrame>) {
        let taken = if base.is_traffic() {
            Object::parse(base, bytes).and_then(|object| self.told(object))
        } else {
            Ok(None)
        };
        match taken {
            Ok(Some(frame)) => into.push(frame),
            Ok(None) => *self.others.entry(base.kind).or_default() += 1,
            Err(reason) => {
                let kind = object::name(base.kind).unwrap_or("object");
                self.odd(|| format!("this {kind} cannot be taken: {reason}"));
            }
        }
        self.objects += 1;
    }

    /// The frame or gap that an object tells of.
    fn told(&mut self, object: Object) -> Result<Option<LogFrame>, String> {
        let time = Timestamp(self.head.start.unwrap_or(0)).plus(object.time);
        let (channel, value) = match message::read(object)? {
            Told::Frame(channel, frame, dlc) => {
                self.odd_dlcs += u64::from(dlc > 15);
                (channel, Frame::Can(frame))
            }
            Told::Overrun(channel) => {
                let (unit, reason) = (Unit::Frames, GapReason::Adapter);
                (channel, Frame::Gap(Gap { count: 0, unit, reason, from: time, to: time }))
            }
            Told::Nothing => return Ok(None),
        };
        let bus = self.buses.numbered(channel.into())?;
        Ok(Some(LogFrame { bus, frame: Stamped { time, value } }))
    }

    /// The file ends before the object does; others may stand in what seems to be its inside.
    fn cut_object(&mut self) {
        let left = self.stream.len() - self.at;
        self.odd(|| format!("only its first {left} bytes are in the file"));
        self.at += object::SIGNATURE.len();
        self.lost_place = true;
    }

    fn end(&mut self) {
        if std::mem::replace(&mut self.ended, true) {
            return;
        }
        let left = self.stream.len() - self.at;
        if self.stream[self.at..].iter().any(|byte| *byte != 0) && !self.lost_place {
            self.odd(|| format!("only its first {left} bytes are in the file"));
        }
        // The head is written last: a recorder that was cut off has not said how long the file is.
        let Head { file_size, objects, .. } = self.head;
        let size = self.file.size;
        if file_size > size && u64::from(objects) > self.objects && self.skipped.count == 0 {
            let missing = u64::from(objects) - self.objects;
            self.skipped.add(
                || format!("byte {size}"),
                || {
                    format!(
                        "the file ends here; its head promises {file_size} bytes and {missing} \
                         objects more"
                    )
                },
            );
        }
        if self.odd_dlcs > 0 {
            let count = self.odd_dlcs;
            self.notes.push(format!(
                "{count} frame(s) have a DLC above 15, which no frame can have: their bytes are \
                 taken as they are"
            ));
        }
        if !self.others.is_empty() {
            let kinds: Vec<String> = self.others.iter().map(|(k, n)| told_of(*k, *n)).collect();
            self.notes.push(format!("objects without a CAN frame: {}", kinds.join(", ")));
        }
    }
}

/// False if it is known that no object follows the first `size` bytes.
fn followed(rest: &[u8], size: usize) -> bool {
    let next = rest.get(size..size + PADDING + BASE);
    next.is_none_or(|next| next.windows(BASE).any(|bytes| Base::parse(bytes).is_some()))
}

fn told_of(kind: u32, count: u64) -> String {
    object::name(kind)
        .map_or_else(|| format!("{count} of kind {kind}"), |name| format!("{count} {name}"))
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
