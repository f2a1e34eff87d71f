//! Text that goes to one file or to stdout, or to a file for each day or hour.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::output::{Output, about, part_of};
use super::period::Split;
use crate::frame::Timestamp;

/// Bytes written at once.
const PIECE: usize = 128 << 10;

/// Where text goes.
pub struct Stream {
    place: Place,
    buffer: Vec<u8>,
    begun: bool,
    files: u64,
}

enum Place {
    Single(Option<Output>),
    Periods { folder: PathBuf, ending: &'static str, split: Split, open: Option<(u64, PathBuf)> },
}

impl Stream {
    /// To one file or stdout, which gets its name in [`Stream::finish`].
    pub fn to(output: Output) -> Self {
        Self::with(Place::Single(Some(output)))
    }

    /// To `folder`, `2026-11-22.csv` and so on.
    pub fn into_folder(folder: &Path, ending: &'static str, split: Split) -> Self {
        Self::with(Place::Periods { folder: folder.to_owned(), ending, split, open: None })
    }

    fn with(place: Place) -> Self {
        Self { place, buffer: Vec::with_capacity(PIECE + 4096), begun: false, files: 0 }
    }

    /// Says that what follows is of this time. True when it goes to a new file.
    #[inline]
    pub fn at(&mut self, time: Timestamp) -> io::Result<bool> {
        match &self.place {
            Place::Single(_) => {
                self.files = 1;
                Ok(!std::mem::replace(&mut self.begun, true))
            }
            Place::Periods { split, open, .. } => {
                let number = split.number(time);
                if open.as_ref().is_some_and(|(open, _)| *open == number) {
                    return Ok(false);
                }
                self.open(number)
            }
        }
    }

    /// True once where text goes to one place and there was none: its head is still to be written.
    pub fn begin_empty(&mut self) -> bool {
        let single = matches!(self.place, Place::Single(_));
        self.files = self.files.max(u64::from(single));
        single && !std::mem::replace(&mut self.begun, true)
    }

    fn open(&mut self, number: u64) -> io::Result<bool> {
        self.flush()?;
        let Place::Periods { folder, ending, split, open } = &mut self.place else {
            return Ok(false);
        };
        let path = part_of(&folder.join(format!("{}.{ending}", split.name(number))));
        // Times of a log may go back to a file that was begun before.
        let new = !path.exists();
        self.files += u64::from(new);
        *open = Some((number, path));
        Ok(new)
    }

    /// Where text is appended, followed by [`Stream::pass_on`].
    #[inline]
    pub fn buffer(&mut self) -> &mut Vec<u8> {
        &mut self.buffer
    }

    /// Writes what is enough to be written.
    #[inline]
    pub fn pass_on(&mut self) -> io::Result<()> {
        if self.buffer.len() >= PIECE { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        match &mut self.place {
            Place::Single(Some(output)) => output.write_all(&self.buffer)?,
            Place::Single(None) | Place::Periods { open: None, .. } => {}
            Place::Periods { open: Some((_, path)), .. } => append(path, &self.buffer)?,
        }
        self.buffer.clear();
        Ok(())
    }

    /// Writes what is left; one file gets its name.
    pub fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        if let Place::Single(output) = &mut self.place
            && let Some(mut output) = output.take()
        {
            output.flush()?;
            output.finish().map_err(io::Error::other)?;
        }
        Ok(())
    }

    /// Files so far.
    pub fn files(&self) -> u64 {
        self.files
    }
}

/// Appends to a file that is opened for it: any number of files can grow side by side.
pub fn append(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let file = File::options().append(true).create(true).open(path);
    file.and_then(|mut file| file.write_all(bytes)).map_err(|error| about(path, &error))
}
