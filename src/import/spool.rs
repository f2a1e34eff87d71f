//! Logs that are not read from front to back, but come compressed or through a pipe: they go into a
//! temporary file first.

use std::env;
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Write as _};
use std::path::Path;

use super::{ImportError, LogFrame, LogReader, Skipped};

/// Bytes moved at once.
const STEP: usize = 256 << 10;
/// Names that are tried for the file.
const TRIES: u32 = 100;

/// The bytes of a log in a file that can be read in any order.
pub(super) struct Spooled {
    file: File,
    /// Where the bytes ended before the log did, and why.
    trouble: Option<(u64, String)>,
}

impl Spooled {
    /// The file itself.
    pub fn plain(path: &Path) -> Result<Self, ImportError> {
        Ok(Self { file: File::open(path)?, trouble: None })
    }

    /// All of `input` in a temporary file (in `TMPDIR`, or `/tmp`), which has no name, so that nothing
    /// is left of it whatever happens. How long it gets is up to `input`: of a compressed log
    /// [`super::expand`] gives no more than 300 times its size.
    ///
    /// # Errors
    /// The input or the file fails.
    pub fn of(mut input: impl Read) -> Result<Self, ImportError> {
        let folder = env::temp_dir();
        let mut file = unnamed(&folder).map_err(|error| failed(&folder, &error))?;
        let (mut bytes, mut at) = (vec![0; STEP], 0);
        let trouble = loop {
            match input.read(&mut bytes) {
                Ok(0) => break None,
                Ok(count) => {
                    file.write_all(&bytes[..count]).map_err(|error| failed(&folder, &error))?;
                    at += count as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error)
                    if matches!(
                        error.kind(),
                        ErrorKind::InvalidData | ErrorKind::UnexpectedEof
                    ) =>
                {
                    break Some((at, error.to_string()));
                }
                Err(error) => return Err(error.into()),
            }
        };
        Ok(Self { file, trouble })
    }

    /// Its reader, as `open` makes it.
    pub fn log<L: LogReader + 'static>(
        self,
        open: impl FnOnce(BufReader<File>) -> Result<L, ImportError>,
    ) -> Result<Box<dyn LogReader>, ImportError> {
        let log = open(BufReader::new(self.file))?;
        Ok(match self.trouble {
            Some(trouble) => Box::new(CutOff::new(log, trouble)),
            None => Box::new(log),
        })
    }
}

fn unnamed(folder: &Path) -> io::Result<File> {
    let process = std::process::id();
    for number in 0..TRIES {
        let path = folder.join(format!("bustape-{process}-{number}.part"));
        match File::options().read(true).write(true).create_new(true).open(&path) {
            Ok(file) => return std::fs::remove_file(&path).map(|()| file),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(ErrorKind::AlreadyExists.into())
}

fn failed(folder: &Path, error: &io::Error) -> ImportError {
    let folder = folder.display();
    let text = format!(
        "its bytes cannot be kept in a temporary file in {folder} ({error}); name another folder in \
         TMPDIR, or expand the log first"
    );
    ImportError::Format(text)
}

/// A log of which the end is missing, whatever its reader makes of it.
struct CutOff<L> {
    inner: L,
    trouble: (u64, String),
    skipped: Skipped,
}

impl<L: LogReader> CutOff<L> {
    /// `inner` reads a log that ends with this trouble.
    fn new(inner: L, trouble: (u64, String)) -> Self {
        let mut log = Self { inner, trouble, skipped: Skipped::default() };
        log.count();
        log
    }

    fn count(&mut self) {
        let (at, why) = &self.trouble;
        self.skipped = self.inner.skipped().clone();
        self.skipped.add(|| format!("byte {at}"), || why.clone());
    }
}

impl<L: LogReader> LogReader for CutOff<L> {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let more = self.inner.read(into);
        self.count();
        more
    }

    fn buses(&self) -> &[String] {
        self.inner.buses()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn times_are_relative(&self) -> bool {
        self.inner.times_are_relative()
    }

    fn notes(&self) -> &[String] {
        self.inner.notes()
    }
}
