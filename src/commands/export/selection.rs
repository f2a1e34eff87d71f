//! What an export takes: buses, messages, signals, a range of time.

use std::ops::RangeInclusive;

use anyhow::{Result, bail};

use crate::cli::export::ExportArgs;
use crate::commands::UsageError;
use crate::commands::cat::select::matches;
use crate::frame::Timestamp;
use crate::text::parse_moment;

/// What the options select.
#[derive(Clone, Debug)]
pub struct Selection {
    buses: Vec<String>,
    messages: Vec<String>,
    signals: Vec<String>,
    start: Option<String>,
    end: Option<String>,
}

impl Selection {
    /// Reads the options.
    pub fn of(args: &ExportArgs) -> Result<Self> {
        let selection = Self {
            buses: args.buses.clone(),
            messages: args.messages.clone(),
            signals: args.signals.clone(),
            start: args.start.clone(),
            end: args.end.clone(),
        };
        // Wrong times are said before anything is read.
        selection.range(Timestamp(0))?;
        Ok(selection)
    }

    /// True for a bus that is wanted.
    pub fn bus(&self, name: &str) -> bool {
        any(&self.buses, name)
    }

    /// True for a message that is wanted.
    pub fn message(&self, name: &str) -> bool {
        any(&self.messages, name)
    }

    /// True for a signal that is wanted.
    pub fn signal(&self, name: &str) -> bool {
        any(&self.signals, name)
    }

    /// The range of time of something that begins at `origin`.
    pub fn range(&self, origin: Timestamp) -> Result<RangeInclusive<Timestamp>> {
        let moment = |text: &Option<String>, default| match text {
            Some(text) => parse_moment(text, origin).map_err(UsageError),
            None => Ok(default),
        };
        let start = moment(&self.start, Timestamp(0))?;
        let end = moment(&self.end, Timestamp(u64::MAX))?;
        let relative = |text: &Option<String>| text.as_ref().is_some_and(|t| t.starts_with('+'));
        let comparable = relative(&self.start) == relative(&self.end) || origin.nanos() > 0;
        if start > end && comparable {
            bail!(UsageError("--start is later than --end, so nothing is left".to_owned()));
        }
        Ok(start..=end)
    }
}

fn any(patterns: &[String], name: &str) -> bool {
    patterns.is_empty() || patterns.iter().any(|pattern| matches(pattern, name))
}
