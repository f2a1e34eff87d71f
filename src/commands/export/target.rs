//! Where an export goes, and the writer of its format and shape.

use anyhow::{Result, bail};

use crate::cli::export::{Decimal, ExportArgs, Fill, Format, Shape, SplitBy, TimeText};
use crate::commands::UsageError;
use crate::export::TableWriter;
use crate::export::catalogue::Catalogue;
use crate::export::output::{Output, OutputFolder};
use crate::export::parquet::dataset::Dataset;
use crate::export::parquet::flat::{FlatParquet, Place};
use crate::export::period::Split;
use crate::export::rows::{FlatWriter, Rows};
use crate::export::shape::long::Long;
use crate::export::shape::wide::Wide;
use crate::export::shape::{frames, long, wide};
use crate::export::stream::Stream;
use crate::export::table::Table;
use crate::export::text::TimeStyle;
use crate::export::text::csv::{CsvWriter, Style};
use crate::export::text::csv_folder::CsvFolder;
use crate::export::text::influx::InfluxWriter;
use crate::export::text::jsonl::{JsonFlat, JsonRows};

/// A new file, or a new folder.
pub enum Target {
    /// A file or stdout, until the writer takes it.
    File(Option<Output>),
    /// A folder.
    Folder(OutputFolder),
}

impl Target {
    /// Makes it, or says why not.
    pub fn create(args: &ExportArgs) -> Result<Self> {
        if is_folder(args) {
            return Ok(Self::Folder(OutputFolder::create(&args.output, args.force)?));
        }
        Ok(Self::File(Some(Output::create(&args.output, args.force)?)))
    }

    /// The writer for tables that `args` ask for. `lengths` says for each table of the catalogue how
    /// often things repeat in it, which wide tables have to know.
    pub fn writer(
        &mut self,
        args: &ExportArgs,
        catalogue: &Catalogue,
        lengths: &[u64],
    ) -> Result<Box<dyn TableWriter>> {
        let split = split(args);
        Ok(match (args.format, args.shape, &*self) {
            (Format::Parquet, Shape::Message, Self::Folder(folder)) => {
                Box::new(Dataset::new(folder.part(), args.compression, split))
            }
            (Format::Csv, Shape::Message, Self::Folder(folder)) => {
                Box::new(Rows::new(CsvFolder::new(folder.part(), style(args), split)))
            }
            (Format::Jsonl, Shape::Message, _) => {
                Box::new(Rows::new(JsonRows::new(self.stream(args)?, time(args))))
            }
            (Format::Influx, ..) => Box::new(Rows::new(InfluxWriter::new(self.stream(args)?))),
            (_, Shape::Wide, _) => {
                let fill = match args.fill {
                    Fill::Hold => wide::Fill::Hold,
                    Fill::Mean => wide::Fill::Mean,
                    Fill::None => wide::Fill::None,
                };
                let tables = catalogue.tables();
                let flat = self.flat(args, wide::layout(&tables, lengths, fill))?;
                let step = u64::try_from(args.every.as_nanos()).unwrap_or(u64::MAX);
                Box::new(Rows::new(Wide::new(flat, &tables, lengths, step, fill)))
            }
            _ => Box::new(Rows::new(Long::new(self.flat(args, long::layout())?))),
        })
    }

    /// The writer for raw frames.
    pub fn frames(&mut self, args: &ExportArgs) -> Result<frames::Frames> {
        Ok(frames::Frames::new(self.flat(args, frames::layout())?))
    }

    fn flat(&mut self, args: &ExportArgs, table: Table) -> Result<Box<dyn FlatWriter>> {
        Ok(match args.format {
            Format::Parquet => {
                let place = match self {
                    Self::File(output) => Place::File(output.take()),
                    Self::Folder(folder) => Place::Folder(folder.part().to_owned(), split(args)),
                };
                Box::new(FlatParquet::new(table, place, args.compression))
            }
            Format::Csv => Box::new(CsvWriter::new(table, self.stream(args)?, style(args))),
            _ => Box::new(JsonFlat::new(table, self.stream(args)?, time(args))),
        })
    }

    fn stream(&mut self, args: &ExportArgs) -> Result<Stream> {
        let ending = match args.format {
            Format::Csv => "csv",
            Format::Jsonl => "jsonl",
            _ => "influx",
        };
        match self {
            Self::File(output) => match output.take() {
                Some(output) => Ok(Stream::to(output)),
                None => bail!("{} is being written already", args.output.display()),
            },
            Self::Folder(folder) => Ok(Stream::into_folder(folder.part(), ending, split(args))),
        }
    }

    /// Gives a folder its name; files have theirs already.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Folder(folder) => folder.finish()?,
            Self::File(_) => {}
        }
        Ok(())
    }
}

/// An error for combinations that make no sense.
pub fn check(args: &ExportArgs) -> Result<()> {
    let stdout = args.output.as_os_str() == "-";
    let wrong = |text: &str| Err(UsageError(text.to_owned()).into());
    if args.format == Format::Influx && args.shape != Shape::Message {
        return wrong("--format influx has one shape, a line for each message; leave --shape out");
    }
    if stdout && args.format == Format::Parquet {
        return wrong("Parquet cannot go to stdout; give a file or folder to -o");
    }
    if stdout && args.split.is_some() {
        return wrong("--split makes several files; give a folder to -o");
    }
    if stdout && args.format == Format::Csv && args.shape == Shape::Message {
        return wrong(
            "--format csv makes a file for each message; give a folder to -o, or use --shape long",
        );
    }
    if args.shape == Shape::Wide && args.files.iter().any(|file| file.as_os_str() == "-") {
        return wrong("--shape wide reads its input twice, so it cannot be stdin");
    }
    let of_signals = [&args.decode, &args.messages, &args.signals];
    if args.shape == Shape::Frames && of_signals.iter().any(|list| !list.is_empty()) {
        return wrong(
            "--shape frames has raw frames, of which --decode, --message and --signal say nothing; \
             leave them out, or --shape",
        );
    }
    if args.shape != Shape::Frames && !args.filters.is_empty() {
        return wrong(
            "--filter is about raw frames; of tables of signals select with --bus, --message and \
             --signal",
        );
    }
    if style(args).decimal_comma && style(args).separator == b',' {
        return wrong("with --decimal comma the columns need another --separator, such as ;");
    }
    if args.format == Format::Csv && args.time == TimeText::Iso && style(args).separator == b':' {
        return wrong(
            "times such as 03:15:00 have colons; choose another --separator, or --time epoch",
        );
    }
    Ok(())
}

/// True where there are several files.
fn is_folder(args: &ExportArgs) -> bool {
    let many = matches!(args.format, Format::Parquet | Format::Csv) && args.shape == Shape::Message;
    many || args.split.is_some()
}

fn split(args: &ExportArgs) -> Split {
    match args.split {
        None => Split::Never,
        Some(SplitBy::Day) => Split::Day,
        Some(SplitBy::Hour) => Split::Hour,
    }
}

fn time(args: &ExportArgs) -> TimeStyle {
    match args.time {
        TimeText::Iso => TimeStyle::Iso,
        TimeText::Epoch => TimeStyle::Epoch,
    }
}

fn style(args: &ExportArgs) -> Style {
    let decimal_comma = args.decimal == Decimal::Comma;
    let separator = args.separator.and_then(|c| u8::try_from(c).ok());
    Style {
        separator: separator.unwrap_or(if decimal_comma { b';' } else { b',' }),
        decimal_comma,
        units: args.units,
        time: time(args),
    }
}
