//! The disk, as the recorder sees it: passed in, so that a test can make the seventh write fail.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::sync::Arc;

use nix::fcntl::{FallocateFlags, fallocate};
use nix::sys::statfs::{MSDOS_SUPER_MAGIC, Statfs, fstatfs, statfs};

/// Where files are made.
pub trait Disk: Send + Sync {
    /// Creates a file that must not exist yet, readable by its owner and group only.
    fn create(&self, path: &Path) -> io::Result<Created>;

    /// Gives a file its final name and makes that durable. An existing file stays as it is.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// True where a file can have two names for a moment, so that at no time it has none.
    fn has_links(&self, folder: &Path) -> bool;

    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;

    /// Makes the names in a folder durable.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;

    /// Bytes that may still be written in a folder.
    fn free(&self, folder: &Path) -> io::Result<u64>;

    /// Size of the disk that a folder is on, in bytes.
    fn capacity(&self, folder: &Path) -> io::Result<u64>;
}

/// A new file, for who writes it and for who waits until it is safe.
pub struct Created {
    /// To write it.
    pub file: Box<dyn OutputFile>,
    /// To sync it meanwhile.
    pub durable: Arc<dyn Durable>,
}

/// A file that another thread is writing.
pub trait Durable: Send + Sync {
    /// Returns when everything written so far would survive a power cut.
    fn sync(&self) -> io::Result<()>;
}

/// A file being written.
pub trait OutputFile: Write + Send {
    /// Returns when everything written so far would survive a power cut.
    fn sync(&mut self) -> io::Result<()>;

    /// Asks for `bytes` of room behind the first `from`, so that no other program takes it. Where the
    /// file system has none, or no such thing, the file grows as it can.
    fn hold(&mut self, _from: u64, _bytes: u64) {}

    /// Gives back the room behind the first `size` bytes, and what stands there.
    fn give_back(&mut self, _size: u64) {}
}

/// The machine's own disk.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealDisk;

impl Disk for RealDisk {
    fn create(&self, path: &Path) -> io::Result<Created> {
        let file = OpenOptions::new().write(true).create_new(true).mode(0o640).open(path)?;
        // Tells everybody that it is being written, for as long as it is open. The name is new, so
        // at most somebody who looks whether it is locked has to be waited for. Where a file system
        // has no locks, nobody can be told.
        file.lock().ok();
        // One open file with two handles: an error that a sync meets is told to either, once.
        let durable = Arc::new(file.try_clone()?);
        Ok(Created { file: Box::new(file), durable })
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        // A hard link refuses to replace an existing file in one step, where rename would not.
        match std::fs::hard_link(from, to) {
            Ok(()) => std::fs::remove_file(from)?,
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Err(error),
            // vfat and some network file systems have no hard links.
            Err(_) if to.try_exists()? => return Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => {
                std::fs::rename(from, to)?;
                // On vfat the place and the size of a file stand beside its name. Linux gives the new
                // name an empty file first and corrects that when the file itself is written (fs/fat/
                // namei_vfat.c): without this a power cut leaves the finished file with 0 bytes.
                File::open(to)?.sync_all()?;
            }
        }
        self.sync_folder(folder_of(to))
    }

    fn has_links(&self, folder: &Path) -> bool {
        // Others without links are on the other side of a network.
        !statfs(folder).is_ok_and(is_fat)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        std::fs::remove_file(path)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        File::open(folder)?.sync_all()
    }

    fn free(&self, folder: &Path) -> io::Result<u64> {
        let stat = nix::sys::statvfs::statvfs(folder)?;
        Ok(stat.blocks_available().saturating_mul(stat.fragment_size()))
    }

    fn capacity(&self, folder: &Path) -> io::Result<u64> {
        let stat = nix::sys::statvfs::statvfs(folder)?;
        Ok(stat.blocks().saturating_mul(stat.fragment_size()))
    }
}

impl Durable for File {
    fn sync(&self) -> io::Result<()> {
        self.sync_data()
    }
}

impl OutputFile for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn hold(&mut self, from: u64, bytes: u64) {
        // The check of a FAT after a power cut takes such room for damage.
        if fstatfs(&*self).is_ok_and(is_fat) {
            return;
        }
        if let (Ok(from), Ok(bytes)) = (i64::try_from(from), i64::try_from(bytes)) {
            // The size of the file stays what was written, whatever it holds (fallocate(2)).
            let _ = fallocate(&*self, FallocateFlags::FALLOC_FL_KEEP_SIZE, from, bytes);
        }
    }

    fn give_back(&mut self, size: u64) {
        self.set_len(size).ok();
    }
}

/// FAT, or exFAT, by the numbers in statfs(2).
fn is_fat(about: Statfs) -> bool {
    const EXFAT: i64 = 0x2011_BAB0;
    let kind = about.filesystem_type();
    kind == MSDOS_SUPER_MAGIC || kind.0 == EXFAT
}

/// True if both names lead to one file.
pub fn is_same(file: &Path, other: &Path) -> bool {
    let identity = |path: &Path| path.metadata().ok().map(|about| (about.dev(), about.ino()));
    identity(file).is_some_and(|found| Some(found) == identity(other))
}

/// True if another process writes the file, as [`RealDisk`] does: it holds its lock.
pub fn is_locked(file: &File) -> bool {
    let locked = matches!(file.try_lock_shared(), Err(std::fs::TryLockError::WouldBlock));
    if !locked {
        file.unlock().ok();
    }
    locked
}

/// The process that has locked a file, as `/proc/locks` tells (proc(5)).
pub fn holder(path: &Path) -> Option<u32> {
    use nix::sys::stat::{major, minor};
    let about = path.metadata().ok()?;
    let (device, inode) = (about.dev(), about.ino());
    let wanted = format!("{:02x}:{:02x}:{inode}", major(device), minor(device));
    let locks = std::fs::read_to_string("/proc/locks").ok()?;
    // "1: FLOCK  ADVISORY  WRITE 1234 08:01:5678 0 EOF"
    let fields = locks.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let mut held = fields.filter(|fields| fields.get(1) == Some(&"FLOCK"));
    held.find(|fields| fields.get(5) == Some(&wanted.as_str()))?.get(4)?.parse().ok()
}

/// The folder a file stands in; `.` for a bare name.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}
