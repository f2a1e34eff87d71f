//! The status line of a recording, on a terminal only, and the sentences above it.

use std::collections::VecDeque;
use std::io::{IsTerminal as _, Write as _};

use crate::commands::output;
use crate::frame::{Level, Notice, Timestamp};
use crate::queue::Totals;
use crate::record::State;
use crate::text::{duration, grouped, size};

/// Most sentences that wait for the terminal. All are in the recording's log, too.
const WAITING: usize = 100;

/// One line on stderr that is written over and over. It is written by the thread that captures, so a
/// terminal that is stopped (Ctrl-S) must never be waited for while a recording goes on.
pub struct StatusLine {
    /// Sentences that the terminal has not taken yet.
    held: VecDeque<Notice>,
    shown: bool,
    on_terminal: bool,
    before: Option<(Timestamp, u64)>,
}

impl StatusLine {
    /// Silent unless stderr is a terminal.
    pub fn new() -> Self {
        let on_terminal = std::io::stderr().is_terminal();
        Self { held: VecDeque::new(), shown: false, on_terminal, before: None }
    }

    /// Shows the state of things.
    pub fn show(&mut self, started: Timestamp, now: Timestamp, totals: &[Totals], state: &State) {
        if !self.on_terminal || !output::takes_text() {
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
        let mut stderr = std::io::stderr();
        write!(stderr, "\r\x1b[K{line}").and_then(|()| stderr.flush()).ok();
        self.shown = true;
    }

    /// Makes room for other output.
    pub fn clear(&mut self) {
        if self.shown && output::takes_text() {
            self.shown = false;
            write!(std::io::stderr(), "\r\x1b[K").ok();
        }
    }

    /// Says sentences, now or as soon as the terminal takes text again.
    pub fn say(&mut self, notices: &[Notice]) {
        let room = WAITING.saturating_sub(self.held.len());
        self.held.extend(notices.iter().take(room).cloned());
        while !self.held.is_empty() && output::takes_text() {
            self.clear();
            self.say_next();
        }
    }

    fn say_next(&mut self) {
        let Some(notice) = self.held.pop_front() else { return };
        match notice.level {
            Level::Info => output::note(&notice.text),
            Level::Warning | Level::Error => output::warning(&notice.text),
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

impl Drop for StatusLine {
    /// The recording is over, and what was not said yet may wait for its reader.
    fn drop(&mut self) {
        while !self.held.is_empty() {
            self.say_next();
        }
    }
}

fn terminal_width() -> usize {
    terminal_size::terminal_size().map_or(80, |(width, _)| usize::from(width.0))
}
