//! Compressed blocks of data (DZ): deflate, Zstandard or LZ4, of the bytes as they are or transposed.

use std::io::{self, BufRead, ErrorKind, Read, Seek};

use flate2::bufread::ZlibDecoder;
use lz4_flex::frame::FrameDecoder;

use super::blocks::{BlockError, BlockHead, File};
use crate::import::little_endian::{u32_at, u64_at};

/// Packed bytes read at a time.
const STEP: usize = 64 << 10;
/// Bytes that one block may have: 16 times what the standard allows.
const LONGEST: usize = 64 << 20;
/// Fields in front of the packed bytes.
const FIELDS: usize = 24;
/// What a Zstandard stream may ask for to keep: twice the longest block that the standard allows.
const WINDOW_LOG: u32 = 23;

/// What a block says of itself (`dz_org_block_type`, `dz_zip_type`, `dz_zip_parameter`, both lengths).
#[derive(Clone, Copy, Debug)]
pub(super) struct Packed {
    /// The two letters of the block that it was.
    pub original: [u8; 2],
    /// 0 deflate; 2 Zstandard and 4 LZ4 since MDF 4.3; one more for transposed bytes.
    method: u8,
    /// Bytes of a row, where transposed.
    columns: usize,
    /// Bytes that it holds.
    pub length: usize,
    at: u64,
    /// Bytes it takes in the file.
    stored: u64,
}

/// How much of a block is there.
#[derive(Debug)]
pub(super) enum Unpacked {
    Whole,
    /// The beginning only, as the file ends in it; or nothing, as the rest is damaged. The reason.
    Less(String),
}

impl Packed {
    /// Reads the fields of the block with this head.
    pub fn of<R: Read + Seek>(head: &BlockHead, file: &mut File<R>) -> Result<Self, BlockError> {
        let mut fields = Vec::with_capacity(FIELDS);
        file.read(head.data_at(), FIELDS, &mut fields)?;
        let found = (|| {
            Some(Self {
                original: [*fields.first()?, *fields.get(1)?],
                method: *fields.get(2)?,
                columns: u32_at(&fields, 4)? as usize,
                length: usize::try_from(u64_at(&fields, 8)?).unwrap_or(usize::MAX),
                at: head.data_at().saturating_add(FIELDS as u64),
                stored: u64_at(&fields, 16)?,
            })
        })();
        let found = found
            .ok_or_else(|| BlockError::Odd("the file ends in the head of this block".into()))?;
        if found.method > 5 || found.length > LONGEST {
            let Self { method, length, .. } = found;
            let text = format!("its compression {method} or length {length} is not supported");
            return Err(BlockError::Odd(text));
        }
        Ok(found)
    }

    /// Appends what it holds to `into`.
    pub fn unpack<R: Read + Seek>(
        &self,
        file: &mut File<R>,
        into: &mut Vec<u8>,
    ) -> Result<Unpacked, BlockError> {
        let mark = into.len();
        let end = self.at.saturating_add(self.stored);
        let cut = end > file.size;
        let bytes = Bytes { file, at: self.at, end, piece: Vec::with_capacity(STEP), used: 0 };
        let mut source: Box<dyn Read + '_> = match self.method {
            0 | 1 => Box::new(ZlibDecoder::new(bytes)),
            2 | 3 => {
                let mut decoder = zstd::stream::read::Decoder::with_buffer(bytes)?;
                decoder.window_log_max(WINDOW_LOG)?;
                Box::new(decoder)
            }
            _ => Box::new(FrameDecoder::new(bytes)),
        };
        // One byte more, so that the end is seen and the checksum looked at.
        into.reserve(self.length.min(4 * STEP));
        let result = source.by_ref().take(self.length as u64 + 1).read_to_end(into);
        drop(source);
        let given = into.len() - mark;
        let transposed = self.method % 2 == 1;
        let why = match result {
            Ok(_) if given == self.length => {
                if transposed && self.columns > 1 {
                    untranspose(&mut into[mark..], self.columns);
                }
                return Ok(Unpacked::Whole);
            }
            Ok(_) if given > self.length => "more bytes than announced".into(),
            Ok(_) => format!("{given} of its {} bytes", self.length),
            // The decoders have errors of their own; those of the file have a number.
            Err(error) if error.raw_os_error().is_some() => return Err(error.into()),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                format!("{given} of its {} bytes", self.length)
            }
            Err(error) => error.to_string(),
        };
        if !cut || transposed || given > self.length {
            into.truncate(mark);
        }
        Ok(Unpacked::Less(format!("this compressed block is damaged: {why}")))
    }
}

/// The packed bytes, one piece after the other.
struct Bytes<'a, R> {
    file: &'a mut File<R>,
    at: u64,
    end: u64,
    piece: Vec<u8>,
    used: usize,
}

impl<R: Read + Seek> BufRead for Bytes<'_, R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.used == self.piece.len() {
            self.used = 0;
            self.piece.clear();
            let step = usize::try_from(self.end.saturating_sub(self.at)).unwrap_or(STEP).min(STEP);
            self.at += self.file.read(self.at, step, &mut self.piece)? as u64;
        }
        Ok(&self.piece[self.used..])
    }

    fn consume(&mut self, count: usize) {
        self.used += count;
    }
}

impl<R: Read + Seek> Read for Bytes<'_, R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let there = self.fill_buf()?;
        let count = there.len().min(into.len());
        into[..count].copy_from_slice(&there[..count]);
        self.consume(count);
        Ok(count)
    }
}

/// Turns columns back into rows: the first bytes of all records, then the second ones, ...; what
/// does not fill a row is at the end as it is.
fn untranspose(bytes: &mut [u8], columns: usize) {
    let matrix = bytes.to_vec();
    let rows = matrix.len() / columns;
    if rows == 0 {
        return;
    }
    for (row, record) in bytes.chunks_exact_mut(columns).enumerate() {
        for (column, byte) in record.iter_mut().enumerate() {
            *byte = matrix[column * rows + row];
        }
    }
}
