//! CAN frames, decoded and printed.

use std::collections::HashMap;
use std::io::{BufWriter, StdoutLock, Write as _};
use std::sync::Arc;

use anyhow::Result;

use super::super::output;
use super::{assembly, json, plain};
use crate::decode::bus::{CanBus, CanItem};
use crate::decode::can::{Match, Reading};
use crate::decode::definition::{CanDefinition, RemoteMessage};
use crate::frame::CanFlags;
use crate::import::candump::line::{self, Line};

/// Frames of so many buses are put together; no log has as many.
const MOST_BUSES: usize = 256;

/// A frame and what it means.
pub struct Explained<'a> {
    /// The line it came from.
    pub line: &'a Line<'a>,
    /// Its message, if it is known.
    pub found: Option<&'a Match<'a>>,
    /// The message of a remote frame, if it is known.
    pub remote: Option<&'a RemoteMessage>,
    /// Which way it went, if anything says so.
    pub direction: Option<String>,
    /// By index of the signal.
    pub readings: &'a [Option<Reading>],
}

/// The frames of one bus.
struct Bus {
    bus: CanBus,
    /// Its lines say when.
    timed: bool,
}

/// Prints what frames mean.
pub struct Explainer {
    definition: Arc<CanDefinition>,
    json: bool,
    /// By name; lines without a name are of one bus.
    buses: HashMap<Option<String>, Bus>,
    /// By index of the signal; used again for each frame.
    found: Vec<Option<Reading>>,
    skipped: usize,
    /// Where the results go.
    pub out: BufWriter<StdoutLock<'static>>,
}

impl Explainer {
    /// Decodes with `definition`.
    pub fn new(definition: CanDefinition, json: bool) -> Self {
        Self {
            definition: Arc::new(definition),
            json,
            buses: HashMap::new(),
            found: Vec::new(),
            skipped: 0,
            out: output::stdout(),
        }
    }

    /// Explains one line of candump's; the inner error says why it is none.
    pub fn line(&mut self, text: &str) -> Result<Result<(), String>> {
        let line = match line::line(text.as_bytes()) {
            Ok(line) => line,
            Err(why) => return Ok(Err(why)),
        };
        let name = line.bus.map(str::to_owned);
        if self.buses.len() >= MOST_BUSES && !self.buses.contains_key(&name) {
            self.give_up()?;
        }
        let new = || Bus { bus: CanBus::new(self.definition.clone()), timed: false };
        let bus = self.buses.entry(name).or_insert_with(new);
        bus.timed = line.time.is_some();
        let (definition, readings, json) = (&self.definition, &mut self.found, self.json);
        let mut text = String::new();
        bus.bus.feed(
            line.time.map(line::Time::stamp).unwrap_or_default(),
            &line.frame,
            &mut |item| {
                text.push_str(&explain(&item, &line, definition, readings, json));
            },
        );
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
        self.give_up()?;
        self.out.flush()?;
        if self.skipped > super::SAID {
            output::warning(&format!("{} lines were no frames", self.skipped));
        }
        Ok(self.skipped > 0)
    }

    /// Shows what waited for more frames, by names of the buses, and forgets them.
    fn give_up(&mut self) -> Result<()> {
        let mut buses: Vec<_> = self.buses.drain().collect();
        buses.sort_unstable_by(|(a, _), (b, _)| a.cmp(b));
        for (name, Bus { mut bus, timed }) in buses {
            let (mut text, json) = (String::new(), self.json);
            bus.finish(&mut |item| {
                if let CanItem::Assembly(assembled) = item {
                    let time = timed.then_some(assembled.ended);
                    text.push_str(&assembly::text(&assembled, time, name.as_deref(), json));
                }
            });
            self.out.write_all(text.as_bytes())?;
        }
        Ok(())
    }
}

fn explain(
    item: &CanItem<'_>,
    line: &Line<'_>,
    definition: &CanDefinition,
    readings: &mut Vec<Option<Reading>>,
    json: bool,
) -> String {
    readings.clear();
    let (mut found, mut remote) = (None, None);
    match item {
        CanItem::Assembly(assembled) => {
            let time = line.time.is_some().then_some(assembled.ended);
            return assembly::text(assembled, time, line.bus, json);
        }
        CanItem::Message(message) => {
            readings.resize(message.message.signals.len(), None);
            message.decode(&line.frame, |reading| readings[reading.signal] = Some(reading));
            found = Some(message);
        }
        CanItem::Remote(message) => remote = Some(*message),
        CanItem::Unknown => {}
    }
    let said = || if line.frame.flags.has(CanFlags::TX) { "tx" } else { "rx" };
    let direction = found
        .and_then(|found| definition.direction(found.message))
        .or_else(|| remote.and_then(|remote| remote.direction.clone()))
        .or_else(|| line.has_direction.then(|| said().to_owned()));
    let frame = Explained { line, found, remote, direction, readings };
    if json { json::text(&frame) } else { plain::text(&frame) }
}
