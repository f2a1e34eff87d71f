//! The bytes of a log, expanded where they are compressed, as a stream.

use std::cell::Cell;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::rc::Rc;

/// Expanded data that cannot be a log: text compresses 5 to 30 times, and no log of this size
/// compresses so much better.
const BOMB_BYTES: u64 = 256 << 20;
const BOMB_RATIO: u64 = 300;
/// What a zstd stream may ask for to keep: 2^27 bytes are what `zstd -d` grants.
const WINDOW_LOG: u32 = 27;

/// Compression of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// gzip (RFC 1952).
    Gzip,
    /// Zstandard (RFC 8878).
    Zstd,
}

impl Compression {
    /// By the first bytes.
    pub fn of(head: &[u8]) -> Option<Self> {
        match head {
            [0x1F, 0x8B, 8, ..] => Some(Self::Gzip),
            [0x28, 0xB5, 0x2F, 0xFD, ..] => Some(Self::Zstd),
            _ => None,
        }
    }
}

/// The expanded bytes of `input`.
pub fn expanded(input: Box<dyn Read>, kind: Compression) -> io::Result<Box<dyn Read>> {
    let taken = Rc::new(Cell::new(0));
    let counted = BufReader::with_capacity(64 << 10, Counted { input, taken: Rc::clone(&taken) });
    let inner: Box<dyn Read> = match kind {
        Compression::Gzip => Box::new(flate2::bufread::MultiGzDecoder::new(counted)),
        Compression::Zstd => {
            let mut decoder = zstd::stream::read::Decoder::with_buffer(counted)?;
            decoder.window_log_max(WINDOW_LOG)?;
            Box::new(decoder)
        }
    };
    Ok(Box::new(Guarded { inner, taken, given: 0 }))
}

/// Counts the bytes read.
pub struct Counted<R> {
    /// What is read.
    pub input: R,
    /// How many bytes of it.
    pub taken: Rc<Cell<u64>>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(into)?;
        self.taken.set(self.taken.get() + count as u64);
        Ok(count)
    }
}

impl<R: Seek> Seek for Counted<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.input.seek(to)
    }
}

/// Ends what is damaged or meant to fill a disk with an error that says so.
struct Guarded {
    inner: Box<dyn Read>,
    taken: Rc<Cell<u64>>,
    given: u64,
}

impl Read for Guarded {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(into).map_err(|error| match error.kind() {
            ErrorKind::Interrupted => error,
            // Both libraries report damage in several ways.
            ErrorKind::UnexpectedEof => io::Error::new(
                ErrorKind::UnexpectedEof,
                "the compressed file is cut off: what follows is missing",
            ),
            _ => io::Error::new(
                ErrorKind::InvalidData,
                format!("the compressed file is damaged ({error}): what follows is missing"),
            ),
        })?;
        self.given += count as u64;
        if self.given > BOMB_BYTES && self.given / self.taken.get().max(1) > BOMB_RATIO {
            let text = format!(
                "it expands to more than {BOMB_RATIO} times its size, which no log does: the rest \
                 is not read"
            );
            return Err(io::Error::new(ErrorKind::InvalidData, text));
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        out.write_all(bytes).unwrap();
        out.finish().unwrap()
    }

    fn read(bytes: Vec<u8>) -> (Vec<u8>, Option<ErrorKind>) {
        let kind = Compression::of(&bytes).unwrap();
        let mut input = expanded(Box::new(io::Cursor::new(bytes)), kind).unwrap();
        let (mut all, mut part) = (Vec::new(), vec![0; 10_000]);
        loop {
            match input.read(&mut part) {
                Ok(0) => return (all, None),
                Ok(count) => all.extend_from_slice(&part[..count]),
                Err(error) => return (all, Some(error.kind())),
            }
        }
    }

    #[test]
    fn what_is_intact_comes_out_and_damage_is_said() {
        let text: Vec<u8> = (0..300_000u32).flat_map(|n| n.to_string().into_bytes()).collect();
        let zst = zstd::encode_all(&text[..], 1).unwrap();
        for whole in [gzip(&text), zst] {
            assert_eq!(read(whole.clone()), (text.clone(), None));
            let (part, error) = read(whole[..whole.len() / 2].to_vec());
            assert_eq!(error, Some(ErrorKind::UnexpectedEof));
            assert!(part.len() > 1000 && text.starts_with(&part));
        }
        let two = [gzip(&text), gzip(b"more")].concat();
        assert!(read(two).0.ends_with(b"more"));
    }
}
