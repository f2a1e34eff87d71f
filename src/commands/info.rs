//! `bustape info`: what is in a recording, told from its summary.

mod errors;

use std::collections::BTreeMap;
use std::io::Write as _;

use anyhow::Result;
use serde_json::{Value, json};

use super::books::{Books, WINDOW};
use super::{Ended, output};
use crate::cli::InfoArgs;
use crate::frame::{Frame, Gap, Timestamp};
use crate::recording::disk::holder;
use crate::recording::reader::{Entry, Recording};
use crate::recording::rewrite::RECOVERY;
use crate::recording::segment::{Ending, Segment};
use crate::text::{duration, grouped, printable_json, rfc3339, rfc3339_millis, size};
use errors::Errors;

/// Gaps shown before the rest is only counted.
const GAPS_SHOWN: usize = 10;

/// Runs the command.
pub fn run(args: &InfoArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    if args.json {
        output::result(&format!("{}\n", printable_json(&as_json(&recording).to_string())))?;
    } else {
        print(&recording)?;
    }
    Ok(Ended::Well)
}

/// Prints what a recording holds, for a person.
pub fn print(recording: &Recording) -> Result<()> {
    let mut out = output::stdout();
    print_files(&mut out, recording)?;
    print_buses(&mut out, recording)?;
    print_decoded(&mut out, recording)?;
    print_topics(&mut out, recording)?;
    print_windows(&mut out, recording)?;
    Errors::of(recording).print(&mut out)?;
    print_gaps(&mut out, recording)?;
    print_attachments(&mut out, recording)?;
    out.flush()?;
    for segment in recording.unfinished() {
        output::warning(&unfinished(segment));
    }
    Ok(())
}

fn print_files(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let total: u64 = recording.segments.iter().map(|s| s.size).sum();
    let rows = recording.segments.iter().map(|segment| {
        let (start, end) = span(segment);
        let ended = match &segment.ending {
            Ending::Finished => match segment.fact("bustape.summary", "reason") {
                Some(reason) => reason,
                None if segment.metadata.contains_key(RECOVERY) => "cut off, recovered",
                None => "finished",
            },
            Ending::Cut { .. } => "NOT FINISHED",
        };
        let path = segment.path.display().to_string();
        vec![
            path,
            size(segment.size),
            start.map_or("-".to_owned(), rfc3339_millis),
            lasted(start, end),
            ended.to_owned(),
        ]
    });
    output::heading(
        out,
        &format!("Recording: {} in {} file(s)", size(total), recording.segments.len()),
    )?;
    let head = ["file", "size", "first", "lasts", "ended by"];
    write!(out, "{}", output::table(&head, &[1, 3], rows.collect()))?;
    let facts = recording.segments.first().and_then(|s| s.metadata.get("bustape.recording"));
    if let Some(facts) = facts {
        let about = ["recorder", "layout", "host", "kernel", "session_id"];
        let text: Vec<String> = about
            .into_iter()
            .filter_map(|key| Some(format!("{key} {}", facts.get(key)?)))
            .collect();
        writeln!(out, "  {}", crate::text::printable(&text.join(", ")))?;
    }
    Ok(())
}

fn print_buses(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let buses: Vec<Bus> = recording.buses.iter().map(|bus| Bus::of(recording, bus)).collect();
    let rows: Vec<Vec<String>> = buses.iter().map(Bus::row).collect();
    if rows.is_empty() {
        return Ok(());
    }
    output::heading(out, "Buses")?;
    let head = ["bus", "address", "kind", "bit/s", "received", "written", "dropped", "unit"];
    write!(out, "{}", output::table(&head, &[3, 4, 5, 6], rows))?;
    if buses.iter().any(|bus| !bus.books.complete && !bus.books.totals.is_empty()) {
        writeln!(out, "  + and what is in files that were not finished, which have no books")?;
    }
    Ok(())
}

/// What buses were decoded with, and what came of it.
fn print_decoded(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let buses: Vec<Bus> = recording.buses.iter().map(|bus| Bus::of(recording, bus)).collect();
    let rows: Vec<Vec<String>> = buses.iter().filter_map(Bus::decoded).collect();
    if rows.is_empty() {
        return Ok(());
    }
    output::heading(out, "Decoded")?;
    let head = ["bus", "protocol", "messages", "unknown", "invalid"];
    write!(out, "{}", output::table(&head, &[2, 3, 4], rows))?;
    for bus in &buses {
        if let Some(why) = bus.books.totals.get("decode_error") {
            output::warning(why);
        }
    }
    Ok(())
}

/// A bus, from all segments.
struct Bus {
    name: String,
    facts: BTreeMap<String, String>,
    books: Books,
}

impl Bus {
    fn of(recording: &Recording, name: &str) -> Self {
        let record = format!("bustape.bus.{name}");
        let facts = recording.segments.iter().find_map(|s| s.metadata.get(&record));
        let facts = facts.cloned().unwrap_or_default();
        Self { name: name.to_owned(), facts, books: Books::of(recording, name) }
    }

    /// A count of the books, with a mark where a file that was not finished adds to it; such a
    /// file alone has none.
    fn number(&self, key: &str) -> String {
        let count = self.books.totals.get(key).and_then(|text| text.parse().ok());
        let mark = if self.books.complete { "" } else { "+" };
        count.map_or("?".to_owned(), |count| grouped(count) + mark)
    }

    fn decoded(&self) -> Option<Vec<String>> {
        let protocol = self.facts.get("protocol")?.clone();
        let counts = ["decoded", "unknown", "invalid"].map(|key| self.number(key));
        Some([self.name.clone(), protocol].into_iter().chain(counts).collect())
    }

    fn row(&self) -> Vec<String> {
        let fact = |key: &str| self.facts.get(key).cloned().unwrap_or_else(|| "-".to_owned());
        let number = |key: &str| self.number(key);
        let mut bitrate = fact("bitrate");
        if let Some(data) = self.facts.get("data_bitrate") {
            bitrate = format!("{bitrate}/{data}");
        }
        let unit = self.books.totals.get("unit").cloned().unwrap_or_default();
        vec![
            self.name.clone(),
            fact("address"),
            fact("kind"),
            bitrate,
            number("received"),
            number("written"),
            number("dropped"),
            unit,
        ]
    }
}

/// What windows around triggers are about.
fn print_windows(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let rows = recording.segments.iter().filter_map(|segment| {
        let fact = |key: &str| segment.fact(WINDOW, key).map(str::to_owned);
        let of_summary = |key: &str| segment.fact("bustape.summary", key).map(str::to_owned);
        let time = |text: String| Some(rfc3339_millis(Timestamp(text.parse().ok()?)));
        let end = of_summary("window_to_ns").and_then(time).unwrap_or_else(|| "?".to_owned());
        Some(vec![
            fact("trigger")?,
            fact("fired_ns").and_then(time)?,
            of_summary("window_firings").unwrap_or_else(|| "?".to_owned()),
            of_summary("window_from_ns").or(fact("from_ns")).and_then(time)?,
            end,
        ])
    });
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        return Ok(());
    }
    output::heading(out, "Windows around triggers")?;
    let head = ["trigger", "first fired", "firings", "from", "to"];
    write!(out, "{}", output::table(&head, &[2], rows))?;
    Ok(())
}

fn print_topics(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    output::heading(out, "Topics")?;
    let seconds = recording.span().map_or(0.0, |(start, end)| seconds(end.since(start)));
    let rows = topics(recording).into_iter().map(|(topic, (schema, count))| {
        #[allow(clippy::cast_precision_loss, reason = "a rate for people")]
        let rate =
            if seconds > 0.0 { format!("{:.1}", count as f64 / seconds) } else { "-".into() };
        vec![topic, schema, grouped(count), rate]
    });
    let head = ["topic", "schema", "messages", "per second"];
    write!(out, "{}", output::table(&head, &[2, 3], rows.collect()))?;
    Ok(())
}

/// Each topic with its schema and number of messages, over all segments.
fn topics(recording: &Recording) -> BTreeMap<String, (String, u64)> {
    let mut topics = BTreeMap::new();
    for segment in &recording.segments {
        for channel in segment.channels.values() {
            let schema = segment.schemas.get(&channel.schema).map(|s| s.name.clone());
            let (_, count) = topics
                .entry(channel.topic.clone())
                .or_insert((schema.unwrap_or_else(|| "-".to_owned()), 0));
            *count += segment.statistics.channels.get(&channel.id).copied().unwrap_or(0);
        }
    }
    topics
}

fn print_gaps(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let gaps = gaps(recording);
    if gaps.is_empty() {
        writeln!(out, "No gaps.")?;
        return Ok(());
    }
    output::heading(out, &format!("Gaps: {}", gaps.len()))?;
    let rows = gaps.iter().take(GAPS_SHOWN).map(|(bus, gap)| {
        let count = if gap.count == 0 { "unknown".to_owned() } else { grouped(gap.count) };
        let lasted = duration(gap.to.since(gap.from));
        let reason = gap.reason.name().to_owned();
        vec![
            bus.clone(),
            rfc3339_millis(gap.from),
            lasted,
            count,
            gap.unit.name().to_owned(),
            reason,
        ]
    });
    let head = ["bus", "from", "lasts", "lost", "unit", "reason"];
    write!(out, "{}", output::table(&head, &[2, 3], rows.collect()))?;
    if gaps.len() > GAPS_SHOWN {
        writeln!(out, "  ... and {} more", gaps.len() - GAPS_SHOWN)?;
    }
    Ok(())
}

/// The gaps of all buses. Only chunks that hold one are read.
fn gaps(recording: &Recording) -> Vec<(String, Gap)> {
    let entries = recording.entries(Recording::ALL, |topic| topic.ends_with("/gaps"));
    let gaps = entries.filter_map(|entry| match entry.value {
        Entry::Frame(bus, Frame::Gap(gap)) => Some((recording.buses[bus].clone(), gap)),
        _ => None,
    });
    gaps.collect()
}

fn print_attachments(out: &mut impl std::io::Write, recording: &Recording) -> Result<()> {
    let mut rows = Vec::new();
    for attachment in recording.segments.iter().flat_map(|s| &s.attachments) {
        let row =
            vec![attachment.name.clone(), attachment.media_type.clone(), size(attachment.size)];
        if !rows.contains(&row) {
            rows.push(row);
        }
    }
    if !rows.is_empty() {
        output::heading(out, "Attachments")?;
        write!(out, "{}", output::table(&["name", "type", "size"], &[2], rows))?;
    }
    Ok(())
}

/// The sentence for a file that was not finished.
pub fn unfinished(segment: &Segment) -> String {
    let Ending::Cut { at, of } = segment.ending else { return String::new() };
    let name = segment.path.display();
    if segment.is_growing {
        let by = holder(&segment.path).map_or(String::new(), |pid| format!(" (process {pid})"));
        return format!(
            "{name} is not finished: its recorder{by} is still running. It can be read up to byte {at}"
        );
    }
    let rest = if at < of {
        format!(", {} bytes behind that cannot be read", of - at)
    } else {
        String::new()
    };
    format!(
        "{name} was not finished: its recorder was killed, or the power went. It can be read up \
         to byte {at} of {of}{rest}. Make a finished file of it with \"bustape convert {name} -o \
         NEW.mcap\""
    )
}

/// True when an unfinished file ends with bytes that cannot be read.
pub fn is_damaged(segment: &Segment) -> bool {
    !segment.is_growing && matches!(segment.ending, Ending::Cut { at, of } if at < of)
}

fn span(segment: &Segment) -> (Option<Timestamp>, Option<Timestamp>) {
    let (start, end) = segment.statistics.span;
    let time = |nanos| (nanos != 0).then_some(Timestamp(nanos));
    (time(start), time(end))
}

fn lasted(start: Option<Timestamp>, end: Option<Timestamp>) -> String {
    match (start, end) {
        (Some(start), Some(end)) => duration(end.since(start)),
        _ => "-".to_owned(),
    }
}

#[allow(clippy::cast_precision_loss, reason = "for people")]
fn seconds(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}

fn as_json(recording: &Recording) -> Value {
    let segments = recording.segments.iter().map(|segment| {
        let (start, end) = span(segment);
        let (finished, readable) = match segment.ending {
            Ending::Finished => (true, segment.size),
            Ending::Cut { at, .. } => (false, at),
        };
        json!({
            "file": segment.path.display().to_string(),
            "bytes": segment.size,
            "finished": finished,
            "readable_bytes": readable,
            "start": start.map(rfc3339),
            "end": end.map(rfc3339),
            "messages": segment.statistics.messages,
            "metadata": segment.metadata,
        })
    });
    let buses = recording.buses.iter().map(|name| {
        let bus = Bus::of(recording, name);
        json!({
            "name": name,
            "facts": bus.facts,
            "totals": bus.books.totals,
            "complete": bus.books.complete,
        })
    });
    let topics = topics(recording).into_iter().map(|(topic, (schema, messages))| {
        json!({ "topic": topic, "schema": schema, "messages": messages })
    });
    let gaps = gaps(recording).into_iter().map(|(bus, gap)| {
        json!({
            "bus": bus,
            "count": gap.count,
            "unit": gap.unit.name(),
            "reason": gap.reason.name(),
            "from": rfc3339(gap.from),
            "to": rfc3339(gap.to),
        })
    });
    let attachments = recording.segments.iter().flat_map(|s| &s.attachments).map(|attachment| {
        json!({
            "name": attachment.name,
            "media_type": attachment.media_type,
            "bytes": attachment.size,
        })
    });
    json!({
        "segments": segments.collect::<Vec<_>>(),
        "buses": buses.collect::<Vec<_>>(),
        "topics": topics.collect::<Vec<_>>(),
        "errors": Errors::of(recording).json(),
        "gaps": gaps.collect::<Vec<_>>(),
        "attachments": attachments.collect::<Vec<_>>(),
        "start": recording.span().map(|s| rfc3339(s.0)),
        "end": recording.span().map(|s| rfc3339(s.1)),
    })
}
