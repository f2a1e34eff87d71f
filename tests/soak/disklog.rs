//! The log of a disk, as QEMU's `blklogwrites` and the kernel's dm-log-writes keep it.
//!
//! Source: `Documentation/admin-guide/device-mapper/log-writes.rst` and `block/blklogwrites.c`. A sector
//! with the head (magic, version, number of entries, sector size), then for each entry a sector with its
//! head (sector, number of sectors, flags, length of data) and the data that was written. All numbers are
//! little-endian.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::Path;

const MAGIC: u64 = 0x006a_7366_7773_6872;
const SECTOR: u64 = 512;

const FLUSH: u64 = 1;
const FUA: u64 = 2;
const DISCARD: u64 = 4;

/// The log.
pub struct Log {
    file: File,
    /// In the order in which they reached the disk.
    pub entries: Vec<Entry>,
}

/// A write, a flush or a discard.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Where in the log it begins.
    pub offset: u64,
    /// Where on the disk its data belong, in bytes.
    pub at: u64,
    /// How much data it has, in bytes.
    pub length: u64,
    flags: u64,
}

impl Entry {
    /// Written past the cache of the disk.
    pub fn is_forced(&self) -> bool {
        self.flags & FUA != 0
    }
}

impl Log {
    /// Reads a log up to where it is whole.
    pub fn read(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let size = file.metadata()?.len();
        let word = |at: u64| -> io::Result<u64> {
            let mut bytes = [0; 8];
            file.read_exact_at(&mut bytes, at)?;
            Ok(u64::from_le_bytes(bytes))
        };
        if word(0)? != MAGIC {
            return Err(io::Error::other("not a log of a disk"));
        }
        let (mut entries, mut offset) = (Vec::new(), SECTOR);
        // The head's number of entries lags behind; the file tells.
        while offset + SECTOR <= size {
            let (sector, count, flags) = (word(offset)?, word(offset + 8)?, word(offset + 16)?);
            let data = if flags & DISCARD == 0 { count * SECTOR } else { 0 };
            if offset + SECTOR + data > size {
                break;
            }
            entries.push(Entry { offset, at: sector * SECTOR, length: data, flags });
            offset += SECTOR + data;
        }
        Ok(Self { file, entries })
    }

    /// How many of the first `count` entries are on the disk for certain: those before its last flush.
    pub fn durable(&self, count: usize) -> usize {
        self.entries[..count]
            .iter()
            .rposition(|entry| entry.flags & FLUSH != 0)
            .map_or(0, |at| at + 1)
    }

    /// Writes the first `length` bytes of an entry's data to a disk.
    pub fn apply(&self, entry: &Entry, length: u64, disk: &File) {
        let mut bytes = vec![0; length as usize];
        self.file.read_exact_at(&mut bytes, entry.offset + SECTOR).expect("the log holds it");
        disk.write_all_at(&bytes, entry.at).expect("the disk takes it");
    }
}
