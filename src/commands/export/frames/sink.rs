//! The files of an export of frames, and the writer of its format.

use std::cell::RefCell;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Result, bail};

use crate::cli::export::{Decimal, ExportArgs, Fill, Format, Shape, TimeText};
use crate::commands::UsageError;
use crate::export::frames::csv::Columns;
use crate::export::frames::{asc, blf, candump, csv, hex, mf4, pcapng, raw, trc};
use crate::export::output::Output;
use crate::export::{BusHead, FrameWriter};
use crate::frame::Direction;

/// Written at once.
const BUFFER: usize = 256 << 10;

/// Where an export goes.
pub struct Sink {
    format: Format,
    path: PathBuf,
    force: bool,
    files: Rc<RefCell<Vec<Shared>>>,
}

/// A file that its writer and whoever names it in the end both know.
#[derive(Clone)]
struct Shared(Rc<RefCell<Option<Output>>>);

impl Shared {
    fn create(path: &Path, force: bool) -> Result<Self, crate::export::output::OutputError> {
        Ok(Self(Rc::new(RefCell::new(Some(Output::create(path, force)?)))))
    }

    fn with<T>(&self, act: impl FnOnce(&mut Output) -> io::Result<T>) -> io::Result<T> {
        match self.0.borrow_mut().as_mut() {
            Some(output) => act(output),
            None => Err(io::Error::other("the output is finished")),
        }
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with(|output| output.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.with(Write::flush)
    }
}

impl Read for Shared {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.with(|output| output.read(bytes))
    }
}

impl Seek for Shared {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.with(|output| output.seek(to))
    }
}

/// The options given that say something of tables only.
fn of_tables(args: &ExportArgs) -> String {
    let options = [
        ("--message", !args.messages.is_empty()),
        ("--signal", !args.signals.is_empty()),
        ("--shape", args.shape != Shape::default()),
        ("--fill", args.fill != Fill::default()),
        ("--split", args.split.is_some()),
        ("--time", args.time != TimeText::default()),
        ("--units", args.units),
        ("--separator", args.separator.is_some()),
        ("--decimal", args.decimal != Decimal::default()),
    ];
    let given: Vec<&str> =
        options.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
    given.join(", ")
}

impl Sink {
    /// Refuses what cannot be.
    pub fn new(args: &ExportArgs) -> Result<Self> {
        let stdout = args.output.as_os_str() == "-";
        if stdout && matches!(args.format, Format::Blf | Format::Mf4 | Format::Raw) {
            bail!(UsageError(
                "this format goes into a file, not to stdout: give its name with -o".to_owned()
            ));
        }
        if !args.decode.is_empty() {
            bail!(UsageError(
                "--decode is for tables (csv, parquet, jsonl, influx); this format has frames"
                    .to_owned()
            ));
        }
        let of_tables = of_tables(args);
        if !of_tables.is_empty() {
            bail!(UsageError(format!(
                "{of_tables}: of tables (csv, parquet, jsonl, influx) only, and this format has frames; \
                 leave out what it says nothing of"
            )));
        }
        let (format, path, force) = (args.format, args.output.clone(), args.force);
        Ok(Self { format, path, force, files: Rc::default() })
    }

    /// The writer of the format.
    pub fn writer(&self, buses: &[BusHead]) -> Result<Box<dyn FrameWriter>> {
        if self.format == Format::Raw {
            return Ok(self.raw(buses));
        }
        let file = Shared::create(&self.path, self.force)?;
        self.files.borrow_mut().push(file.clone());
        let out = BufWriter::with_capacity(BUFFER, file.clone());
        Ok(match self.format {
            Format::Asc => Box::new(asc::create(out, buses)),
            Format::Trc => Box::new(trc::create(out, buses)),
            Format::Blf => Box::new(blf::create(out, buses)?),
            Format::Mf4 => Box::new(mf4::create(file, buses)?),
            Format::Pcapng => Box::new(pcapng::create(out, buses)?),
            Format::FramesCsv => Box::new(csv::create(out, buses, Columns::All)),
            Format::PythonCanCsv => Box::new(csv::create(out, buses, Columns::PythonCan)),
            Format::Hex => Box::new(hex::create(out, buses)),
            _ => Box::new(candump::create(out, buses)),
        })
    }

    /// `NAME.BUS.rx.END` and `NAME.BUS.tx.END` for `NAME.END`.
    fn raw(&self, buses: &[BusHead]) -> Box<dyn FrameWriter> {
        let (path, force, files) = (self.path.clone(), self.force, Rc::clone(&self.files));
        let create = move |bus: &str, direction: Direction| {
            let way = if direction == Direction::Tx { "tx" } else { "rx" };
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let ending = path.extension().unwrap_or("bin".as_ref()).to_string_lossy();
            let bus = crate::export::path_name(bus);
            let path = path.with_file_name(format!("{stem}.{bus}.{way}.{ending}"));
            let file = Shared::create(&path, force).map_err(io::Error::other)?;
            files.borrow_mut().push(file.clone());
            Ok(BufWriter::with_capacity(BUFFER, file))
        };
        Box::new(raw::create(Box::new(create), buses))
    }

    /// Gives the files their names.
    pub fn finish(&self) -> Result<()> {
        for file in self.files.borrow_mut().drain(..) {
            if let Some(output) = file.0.borrow_mut().take() {
                output.finish()?;
            }
        }
        Ok(())
    }
}
