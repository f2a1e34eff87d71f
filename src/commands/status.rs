//! The status line of a recording, on a terminal only.

use std::io::{IsTerminal as _, Write as _};

use crate::frame::Timestamp;
use crate::queue::Totals;
use crate::record::State;
use crate::text::{duration, grouped, size};

/// One line on stderr that is written over and over.
pub struct StatusLine {
    shown: bool,
    on_terminal: bool,
    before: Option<(Timestamp, u64)>,
}

impl StatusLine {
    /// Silent unless stderr is a terminal.
    pub fn new() -> Self {
        Self { shown: false, on_terminal: std::io::stderr().is_terminal(), before: None }
    }

    /// Shows the state of things.
    pub fn show(&mut self, started: Timestamp, now: Timestamp, totals: &[Totals], state: &State) {
        if !self.on_terminal {
            return;
        }
        let received: u64 = totals.iter().map(|t| t.received).sum();
        let lost: u64 = totals.iter().map(Totals::lost).sum();
        let rate = self.rate(now, received);
        let synced = match state.synced {
            Some(time) => format!("{} ago", duration(now.since(time))),
            None => "not yet".to_owned(),
        };
        let file = state.file.file_name().map(|n| n.to_string_lossy().into_owned());
        let line = format!(
            "{}  {}/s  {} received, {} dropped  {}  {} synced {synced}",
            duration(now.since(started)),
            grouped(rate),
            grouped(received),
            grouped(lost),
            size(state.earlier_bytes + state.file_bytes),
            crate::text::printable(&file.unwrap_or_default()),
        );
        let width = terminal_width();
        let line: String = line.chars().take(width.saturating_sub(1)).collect();
        eprint!("\r\x1b[K{line}");
        std::io::stderr().flush().ok();
        self.shown = true;
    }

    /// Makes room for other output.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.shown) {
            eprint!("\r\x1b[K");
        }
    }

    fn rate(&mut self, now: Timestamp, received: u64) -> u64 {
        let rate = self.before.map_or(0, |(then, before)| {
            let nanos = u128::from(now.since(then)).max(1);
            let count = u128::from(received - before);
            u64::try_from(count * 1_000_000_000 / nanos).unwrap_or(u64::MAX)
        });
        self.before = Some((now, received));
        rate
    }
}

fn terminal_width() -> usize {
    terminal_size::terminal_size().map_or(80, |(width, _)| usize::from(width.0))
}
