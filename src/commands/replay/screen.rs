//! What a person sees while a recording is played.

use std::io::{IsTerminal as _, Write as _};

use super::plan::Plan;
use crate::commands::{cat, output};
use crate::frame::{Gap, Timestamp};
use crate::recording::reader::Recording;
use crate::replay::stage::{Audience, Position};
use crate::text::{duration, grouped};

/// So many gaps are said; the others are counted.
const SAID: u64 = 10;

/// Stderr: sentences, and on a terminal a line that is written over and over.
pub struct Screen {
    buses: Vec<String>,
    start: Timestamp,
    length: u64,
    on_terminal: bool,
    shown: bool,
    gaps: u64,
}

impl Screen {
    /// A screen for this replay; with `status` also the line.
    pub fn new(plan: &Plan, recording: &Recording, status: bool) -> Self {
        let (start, end) = recording.span().unwrap_or_default();
        Self {
            buses: plan.feed.buses.iter().map(|bus| bus.name.clone()).collect(),
            start,
            length: end.since(start),
            on_terminal: status && std::io::stderr().is_terminal(),
            shown: false,
            gaps: 0,
        }
    }

    /// Makes room for other output.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.shown) && output::takes_text() {
            eprint!("\r\x1b[K");
        }
    }
}

impl Audience for Screen {
    fn say(&mut self, text: &str) {
        self.clear();
        output::note(text);
    }

    fn warn(&mut self, text: &str) {
        self.clear();
        output::warning(text);
    }

    fn gap(&mut self, bus: usize, gap: &Gap) {
        self.gaps += 1;
        if self.gaps > SAID {
            return;
        }
        let bus = self.buses.get(bus).map_or("", String::as_str);
        let text = cat::gap_text(&crate::text::printable(bus), gap);
        self.warn(&format!("the recording has a {text}"));
        if self.gaps == SAID {
            output::note("further gaps are counted, but not said one by one");
        }
    }

    fn show(&mut self, position: &Position) {
        // A stopped terminal must not stop the replay with it.
        if !output::takes_text() {
            return;
        }
        let state = if position.paused { "paused" } else { "playing" };
        let lap =
            if position.lap > 0 { format!("  lap {}", position.lap + 1) } else { String::new() };
        let late = match position.late {
            Some(nanos) => format!("  late {} us at most", grouped(nanos / 1000)),
            None => String::new(),
        };
        let line = format!(
            "{state} {} of {}  rate {}{lap}  {} sent{late}",
            duration(position.time.since(self.start)),
            duration(self.length),
            position.rate,
            grouped(position.sent),
        );
        let width = terminal_size::terminal_size().map_or(80, |(width, _)| usize::from(width.0));
        let line: String = line.chars().take(width.saturating_sub(1)).collect();
        eprint!("\r\x1b[K{line}");
        std::io::stderr().flush().ok();
        self.shown = true;
    }

    fn watches(&self) -> bool {
        self.on_terminal
    }
}
