//! The file: containers, whose contents put together are one stream of objects.
//!
//! A container tells of itself twice: by its size, and by the end and the checksum of its compressed
//! data. Where they disagree, the one is believed that another object follows.

use std::io::{self, BufRead as _, BufReader, Read, Seek, SeekFrom};

use flate2::{Decompress, FlushDecompress, Status};

use super::object::{BASE, Base, LOG_CONTAINER, PADDING, SIGNATURE};
use crate::import::Skipped;
use crate::import::little_endian::{u16_at, u32_at};

/// A container is given away when its checksum fits, if its contents are not longer than this;
/// longer ones are given piece by piece.
const HELD: usize = 4 << 20;
/// No container's contents are longer.
const LONGEST: u64 = 1 << 30;
/// Bytes read or decompressed in one go.
const STEP: usize = 64 << 10;
/// What a container has behind its base header: method, reserved, length of the contents, reserved.
const CONTAINER: usize = 16;

/// What was found next.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// More of the stream of objects.
    Contents,
    /// Some of the stream is missing here.
    Hole,
    /// A whole object that is in no container.
    Object(Vec<u8>),
    /// The end of the file.
    End,
}

/// A container that is not read to its end.
struct Open {
    at: u64,
    compressed: bool,
    /// Bytes of the container that are not read yet.
    left: u64,
    /// Bytes of its contents so far.
    given: u64,
}

/// Reads containers one after the other.
pub(super) struct Containers<R> {
    input: BufReader<R>,
    at: u64,
    /// Bytes of the file.
    pub size: u64,
    open: Option<Open>,
    /// What stands before the next object belongs to damage that has been counted.
    counted: bool,
    inflate: Decompress,
    /// How many bytes may still be read twice, so that damage cannot make reading endless.
    again: u64,
}

impl<R: Read + Seek> Containers<R> {
    /// Begins at byte `at`.
    pub fn new(mut input: R, at: u64) -> io::Result<Self> {
        let size = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(at.min(size)))?;
        Ok(Self {
            input: BufReader::with_capacity(STEP, input),
            at: at.min(size),
            size,
            open: None,
            counted: false,
            inflate: Decompress::new(true),
            again: size.saturating_mul(4).saturating_add(64 << 20),
        })
    }

    /// Appends contents of the next container to `into`, or says what else is next.
    pub fn next(&mut self, into: &mut Vec<u8>, skipped: &mut Skipped) -> io::Result<Found> {
        if let Some(open) = self.open.take() {
            return self.contents(open, into, skipped);
        }
        let Some((base, start)) = self.base(skipped)? else { return Ok(Found::End) };
        let (at, left) = (start, self.size - start);
        let size = u64::from(base.size);
        if base.kind == LOG_CONTAINER && base.size as usize >= BASE + CONTAINER {
            let mut head = [0; CONTAINER];
            if left < (BASE + CONTAINER) as u64 {
                return Ok(self.cut(base, start, skipped));
            }
            self.seek(start + BASE as u64)?;
            self.input.read_exact(&mut head)?;
            self.at = start + (BASE + CONTAINER) as u64;
            let (method, length) = (u16_at(&head, 0), u32_at(&head, 8).unwrap_or(0));
            let compressed = match method {
                Some(0) => false,
                Some(2) => true,
                method => {
                    let method = method.unwrap_or(0);
                    skipped.add(
                        || format!("byte {at}"),
                        || format!("the compression {method} of this container is unknown"),
                    );
                    self.skip_to(start + size, start)?;
                    self.counted = true;
                    return Ok(Found::Hole);
                }
            };
            self.inflate.reset(true);
            // Memory is taken as contents appear, not as they are announced.
            into.reserve((length as usize).min(2 * STEP));
            let open = Open { at, compressed, left: size - (BASE + CONTAINER) as u64, given: 0 };
            return self.contents(open, into, skipped);
        }
        if size > left || base.size as usize > base.longest() {
            return Ok(self.cut(base, start, skipped));
        }
        let mut object = vec![0; base.size as usize];
        self.seek(start)?;
        self.input.read_exact(&mut object)?;
        self.at = start + size;
        Ok(Found::Object(object))
    }

    /// An object that ends behind the file, or says so: looks for another inside.
    fn cut(&mut self, base: Base, start: u64, skipped: &mut Skipped) -> Found {
        let (size, left) = (base.size, self.size - start);
        skipped.add(
            || format!("byte {start}"),
            || format!("this object should have {size} bytes, and {left} are left in the file"),
        );
        self.at = start + SIGNATURE.len() as u64;
        self.counted = true;
        Found::Hole
    }

    /// Finds the next beginning of an object.
    fn base(&mut self, skipped: &mut Skipped) -> io::Result<Option<(Base, u64)>> {
        let from = self.at;
        let found = self.find(from)?;
        let until = found.map_or(self.size, |(_, at)| at);
        // A few bytes round an object up; more were something, and so was what is not zero at the
        // end of the file.
        let padding = until - from <= PADDING as u64 && (found.is_some() || self.is_zero(from)?);
        if !padding && !self.counted {
            let bytes = until - from;
            skipped.add(|| format!("byte {from}"), || format!("{bytes} bytes are no object"));
        }
        (self.at, self.counted) = (until, false);
        Ok(found)
    }

    /// Looks for an object from byte `from` on.
    fn find(&mut self, from: u64) -> io::Result<Option<(Base, u64)>> {
        let (mut block, mut at) = (Vec::with_capacity(STEP), from);
        loop {
            self.seek(at)?;
            block.clear();
            // The first look is short: nearly always the object is here.
            let step = if at == from { 2 * BASE } else { STEP };
            self.input.by_ref().take(step as u64).read_to_end(&mut block)?;
            let found = block
                .windows(BASE)
                .enumerate()
                .find_map(|(index, bytes)| Some((Base::parse(bytes)?, at + index as u64)));
            if found.is_some() || block.len() < step {
                return Ok(found);
            }
            at += (block.len() - (BASE - 1)) as u64;
        }
    }

    /// True if all bytes from `at` to the end of the file are zero.
    fn is_zero(&mut self, at: u64) -> io::Result<bool> {
        let mut rest = Vec::new();
        self.seek(at)?;
        self.input.by_ref().take(PADDING as u64).read_to_end(&mut rest)?;
        Ok(rest.iter().all(|byte| *byte == 0))
    }

    fn seek(&mut self, to: u64) -> io::Result<()> {
        let here = self.input.stream_position()?;
        self.input.seek_relative(to as i64 - here as i64)
    }

    /// Goes to `end`, where an object should follow; if none does, looks for one from `or` on.
    fn skip_to(&mut self, end: u64, or: u64) -> io::Result<()> {
        self.at = if end <= self.size && (end == self.size || self.follows(end)?) {
            end
        } else {
            or.max(self.at).min(self.size)
        };
        Ok(())
    }

    /// True if an object begins at `at`, or only padding is left.
    fn follows(&mut self, at: u64) -> io::Result<bool> {
        if self.size.saturating_sub(at) <= PADDING as u64 {
            return Ok(true);
        }
        let mut bytes = Vec::with_capacity(BASE + PADDING);
        self.seek(at)?;
        self.input.by_ref().take((BASE + PADDING) as u64).read_to_end(&mut bytes)?;
        Ok(bytes.windows(BASE).any(|bytes| Base::parse(bytes).is_some()))
    }

    fn contents(
        &mut self,
        mut open: Open,
        into: &mut Vec<u8>,
        skipped: &mut Skipped,
    ) -> io::Result<Found> {
        let mark = into.len();
        let found = loop {
            if into.len() - mark >= HELD {
                self.open = Some(open);
                return Ok(Found::Contents);
            }
            self.seek(self.at)?;
            if open.left == 0 {
                if !open.compressed {
                    break Found::Contents;
                }
                // The size says that this is the end, the data say it is not.
                if self.follows(self.at)? {
                    let at = open.at;
                    skipped.add(
                        || format!("byte {at}"),
                        || "the data of this container stop before their end".into(),
                    );
                    return Ok(Found::Hole);
                }
                open.left = u64::MAX;
                continue;
            }
            let chunk = self.input.fill_buf()?;
            let chunk = &chunk[..chunk.len().min(usize::try_from(open.left).unwrap_or(STEP))];
            if chunk.is_empty() {
                let (at, given) = (open.at, open.given);
                skipped.add(
                    || format!("byte {at}"),
                    || {
                        format!(
                            "the file ends inside this container, {given} bytes were left of it"
                        )
                    },
                );
                break Found::Contents;
            }
            if !open.compressed {
                into.extend_from_slice(chunk);
                let read = chunk.len();
                self.input.consume(read);
                self.at += read as u64;
                open.given += read as u64;
                open.left -= read as u64;
                continue;
            }
            into.reserve(STEP);
            let (read, length) = (self.inflate.total_in(), into.len());
            let status = self.inflate.decompress_vec(chunk, into, FlushDecompress::None);
            let read = usize::try_from(self.inflate.total_in() - read).unwrap_or(0);
            self.input.consume(read);
            self.at += read as u64;
            open.left -= read as u64;
            let given = into.len() - length;
            open.given += given as u64;
            match status {
                Ok(Status::StreamEnd) => {
                    self.skip_to(self.at.saturating_add(open.left), self.at)?;
                    return Ok(Found::Contents);
                }
                Ok(_) if open.given > LONGEST => {
                    break damaged(&open, "it expands to more than 1 GiB", into, mark, skipped);
                }
                Ok(_) if read > 0 || given > 0 => {}
                Ok(_) | Err(_) => {
                    let why = "its compressed data are damaged";
                    break damaged(&open, why, into, mark, skipped);
                }
            }
        };
        if found == Found::Hole {
            self.retreat(&open);
        }
        Ok(found)
    }

    /// Goes back to where a damaged container began, to find the next one even if it began before
    /// this one should have ended.
    fn retreat(&mut self, open: &Open) {
        self.counted = true;
        let from = open.at + BASE as u64;
        let read = self.at - from;
        if read <= self.again {
            self.again -= read;
            self.at = from;
        }
    }
}

/// Takes back what a damaged container has given, as nobody knows from where on it is wrong.
fn damaged(
    open: &Open,
    why: &str,
    into: &mut Vec<u8>,
    mark: usize,
    skipped: &mut Skipped,
) -> Found {
    let (at, given) = (open.at, open.given);
    into.truncate(mark);
    skipped.add(
        || format!("byte {at}"),
        || format!("{why}: this container and its {given} bytes of objects are not taken"),
    );
    Found::Hole
}
