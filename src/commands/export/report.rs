//! What an export says when it is done.

use serde_json::json;

use crate::cli::export::ExportArgs;
use crate::commands::output;
use crate::text::grouped;

/// What happened to the frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Frames, serial reads or decoded messages read.
    pub read: u64,
    /// Rows made of them.
    pub rows: u64,
    /// Frames that the protocol does not know.
    pub unknown: u64,
    /// Remote and error frames, serial bytes, frames of buses without a protocol.
    pub other: u64,
    /// Messages seen.
    pub tables: usize,
}

impl Counts {
    /// True when something that should be there is not.
    pub fn is_lossy(&self) -> bool {
        self.rows == 0
    }
}

/// Says the totals.
pub fn report(args: &ExportArgs, counts: &Counts, files: u64, notes: &[String]) {
    let Counts { read, rows, unknown, other, tables } = *counts;
    if args.json {
        let totals = json!({
            "read": read, "decoded": rows, "unknown": unknown, "not_decoded": other,  "messages": tables, "files": files,
        });
        if args.output.as_os_str() == "-" {
            output::note(&totals.to_string());
        } else {
            println!("{totals}");
        }
    } else {
        let mut text = format!(
            "{} frames read, {} taken; messages: {}, files: {}",
            grouped(read),
            grouped(rows),
            grouped(tables as u64),
            grouped(files),
        );
        if unknown > 0 {
            text = format!("{text}; {} frames of unknown messages", grouped(unknown));
        }
        if other > 0 {
            let what = "remote, error or serial, or of a bus without --decode";
            text = format!("{text}; {} not decoded ({what})", grouped(other));
        }
        output::note(&text);
    }
    for note in notes {
        output::note(note);
    }
    if rows == 0 {
        output::warning("nothing was exported: the input has none of the wanted messages");
    }
}
