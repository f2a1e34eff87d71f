//! The bytes of a data group or signal: blocks DT, SD, DV and DZ, alone or in lists (HL, DL, LD).

use std::collections::HashSet;
use std::io::{Read, Seek};

use super::blocks::{Block, BlockError, BlockHead, File, HEAD};
use super::packed::{Packed, Unpacked};
use crate::import::Skipped;
use crate::import::little_endian::u32_at;

/// Bytes read at a time.
const STEP: usize = 64 << 10;

/// A stream of bytes that is kept in pieces.
pub(super) struct Data {
    /// Blocks of the list that is being read, last one first.
    blocks: Vec<u64>,
    next_list: u64,
    seen: HashSet<u64>,
    /// An uncompressed block that is being read: where it goes on, and where it ends.
    open: (u64, u64),
    bytes: Vec<u8>,
    at: usize,
    /// Place in the stream of the first byte that is not yet taken.
    pub offset: u64,
    /// Bytes that are missing in front of the next ones, as a block is damaged.
    hole: u64,
    /// The last block of a file that was not finished may not know its length.
    unfinished: bool,
}

impl Data {
    /// The stream that begins with the block at `link`; empty for 0.
    pub fn new(link: u64, unfinished: bool) -> Self {
        Self {
            blocks: vec![link],
            next_list: 0,
            seen: HashSet::new(),
            open: (0, 0),
            bytes: Vec::new(),
            at: 0,
            offset: 0,
            hole: 0,
            unfinished,
        }
    }

    /// What is there of the stream.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[self.at..]
    }

    /// Takes bytes of [`Data::bytes`] away.
    pub fn take(&mut self, bytes: usize) {
        self.at += bytes;
        self.offset += bytes as u64;
    }

    /// Makes at least `need` bytes ready. `false` at the end of the stream, or before a hole.
    pub fn want<R: Read + Seek>(
        &mut self,
        need: usize,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<bool, BlockError> {
        while self.bytes.len() - self.at < need {
            if self.hole > 0 {
                return Ok(false);
            }
            self.bytes.drain(..self.at);
            self.at = 0;
            if !self.more(file, skipped)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Goes behind a hole, if one is what comes next: how many bytes were lost.
    pub fn pass_hole(&mut self) -> u64 {
        let lost = std::mem::take(&mut self.hole);
        if lost > 0 {
            self.take(self.bytes.len() - self.at);
            self.offset += lost;
        }
        lost
    }

    /// Goes on to byte `offset` of the stream, which lies ahead. `false` if it ends before.
    pub fn go_to<R: Read + Seek>(
        &mut self,
        offset: u64,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<bool, BlockError> {
        while self.offset < offset {
            if !self.want(1, file, skipped)? && self.pass_hole() == 0 {
                return Ok(false);
            }
            let ahead = usize::try_from(offset.saturating_sub(self.offset));
            self.take(ahead.unwrap_or(usize::MAX).min(self.bytes().len()));
        }
        Ok(self.offset == offset)
    }

    fn more<R: Read + Seek>(
        &mut self,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<bool, BlockError> {
        let (at, end) = self.open;
        if at < end {
            let step = usize::try_from(end - at).unwrap_or(STEP).min(STEP);
            let read = file.read(at, step, &mut self.bytes)?;
            self.open.0 = if read == 0 { end } else { at + read as u64 };
            return Ok(read > 0 || self.another());
        }
        let Some(link) = self.blocks.pop() else {
            let list = std::mem::take(&mut self.next_list);
            if list != 0 {
                self.blocks.push(list);
            }
            return Ok(list != 0);
        };
        if link == 0 {
            return Ok(self.another());
        }
        if !self.seen.insert(link) {
            skipped.add(|| format!("byte {link}"), || "a list of data leads back to itself".into());
            return Ok(self.end());
        }
        match self.open_block(link, file) {
            Ok(()) => Ok(true),
            Err(BlockError::Odd(why)) => {
                skipped.add(|| format!("byte {link}"), || why);
                Ok(self.hole > 0 || self.end())
            }
            Err(error) => Err(error),
        }
    }

    /// Ends the stream where it is not known how many bytes are missing: what comes behind would be
    /// taken for the rest of the record before. `false`, as there is no more.
    fn end(&mut self) -> bool {
        self.blocks.clear();
        self.next_list = 0;
        false
    }

    fn another(&self) -> bool {
        !self.blocks.is_empty() || self.next_list != 0
    }

    fn open_block<R: Read + Seek>(
        &mut self,
        link: u64,
        file: &mut File<R>,
    ) -> Result<(), BlockError> {
        let head = file.head(link)?;
        match &head.id {
            b"##DT" | b"##SD" | b"##DV" | b"##RD" => {
                let open = head.data_at();
                let lengthless = self.unfinished && head.length <= HEAD && !self.another();
                let end = if lengthless { file.size } else { link.saturating_add(head.length) };
                self.open = (open, end.min(file.size).max(open));
                if end > file.size {
                    self.end();
                }
                Ok(())
            }
            b"##HL" => {
                self.blocks.push(file.block(link, head.id)?.link(0));
                Ok(())
            }
            b"##DL" => {
                let list: Block = file.block(link, head.id)?;
                self.next_list = list.link(0);
                self.blocks.extend(list.links.iter().skip(1).rev());
                Ok(())
            }
            b"##LD" => {
                // Behind the blocks of records may stand as many of invalidation bits.
                let list: Block = file.block(link, head.id)?;
                let count = u32_at(&list.data, 4).map_or(0, |count| count as usize);
                self.next_list = list.link(0);
                self.blocks.extend(list.links.iter().skip(1).take(count).rev());
                Ok(())
            }
            b"##DZ" => self.unpack(head, file),
            id => {
                let id = String::from_utf8_lossy(id).into_owned();
                Err(BlockError::Odd(format!("data cannot stand in a block {id}")))
            }
        }
    }

    /// Takes in a compressed block. A damaged one gives nothing, and leaves a hole of its size.
    fn unpack<R: Read + Seek>(
        &mut self,
        head: BlockHead,
        file: &mut File<R>,
    ) -> Result<(), BlockError> {
        let packed = Packed::of(&head, file)?;
        let mark = self.bytes.len();
        match packed.unpack(file, &mut self.bytes)? {
            Unpacked::Whole => Ok(()),
            Unpacked::Less(why) => {
                self.hole = (packed.length - (self.bytes.len() - mark)) as u64;
                Err(BlockError::Odd(why))
            }
        }
    }
}
