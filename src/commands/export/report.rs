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
    /// Decoded messages that do not fit their schema.
    pub broken: u64,
    /// Messages seen.
    pub tables: usize,
}

impl Counts {
    /// True when something that should be there is not.
    pub fn is_lossy(&self) -> bool {
        self.rows == 0 || self.broken > 0
    }
}

/// Says the totals.
pub fn report(args: &ExportArgs, counts: &Counts, files: u64, notes: &[String]) {
    let Counts { read, rows, unknown, other, broken, tables } = *counts;
    if args.json {
        let totals = json!({
            "read": read, "decoded": rows, "unknown": unknown, "not_decoded": other,
            "broken": broken, "messages": tables, "files": files,
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
            text.push_str(&format!("; {} frames of unknown messages", grouped(unknown)));
        }
        if other > 0 {
            let what = "remote, error or serial, or of a bus without --decode";
            text.push_str(&format!("; {} not decoded ({what})", grouped(other)));
        }
        output::note(&text);
    }
    for note in notes {
        output::note(note);
    }
    if broken > 0 {
        let broken = grouped(broken);
        output::warning(&format!("{broken} decoded messages do not fit their schema"));
    }
    if rows == 0 {
        output::warning("nothing was exported: the input has none of the wanted messages");
    }
}
