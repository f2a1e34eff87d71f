//! Decompression of chunks, never beyond what was announced, and that never beyond the limit.

use std::io::Read as _;

use super::limits::MAX_CHUNK;
use super::records::ChunkHead;

/// Why a chunk's records cannot be had, or not all of them.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unpack {
    /// It announces more than is read.
    #[error("it claims {0} bytes uncompressed, more than the {MAX_CHUNK} that are read")]
    TooLarge(u64),
    /// A compression that the format does not have.
    #[error("its compression \"{0}\" is not known; zstd, lz4 and none are")]
    Unknown(String),
    /// The data make no sense to the decompressor.
    #[error("it cannot be decompressed: {0}")]
    Damaged(String),
    /// Less came out than was announced.
    #[error("it has {0} bytes, not the {1} it claims")]
    Short(usize, usize),
    /// All came out, but it is not what went in.
    #[error("its checksum is wrong")]
    Checksum,
}

/// Decompresses a chunk into `out`. After an error `out` holds what came out of it until then.
pub fn unpack(head: &ChunkHead<'_>, compressed: &[u8], out: &mut Vec<u8>) -> Result<(), Unpack> {
    out.clear();
    let size = head.uncompressed;
    let too_large = Unpack::TooLarge(size);
    let size = usize::try_from(size).ok().filter(|_| size <= MAX_CHUNK).ok_or(too_large)?;
    let result = match head.compression {
        "" => {
            out.extend_from_slice(&compressed[..compressed.len().min(size)]);
            Ok(())
        }
        "zstd" => unpack_zstd(compressed, size, out),
        "lz4" => read_up_to(lz4_flex::frame::FrameDecoder::new(compressed), size, out),
        other => return Err(Unpack::Unknown(other.to_owned())),
    };
    result.map_err(|error| Unpack::Damaged(error.to_string()))?;
    if out.len() != size {
        return Err(Unpack::Short(out.len(), size));
    }
    if head.crc != 0 && crc32fast::hash(out) != head.crc {
        return Err(Unpack::Checksum);
    }
    Ok(())
}

fn unpack_zstd(compressed: &[u8], size: usize, out: &mut Vec<u8>) -> std::io::Result<()> {
    out.reserve(size);
    let at_once = zstd::bulk::Decompressor::new()?.decompress_to_buffer(compressed, out);
    if at_once.is_ok() {
        return Ok(());
    }
    // Piece by piece, for what stands before the damage.
    out.clear();
    let mut decoder = zstd::stream::read::Decoder::new(compressed)?;
    // No window beyond the largest chunk: it is allocated before there is anything in it.
    decoder.window_log_max(MAX_CHUNK.ilog2())?;
    read_up_to(decoder, size, out)
}

/// Reads `size` bytes, and fails if there are more.
fn read_up_to(from: impl std::io::Read, size: usize, out: &mut Vec<u8>) -> std::io::Result<()> {
    out.reserve(size);
    let mut from = from.take(size as u64 + 1);
    let result = from.read_to_end(out);
    if out.len() > size {
        out.truncate(size);
        return Err(std::io::Error::other(format!(
            "there are more than the {size} bytes it claims"
        )));
    }
    result.map(drop)
}
