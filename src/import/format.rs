//! The formats of logs, and which one a file has by its content.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::rc::Rc;

use super::expand::{Compression, Counted, expanded};
use super::spool::Spooled;
use super::{ImportError, LogReader, Settings, asc, blf, candump, csv, mf4, pcap, raw, trc};

/// So much of a file is looked at to find its format.
const HEAD: usize = 64 << 10;

/// A format of logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// candump's log or screen output; what `bustape cat` prints, serial bytes too
    Candump,
    /// Vector ASC
    Asc,
    /// PEAK TRC, versions 1.0 to 2.1
    Trc,
    /// pcap or pcapng with SocketCAN frames
    Pcap,
    /// Vector BLF
    Blf,
    /// ASAM MDF 4 with bus logging
    Mf4,
    /// CSV of frames, as bustape and python-can write it
    Csv,
    /// Bytes of a serial line, without anything else
    Raw,
}

impl Format {
    /// As a person calls it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Candump => "candump",
            Self::Asc => "Vector ASC",
            Self::Trc => "PEAK TRC",
            Self::Pcap => "pcap",
            Self::Blf => "Vector BLF",
            Self::Mf4 => "MDF 4",
            Self::Csv => "CSV",
            Self::Raw => "raw bytes",
        }
    }

    /// The format of a log with this beginning.
    pub fn of(head: &[u8]) -> Option<Self> {
        // From those that a few bytes tell for certain to those that a text may resemble.
        let known: [(Self, Recognises); 7] = [
            (Self::Blf, blf::recognises),
            (Self::Mf4, mf4::recognises),
            (Self::Pcap, pcap::recognises),
            (Self::Trc, trc::recognises),
            (Self::Asc, asc::recognises),
            (Self::Csv, csv::recognises),
            (Self::Candump, candump::recognises),
        ];
        known.into_iter().find(|(_, recognises)| recognises(head)).map(|(format, _)| format)
    }
}

/// Tells a format by the first bytes.
type Recognises = fn(&[u8]) -> bool;

/// A log that is open.
pub struct Opened {
    /// Gives its frames.
    pub reader: Box<dyn LogReader>,
    /// Its format.
    pub format: Format,
    /// Its compression.
    pub compression: Option<Compression>,
    /// Bytes of the file, where it has an end.
    pub size: Option<u64>,
    /// Bytes of the file that were read so far.
    pub taken: Rc<Cell<u64>>,
}

/// Opens a log, stdin for `-`. Its format is found by its content unless it is given.
///
/// # Errors
/// It cannot be read, or is in no format that is known.
pub fn open(
    path: &Path,
    format: Option<Format>,
    settings: &Settings,
) -> Result<Opened, ImportError> {
    let (file, size): (Box<dyn Read>, _) = if path.as_os_str() == "-" {
        (Box::new(io::stdin()), None)
    } else {
        let file = File::open(path)?;
        let about = file.metadata()?;
        (Box::new(file), about.is_file().then_some(about.len()))
    };
    let taken = Rc::new(Cell::new(0));
    let mut input: Box<dyn Read> = Box::new(Counted { input: file, taken: Rc::clone(&taken) });
    let mut head = head_of(&mut input)?;
    let compression = Compression::of(&head).filter(|_| format != Some(Format::Raw));
    if let Some(kind) = compression {
        input = expanded(Box::new(io::Cursor::new(head).chain(input)), kind)?;
        head = head_of(&mut input)?;
    }
    let format = format.or_else(|| Format::of(&head)).ok_or_else(|| unknown(&head))?;
    let whole: Box<dyn Read> = Box::new(io::Cursor::new(head.clone()).chain(input));
    // Two formats are not read from front to back.
    let seekable = |whole| match compression {
        None if size.is_some() => Spooled::plain(path),
        _ => Spooled::of(whole),
    };
    let reader: Box<dyn LogReader> = match format {
        Format::Candump => Box::new(candump::open(whole, &head, settings)),
        Format::Asc => Box::new(asc::open(whole, settings)),
        Format::Trc => Box::new(trc::open(whole, settings)),
        Format::Pcap => Box::new(pcap::open(whole)?),
        Format::Blf => seekable(whole)?.log(blf::open)?,
        Format::Mf4 => seekable(whole)?.log(mf4::open)?,
        Format::Csv => Box::new(csv::open(whole, &head)?),
        Format::Raw => Box::new(raw::open(whole, settings)?),
    };
    Ok(Opened { reader, format, compression, size, taken })
}

/// The first bytes; fewer if the input ends, or is damaged, before that.
fn head_of(input: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut head = vec![0; HEAD];
    let mut filled = 0;
    while filled < HEAD {
        match input.read(&mut head[filled..]) {
            Ok(0) => break,
            Ok(count) => filled += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            // A damaged end is met again, and said, when the log is read to there.
            Err(error) if filled > 0 && error.kind() != io::ErrorKind::Other => {
                head.truncate(filled);
                return Ok(head);
            }
            Err(error) => return Err(error),
        }
    }
    head.truncate(filled);
    Ok(head)
}

fn unknown(head: &[u8]) -> ImportError {
    ImportError::Format(if head.is_empty() {
        "it is empty".to_owned()
    } else {
        "its content is of no format that is known (candump, Vector ASC and BLF, PEAK TRC, MDF 4, pcap, pcapng, \
         CSV of frames); bytes of a serial line are taken with --format raw"
            .to_owned()
    })
}
