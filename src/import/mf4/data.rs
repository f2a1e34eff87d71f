//! The bytes of a data group or signal: blocks DT, SD and DZ, alone or in lists (HL, DL).

use std::collections::HashSet;
use std::io::{Read, Seek};

use flate2::{Decompress, FlushDecompress, Status};

use super::blocks::{Block, BlockError, BlockHead, File, HEAD};
use crate::import::Skipped;
use crate::import::little_endian::{u32_at, u64_at};

/// Bytes read at a time.
const STEP: usize = 64 << 10;
/// Bytes that one compressed block may have: 16 times what the standard allows.
const LONGEST: usize = 64 << 20;

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
            self.next_list = 0;
            return Ok(self.another());
        }
        match self.open_block(link, file) {
            Ok(()) => Ok(true),
            Err(BlockError::Odd(why)) => {
                skipped.add(|| format!("byte {link}"), || why);
                Ok(true)
            }
            Err(error) => Err(error),
        }
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
            b"##DZ" => self.inflate(head, file),
            id => {
                let id = String::from_utf8_lossy(id).into_owned();
                Err(BlockError::Odd(format!("data cannot stand in a block {id}")))
            }
        }
    }

    /// Takes in a compressed block. A damaged one gives nothing, and leaves a hole of its size.
    fn inflate<R: Read + Seek>(
        &mut self,
        head: BlockHead,
        file: &mut File<R>,
    ) -> Result<(), BlockError> {
        let mut fields = Vec::with_capacity(24);
        file.read(head.data_at(), 24, &mut fields)?;
        let fields = (|| {
            let (method, columns) = (*fields.get(2)?, u32_at(&fields, 4)?);
            Some((method, columns as usize, u64_at(&fields, 8)?, u64_at(&fields, 16)?))
        })();
        let Some((method, columns, length, packed)) = fields else {
            return Err(BlockError::Odd("the file ends in the head of this block".into()));
        };
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        if method > 1 || length > LONGEST {
            let text = format!("its compression {method} or length {length} is not supported");
            return Err(BlockError::Odd(text));
        }
        let mark = self.bytes.len();
        let at = head.data_at() + 24;
        let result = inflate(file, at, packed, length, &mut self.bytes);
        let given = self.bytes.len() - mark;
        if given == length && result.is_ok() {
            if method == 1 && columns > 1 {
                untranspose(&mut self.bytes, mark, columns);
            }
            return Ok(());
        }
        // The beginning of what is not transposed is good if the file ends in it.
        let cut = method == 0 && matches!(result, Ok(false));
        if !cut {
            self.bytes.truncate(mark);
        }
        self.hole = (length - (self.bytes.len() - mark)) as u64;
        if let Err(BlockError::Read(error)) = result {
            return Err(error.into());
        }
        let text = format!("this compressed block is damaged: {given} of its {length} bytes");
        Err(BlockError::Odd(text))
    }
}

/// Decompresses `packed` bytes from `at` on, no more than `length`. `false` when the file ends.
fn inflate<R: Read + Seek>(
    file: &mut File<R>,
    mut at: u64,
    packed: u64,
    length: usize,
    into: &mut Vec<u8>,
) -> Result<bool, BlockError> {
    let end = at.saturating_add(packed);
    let mark = into.len();
    let mut inflate = Decompress::new(true);
    let (mut block, mut used) = (Vec::with_capacity(STEP), 0);
    loop {
        if used == block.len() {
            block.clear();
            used = 0;
            let step = usize::try_from(end - at).unwrap_or(STEP).min(STEP);
            let read = file.read(at, step, &mut block)?;
            if read == 0 {
                return Ok(false);
            }
            at += read as u64;
        }
        into.reserve(STEP);
        let (before, given) = (inflate.total_in(), into.len());
        let status = inflate
            .decompress_vec(&block[used..], into, FlushDecompress::None)
            .map_err(|error| BlockError::Odd(error.to_string()))?;
        used += usize::try_from(inflate.total_in() - before).unwrap_or(0);
        let stuck = inflate.total_in() == before && into.len() == given;
        if into.len() - mark > length || stuck && status != Status::StreamEnd {
            into.truncate(mark);
            return Err(BlockError::Odd("more bytes than announced".into()));
        }
        if status == Status::StreamEnd {
            return Ok(true);
        }
    }
}

/// Turns columns back into rows: the first bytes of all records, then the second ones, ...; what
/// does not fill a row is at the end as it is.
fn untranspose(bytes: &mut [u8], from: usize, columns: usize) {
    let matrix = bytes[from..].to_vec();
    let rows = matrix.len() / columns;
    if rows == 0 {
        return;
    }
    for (row, record) in bytes[from..].chunks_exact_mut(columns).enumerate() {
        for (column, byte) in record.iter_mut().enumerate() {
            *byte = matrix[column * rows + row];
        }
    }
}
