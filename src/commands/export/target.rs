//! Where an export goes, and the writer of its format.

use std::path::Path;

use anyhow::{Result, bail};

use crate::cli::export::{ExportArgs, Format, Shape, SplitBy};
use crate::commands::UsageError;
use crate::export::TableWriter;
use crate::export::output::{Output, OutputFolder};
use crate::export::parquet::dataset::Dataset;
use crate::export::period::Split;

/// A new file, or a new folder.
pub enum Target {
    /// A folder.
    Folder(OutputFolder),
}

impl Target {
    /// Makes it, or says why not.
    pub fn create(args: &ExportArgs) -> Result<Self> {
        Ok(Self::Folder(OutputFolder::create(&args.output, args.force)?))
    }

    /// The writer that `args` ask for.
    pub fn writer(&self, args: &ExportArgs) -> Result<Box<dyn TableWriter>> {
        let split = match args.split {
            None => Split::Never,
            Some(SplitBy::Day) => Split::Day,
            Some(SplitBy::Hour) => Split::Hour,
        };
        match self {
            Self::Folder(folder) => {
                Ok(Box::new(Dataset::new(folder.part(), args.compression, split)))
            }
        }
    }

    /// Gives it its name.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Folder(folder) => folder.finish()?,
        }
        Ok(())
    }
}
