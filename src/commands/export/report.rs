//! What an export says when it is done.

use anyhow::Result;
use serde_json::{Value, json};

use crate::cli::export::{ExportArgs, Shape};
use crate::commands::output;
use crate::text::{grouped, printable_json};

/// What happened to what was read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// CAN frames read.
    pub frames: u64,
    /// Reads of serial lines.
    pub reads: u64,
    /// Messages of decoded channels read.
    pub messages: u64,
    /// Messages that are in the output.
    pub rows: u64,
    /// Frames that the protocol does not know.
    pub unknown: u64,
    /// What was on a serial line and is no good frame.
    pub invalid: u64,
    /// Remote and error frames, and all of buses without a protocol of their kind.
    pub other: u64,
    /// Kinds of messages seen.
    pub tables: usize,
    /// A decoder has ended early.
    pub stopped: bool,
}

impl Counts {
    /// True when something that should be there is not.
    pub fn is_lossy(&self) -> bool {
        self.rows == 0 || self.stopped
    }

    /// The totals in a sentence.
    fn sentence(&self, files: u64) -> String {
        let read = [
            (self.frames, "CAN frames"),
            (self.reads, "reads of serial lines"),
            (self.messages, "decoded messages"),
        ];
        let said = |(count, what): &(u64, &str)| format!("{} {what}", grouped(*count));
        let mut parts: Vec<_> = read.iter().filter(|(count, _)| *count > 0).map(said).collect();
        if parts.is_empty() {
            parts.push("nothing".to_owned());
        }
        let mut text = format!(
            "read {}; {} taken; messages: {}, files: {}",
            parts.join(", "),
            grouped(self.rows),
            grouped(self.tables as u64),
            grouped(files),
        );
        let lost = [
            (self.unknown, "frames of unknown messages"),
            (self.invalid, "serial frames invalid"),
            (self.other, "not decoded (remote, error, or of a bus without --decode of its kind)"),
        ];
        for part in lost.iter().filter(|(count, _)| *count > 0).map(said) {
            text = format!("{text}; {part}");
        }
        text
    }
}

/// Says the totals.
pub fn report(args: &ExportArgs, counts: &Counts, files: u64, notes: &[String]) -> Result<()> {
    if args.json {
        let totals = json!({
            "read": counts.frames + counts.reads + counts.messages,
            "decoded": counts.rows,
            "unknown": counts.unknown,
            "invalid": counts.invalid,
            "not_decoded": counts.other,
            "messages": counts.tables,
            "files": files,
        });
        print_totals(args, &totals)?;
    } else {
        output::note(&counts.sentence(files));
    }
    for note in notes {
        output::note(note);
    }
    if counts.rows == 0 {
        output::warning(&format!("nothing was exported: {}", why_nothing(args, counts)));
    }
    Ok(())
}

/// Prints totals on stdout, or on stderr where stdout is the output.
pub fn print_totals(args: &ExportArgs, totals: &Value) -> Result<()> {
    let text = printable_json(&totals.to_string());
    if args.output.as_os_str() == "-" {
        output::note(&text);
        return Ok(());
    }
    Ok(output::result(&format!("{text}\n"))?)
}

/// The options that select something, with commas.
pub fn selected(args: &ExportArgs) -> String {
    let selected = [
        ("--bus", !args.buses.is_empty()),
        ("--filter", !args.filters.is_empty()),
        ("--message", !args.messages.is_empty()),
        ("--signal", !args.signals.is_empty()),
        ("--start", args.start.is_some()),
        ("--end", args.end.is_some()),
    ];
    let selected: Vec<&str> =
        selected.iter().filter(|(_, given)| *given).map(|(name, _)| *name).collect();
    selected.join(", ")
}

/// What kept everything out of the output, and what to do.
fn why_nothing(args: &ExportArgs, counts: &Counts) -> String {
    let read = counts.frames + counts.reads + counts.messages;
    let selected = selected(args);
    if read > 0 && read == counts.other {
        return "no bus has a protocol of its kind; CAN frames need a .dbc file or rules for CAN, \
                bytes of serial lines a serial protocol (\"bustape protocols list\")"
            .to_owned();
    }
    if read > 0 && read == counts.unknown + counts.other {
        return "the protocol knows none of the frames; is it the one of this bus?".to_owned();
    }
    if !selected.is_empty() {
        return format!("nothing of the input is selected by {selected}");
    }
    if args.decode.is_empty() && args.shape != Shape::Frames {
        return "the recording has no decoded channels; give --decode BUS=PROTOCOL to decode on the \
                way"
            .to_owned();
    }
    "the input has no messages".to_owned()
}
