//! CAN frames, decoded and printed.

use std::io::{BufWriter, StdoutLock, Write as _};

use anyhow::Result;

use super::super::output;
use super::{json, plain};
use crate::decode::can::{CanDecoder, Match, Reading};
use crate::frame::CanFlags;
use crate::import::candump::line::{self, Line};

/// A frame and what it means.
pub struct Explained<'a> {
    /// The line it came from.
    pub line: Line<'a>,
    /// Its message, if it is known.
    pub found: Option<&'a Match<'a>>,
    /// Which way it went, if anything says so.
    pub direction: Option<String>,
    /// By index of the signal.
    pub readings: &'a [Option<Reading>],
}

/// Prints what frames mean.
pub struct Explainer {
    decoder: CanDecoder,
    json: bool,
    /// By index of the signal; used again for each frame.
    found: Vec<Option<Reading>>,
    skipped: usize,
    /// Where the results go.
    pub out: BufWriter<StdoutLock<'static>>,
}

impl Explainer {
    /// Decodes with `decoder`.
    pub fn new(decoder: CanDecoder, json: bool) -> Self {
        Self { decoder, json, found: Vec::new(), skipped: 0, out: output::stdout() }
    }

    /// Explains one line of candump's; the inner error says why it is none.
    pub fn line(&mut self, text: &str) -> Result<Result<(), String>> {
        let line = match line::line(text.as_bytes()) {
            Ok(line) => line,
            Err(why) => return Ok(Err(why)),
        };
        let found = self.decoder.find(&line.frame);
        self.found.clear();
        if let Some(found) = &found {
            self.found.resize(found.message.signals.len(), None);
            found.decode(&line.frame, |reading| self.found[reading.signal] = Some(reading));
        }
        let found = found.as_ref();
        let direction = direction(&self.decoder, &line, found);
        let frame = Explained { line, found, direction, readings: &self.found };
        let text = if self.json { json::text(&frame) } else { plain::text(&frame) };
        self.out.write_all(text.as_bytes())?;
        Ok(Ok(()))
    }

    /// Counts a line that is no frame; says so for the first ones.
    pub fn skip(&mut self, why: &str) {
        self.skipped += 1;
        if self.skipped <= super::SAID {
            output::warning(why);
        }
    }

    /// Writes what is left. True if lines were skipped.
    pub fn finish(mut self) -> Result<bool> {
        self.out.flush()?;
        if self.skipped > super::SAID {
            output::warning(&format!("{} lines were no frames", self.skipped));
        }
        Ok(self.skipped > 0)
    }
}

fn direction(decoder: &CanDecoder, line: &Line<'_>, found: Option<&Match<'_>>) -> Option<String> {
    let said = || if line.frame.flags.has(CanFlags::TX) { "tx" } else { "rx" };
    found
        .and_then(|found| found.message.direction(&decoder.database().nodes))
        .or_else(|| line.has_direction.then(|| said().to_owned()))
}

/// Lower case, as JSON and people get it.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        text.extend([byte >> 4, byte & 15].map(|d| char::from_digit(d.into(), 16).unwrap_or('?')));
        text
    })
}
