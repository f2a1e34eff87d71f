//! Which entries `bustape cat` prints.

use std::ops::RangeInclusive;

use anyhow::{Result, bail};

use crate::capture::socketcan::CanSettings;
use crate::cli::CatArgs;
use crate::commands::UsageError;
use crate::frame::{Frame, Timestamp};
use crate::recording::reader::{Entry, Recording};
use crate::text::parse_moment;

/// What the options select.
pub struct Selection {
    start: Timestamp,
    end: Timestamp,
    topics: Vec<String>,
    buses: Option<Vec<String>>,
    /// For each bus: its filters, or `None` if it is not wanted.
    filters: Vec<Option<CanSettings>>,
}

impl Selection {
    /// Reads the options.
    pub fn of(args: &CatArgs, recording: &Recording) -> Result<Self> {
        let origin = recording.span().map_or(Timestamp(0), |span| span.0);
        let moment = |text: &Option<String>, default| match text {
            Some(text) => parse_moment(text, origin).map_err(UsageError),
            None => Ok(default),
        };
        let start = moment(&args.start, Timestamp(0))?;
        let end = moment(&args.end, Timestamp(u64::MAX))?;
        if start > end {
            bail!(UsageError("--start is later than --end, so nothing is left".to_owned()));
        }
        let (buses, filters) = filters(args, recording)?;
        Ok(Self { start, end, topics: args.topics.clone(), buses, filters })
    }

    /// The range of time.
    pub fn range(&self) -> RangeInclusive<Timestamp> {
        self.start..=self.end
    }

    /// True for a topic that is printed: raw ones and gaps unless topics are named.
    pub fn wants(&self, topic: &str) -> bool {
        if !self.topics.is_empty() {
            return self.topics.iter().any(|pattern| matches(pattern, topic));
        }
        let bus = topic.strip_prefix('/').and_then(|t| t.rsplit_once('/'));
        let Some((bus, "raw" | "gaps")) = bus else { return false };
        self.buses.as_ref().is_none_or(|wanted| wanted.iter().any(|name| name == bus))
    }

    /// True for an entry that is printed.
    pub fn passes(&self, entry: &Entry) -> bool {
        match entry {
            Entry::Frame(bus, frame) => match (&self.filters[*bus], frame) {
                (None, _) => false,
                (Some(filters), Frame::Can(frame)) => filters.passes(frame),
                (Some(_), _) => true,
            },
            Entry::Message { .. } => true,
        }
    }
}

type Filters = (Option<Vec<String>>, Vec<Option<CanSettings>>);

fn filters(args: &CatArgs, recording: &Recording) -> Result<Filters> {
    if args.filters.is_empty() {
        return Ok((None, vec![Some(CanSettings::default()); recording.buses.len()]));
    }
    let mut names = Vec::new();
    // All of a bus together, as an address has them.
    let mut addresses: Vec<Option<String>> = vec![None; recording.buses.len()];
    for text in &args.filters {
        let name = text.split(',').next().unwrap_or_default();
        let Some(bus) = recording.buses.iter().position(|bus| bus == name) else {
            bail!(UsageError(format!(
                "--filter {text}: the recording has no bus {name}, only {}",
                recording.buses.join(", ")
            )));
        };
        parse_filter(text)?;
        let address = addresses[bus].get_or_insert_with(|| name.to_owned());
        address.push_str(&text[name.len()..]);
        names.push(name.to_owned());
    }
    let filters = addresses.iter().map(|address| {
        let address = address.as_ref();
        address.map(|text| Ok(parse_filter(text)?.1)).transpose()
    });
    Ok((Some(names), filters.collect::<Result<_>>()?))
}

/// `BUS[,FILTER]...`: the bus, and candump's filters.
pub fn parse_filter(text: &str) -> Result<(String, CanSettings)> {
    let (name, rest) = text.split_once(',').unwrap_or((text, ""));
    // The grammar of an address, of which only the filters matter here.
    let address = if rest.is_empty() { "x".to_owned() } else { format!("x,{rest}") };
    let settings = address.parse().map_err(|e| UsageError(format!("--filter {text}: {e}")))?;
    Ok((name.to_owned(), settings))
}

/// True if `topic` is what `pattern` says, where `*` stands for any text.
pub fn matches(pattern: &str, topic: &str) -> bool {
    let Some((head, tail)) = pattern.split_once('*') else { return pattern == topic };
    let Some(rest) = topic.strip_prefix(head) else { return false };
    let mut ends = (0..=rest.len()).filter(|&at| rest.is_char_boundary(at));
    ends.any(|at| matches(tail, &rest[at..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_any_text() {
        assert!(matches("/can0/*", "/can0/raw"));
        assert!(matches("*/raw", "/can0/raw"));
        assert!(matches("/*/st*s", "/can0/stats"));
        assert!(!matches("/can0/raw", "/can0/raws"));
        assert!(!matches("/can1/*", "/can0/raw"));
    }
}
