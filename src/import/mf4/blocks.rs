//! Blocks: identifier, length, links to other blocks by address, data. Nothing of it is trusted.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use crate::import::little_endian::u64_at;

/// Identifier, reserved, length, number of links.
pub(super) const HEAD: u64 = 24;
/// The longest block that is read whole; data are read piece by piece.
const LONGEST: u64 = 16 << 20;

/// A file of blocks.
pub(super) struct File<R> {
    input: BufReader<R>,
    at: u64,
    /// Bytes of the file.
    pub size: u64,
}

/// The first bytes of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockHead {
    pub id: [u8; 4],
    /// Where it is.
    pub at: u64,
    /// Its bytes, head and links included, as it says.
    pub length: u64,
    pub links: u64,
}

impl BlockHead {
    /// Where its data begin.
    pub fn data_at(&self) -> u64 {
        self.at.saturating_add(HEAD).saturating_add(self.links.saturating_mul(8))
    }
}

/// A block with its links and data.
#[derive(Debug)]
pub(super) struct Block {
    pub links: Vec<u64>,
    pub data: Vec<u8>,
}

impl Block {
    /// A link; 0 if there is none.
    pub fn link(&self, index: usize) -> u64 {
        self.links.get(index).copied().unwrap_or(0)
    }
}

/// The bytes are not what they should be, or the file cannot be read.
#[derive(Debug)]
pub(super) enum BlockError {
    /// What is wrong with them.
    Odd(String),
    /// The file gives no more bytes.
    Read(io::Error),
}

impl From<io::Error> for BlockError {
    fn from(error: io::Error) -> Self {
        Self::Read(error)
    }
}

impl<R: Read + Seek> File<R> {
    pub fn new(mut input: R) -> io::Result<Self> {
        let size = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        Ok(Self { input: BufReader::with_capacity(64 << 10, input), at: 0, size })
    }

    /// Appends up to `length` bytes from `at` on to `into`: fewer only at the end of the file.
    pub fn read(&mut self, at: u64, length: usize, into: &mut Vec<u8>) -> io::Result<usize> {
        if at != self.at {
            self.input.seek_relative(at.wrapping_sub(self.at) as i64)?;
            self.at = at;
        }
        let read = self.input.by_ref().take(length as u64).read_to_end(into)?;
        self.at += read as u64;
        Ok(read)
    }

    /// Reads the head of the block at `at`.
    pub fn head(&mut self, at: u64) -> Result<BlockHead, BlockError> {
        if at >= self.size {
            let size = self.size;
            let text = format!("a link leads to byte {at} of a file that has {size}");
            return Err(BlockError::Odd(text));
        }
        let mut bytes = Vec::with_capacity(24);
        self.read(at, 24, &mut bytes)?;
        let id = bytes.get(..4).and_then(|id| id.try_into().ok());
        let (Some(id), Some(length), Some(links)) = (id, u64_at(&bytes, 8), u64_at(&bytes, 16))
        else {
            return Err(BlockError::Odd("the file ends here, in the head of a block".into()));
        };
        Ok(BlockHead { id, at, length, links })
    }

    /// Reads the block at `at`, which must be of this kind.
    pub fn block(&mut self, at: u64, id: [u8; 4]) -> Result<Block, BlockError> {
        let head = self.head(at)?;
        let name = || String::from_utf8_lossy(&id).into_owned();
        if head.id != id {
            return Err(BlockError::Odd(format!("no block {} stands here", name())));
        }
        let links = head.links.checked_mul(8).and_then(|links| links.checked_add(HEAD));
        let fits = links.is_some_and(|links| links <= head.length) && head.length <= LONGEST;
        let left = self.size - at;
        if !fits || head.length > left {
            let text = format!("block {} says it has {} bytes", name(), head.length);
            return Err(BlockError::Odd(format!("{text}, and {left} are left in the file")));
        }
        let mut bytes = Vec::new();
        self.read(at + HEAD, usize::try_from(head.length - HEAD).unwrap_or(0), &mut bytes)?;
        let data = bytes.split_off(usize::try_from(head.links * 8).unwrap_or(0).min(bytes.len()));
        let links = bytes.chunks_exact(8).filter_map(|link| u64_at(link, 0)).collect();
        Ok(Block { links, data })
    }

    /// The text of a TX or MD block, empty if there is none.
    pub fn text(&mut self, at: u64) -> Result<String, BlockError> {
        if at == 0 {
            return Ok(String::new());
        }
        let id = self.head(at)?.id;
        if id != *b"##TX" && id != *b"##MD" {
            return Ok(String::new());
        }
        let block = self.block(at, id)?;
        let end = block.data.iter().position(|byte| *byte == 0).unwrap_or(block.data.len());
        Ok(String::from_utf8_lossy(&block.data[..end]).into_owned())
    }
}
