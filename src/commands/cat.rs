//! `bustape cat`: the frames of a recording as text.

mod json;
pub(super) mod select;

use std::io::Write;

use anyhow::Result;

use super::{Ended, info, output};
use crate::cli::{CatArgs, TimeStyle};
use crate::frame::{Frame, Gap, Stamped, Timestamp};
use crate::recording::reader::{Entry, Recording};
use crate::text::{candump, hex, printable, printable_json, rfc3339_millis};
use select::Selection;

/// Runs the command.
pub fn run(args: &CatArgs) -> Result<Ended> {
    let recording = Recording::open(&args.files)?;
    let selection = Selection::of(args, &recording)?;
    let mut printer = Printer::new(args, &recording);
    let mut entries = recording.entries(selection.range(), |topic| selection.wants(topic));
    for entry in entries.by_ref() {
        if selection.passes(&entry.value) {
            printer.print(&entry)?;
        }
    }
    printer.out.flush()?;
    for segment in recording.unfinished() {
        output::warning(&info::unfinished(segment));
    }
    for damage in entries.damage() {
        output::warning(damage);
    }
    let skipped = !entries.damage().is_empty() || recording.unfinished().any(info::is_damaged);
    Ok(if skipped { Ended::WithLoss } else { Ended::Well })
}

struct Printer<'a> {
    args: &'a CatArgs,
    recording: &'a Recording,
    /// The names of its buses, fit for a terminal.
    buses: Vec<String>,
    messages: json::Messages<'a>,
    out: std::io::BufWriter<std::io::StdoutLock<'static>>,
    clock: TimeColumn,
    line: Vec<u8>,
}

impl<'a> Printer<'a> {
    fn new(args: &'a CatArgs, recording: &'a Recording) -> Self {
        Self {
            args,
            recording,
            buses: recording.buses.iter().map(|name| printable(name)).collect(),
            messages: json::Messages::new(recording),
            out: output::stdout(),
            clock: TimeColumn::new(args.time, args.nanoseconds),
            line: Vec::new(),
        }
    }

    fn print(&mut self, entry: &Stamped<Entry>) -> Result<()> {
        self.line.clear();
        if self.args.json {
            json::put(&mut self.line, self.recording, &self.messages, entry);
        } else {
            self.put_text(entry);
        }
        self.out.write_all(&self.line)?;
        Ok(())
    }

    fn put_text(&mut self, entry: &Stamped<Entry>) {
        let line = &mut self.line;
        let mut time = Vec::new();
        // What is printed without a time is not a line that the next delta counts from.
        if !matches!(entry.value, Entry::Frame(_, Frame::Gap(_) | Frame::Notice(_))) {
            self.clock.put(&mut time, entry.time);
        }
        match &entry.value {
            Entry::Frame(bus, Frame::Can(frame)) => {
                line.extend_from_slice(&time);
                line.extend_from_slice(self.buses[*bus].as_bytes());
                line.push(b' ');
                candump::put(line, frame);
                if self.args.direction {
                    candump::put_direction(line, frame);
                }
                line.push(b'\n');
            }
            Entry::Frame(bus, Frame::Serial(bytes)) => {
                hex::put(line, &time, &self.buses[*bus], bytes);
            }
            Entry::Frame(bus, Frame::Gap(gap)) => {
                line.extend_from_slice(b"# ");
                line.extend_from_slice(gap_text(&self.buses[*bus], gap).as_bytes());
                line.push(b'\n');
            }
            Entry::Frame(_, Frame::Notice(_)) => {}
            Entry::Message { segment, channel, data } => {
                let segment = &self.recording.segments[*segment];
                let topic = segment.channels.get(channel).map_or("?", |c| c.topic.as_str());
                line.extend_from_slice(&time);
                line.extend_from_slice(printable(topic).as_bytes());
                line.push(b' ');
                let value = self.messages.decode(segment, *channel, data);
                line.extend_from_slice(printable_json(&value.to_string()).as_bytes());
                line.push(b'\n');
            }
        }
    }
}

/// A gap, in words.
pub(super) fn gap_text(bus: &str, gap: &Gap) -> String {
    let count = match gap.count {
        0 => "an unknown number of".to_owned(),
        count => count.to_string(),
    };
    format!(
        "gap: {bus} lost {count} {} ({}) from {} to {}",
        gap.unit.name(),
        gap.reason.name(),
        rfc3339_millis(gap.from),
        rfc3339_millis(gap.to),
    )
}

/// The column of times, as candump's `-t` has it.
struct TimeColumn {
    style: TimeStyle,
    nanoseconds: bool,
    reference: Option<Timestamp>,
}

impl TimeColumn {
    fn new(style: TimeStyle, nanoseconds: bool) -> Self {
        Self { style, nanoseconds, reference: None }
    }

    fn put(&mut self, out: &mut Vec<u8>, time: Timestamp) {
        let reference = *self.reference.get_or_insert(time);
        let (seconds, nanos) = match self.style {
            TimeStyle::Absolute | TimeStyle::Date => split(time.nanos()),
            TimeStyle::Zero => split(time.since(reference)),
            TimeStyle::Delta => {
                self.reference = Some(time);
                split(time.since(reference))
            }
        };
        let fraction =
            if self.nanoseconds { format!("{nanos:09}") } else { format!("{:06}", nanos / 1000) };
        let text = match self.style {
            TimeStyle::Absolute => format!("({seconds:010}.{fraction}) "),
            TimeStyle::Zero | TimeStyle::Delta => format!("({seconds:03}.{fraction}) "),
            TimeStyle::Date => format!("({}.{fraction}) ", crate::text::date_and_time(time)),
        };
        out.extend_from_slice(text.as_bytes());
    }
}

fn split(nanos: u64) -> (u64, u64) {
    (nanos / 1_000_000_000, nanos % 1_000_000_000)
}
