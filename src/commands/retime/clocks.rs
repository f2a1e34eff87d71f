//! What the recorded clocks tell: for each boot the stretches between steps of the wall clock.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use prost::Message as _;
use serde_json::{Value, json};

use super::time;
use crate::recording::reader::{Entry, Recording};
use crate::recording::schema::bustape::ClockSync;
use crate::recording::segment::Segment;
use crate::text::{printable, signed_duration};

/// A wall clock before this moment (2020-01-01) has not been set yet.
const CLOCK_WORKED: i128 = 1_577_836_800_000_000_000;
/// Less than this between two readings is not a step: `clock.rs` has the same.
const STEP_NANOS: i128 = 500_000;

/// A run of the machine: its steady clock began with it, so all its recordings share one.
pub struct Boot {
    /// Its id, or what stands for one in files that have none.
    id: String,
    /// Between steps of the wall clock.
    stretches: Vec<Stretch>,
    /// Its segments.
    pub segments: Vec<Known>,
}

/// What a segment tells of its clocks.
pub struct Known {
    /// Its number in the recording.
    pub index: usize,
    /// Its timeline minus the steady clock.
    base: Option<i128>,
    /// The last reading: the steady clock, and the wall clock minus that.
    last: Option<(i128, i128)>,
}

/// Time in which nobody set the wall clock; on the steady clock.
struct Stretch {
    from: i128,
    to: i128,
    /// Wall clock minus steady clock.
    offset: i128,
}

/// The boots of a recording.
pub fn boots(recording: &Recording) -> Vec<Boot> {
    let mut readings: Vec<Vec<[i128; 3]>> = recording.segments.iter().map(head_reading).collect();
    let mut entries = recording.entries(Recording::ALL, |topic| topic == "/bustape/clock");
    for entry in entries.by_ref() {
        let Entry::Message { segment, data, .. } = entry.value else { continue };
        let Ok(sync) = ClockSync::decode(&data[..]) else { continue };
        let time = i128::from(entry.time.nanos());
        readings[segment].push([time, i128::from(sync.steady_ns), i128::from(sync.wall_ns)]);
    }
    let mut boots = BTreeMap::<String, Boot>::new();
    for (index, segment) in recording.segments.iter().enumerate() {
        let fact = |key| segment.fact("bustape.recording", key).map(str::to_owned);
        let own = || segment.path.display().to_string();
        let id = fact("boot_id").or_else(|| fact("session_id")).unwrap_or_else(own);
        let boot = boots.entry(id.clone()).or_insert_with(|| Boot {
            id,
            stretches: Vec::new(),
            segments: Vec::new(),
        });
        let base = readings[index].iter().map(|[time, steady, _]| time - steady).next();
        let last = readings[index].iter().map(|[_, s, wall]| (*s, wall - s)).max();
        boot.segments.push(Known { index, base, last });
    }
    for boot in boots.values_mut() {
        let of_boot = boot.segments.iter().flat_map(|known| &readings[known.index]);
        let mut clocks: Vec<(i128, i128)> = of_boot.map(|[_, s, wall]| (*s, wall - s)).collect();
        clocks.sort_unstable();
        boot.stretches = stretches(&clocks);
    }
    boots.into_values().collect()
}

/// The clocks as they stood when the segment was begun: time in the file, steady, wall.
fn head_reading(segment: &Segment) -> Vec<[i128; 3]> {
    let fact = |key| segment.fact("bustape.clock", key)?.parse().ok();
    let reading = || Some([fact("log_time_ns")?, fact("steady_ns")?, fact("wall_ns")?]);
    reading().into_iter().collect()
}

fn stretches(clocks: &[(i128, i128)]) -> Vec<Stretch> {
    let mut stretches: Vec<Stretch> = Vec::new();
    for &(steady, offset) in clocks {
        match stretches.last_mut() {
            Some(last) if (offset - last.offset).abs() <= STEP_NANOS => {
                (last.to, last.offset) = (steady, offset);
            }
            _ => stretches.push(Stretch { from: steady, to: steady, offset }),
        }
    }
    stretches
}

impl Boot {
    /// By how much the times of `file` are to be moved, nanoseconds: to what the wall clock said at
    /// the end of the boot, or at the end of the file. Where it had not been set by then, what it
    /// said next counts.
    pub fn shift(&self, known: &Known, per_file: bool, file: &Path) -> Result<i64> {
        let was_set = |steady: i128, offset: i128| steady + offset >= CLOCK_WORKED;
        let own = known.last.filter(|(steady, offset)| per_file && was_set(*steady, *offset));
        if let (Some((_, offset)), Some(base)) = (own, known.base) {
            return Ok(i64::try_from(offset - base)?);
        }
        let later = |stretch: &&Stretch| {
            let behind = known.last.is_none_or(|(steady, _)| stretch.from >= steady);
            behind && was_set(stretch.to, stretch.offset)
        };
        let next = self.stretches.iter().find(later).filter(|_| per_file);
        let (Some(last), Some(base)) = (next.or(self.stretches.last()), known.base) else {
            bail!(
                "{} does not tell what the clocks said; give the offset with --offset",
                file.display()
            );
        };
        if last.to + last.offset < CLOCK_WORKED {
            bail!(
                "the wall clock of {} was never set: at its end it said {}; add a later recording of \
                 the same boot, or give the offset with --offset",
                file.display(),
                time(last.to + last.offset)
            );
        }
        Ok(i64::try_from(last.offset - base)?)
    }

    /// The wall clock of a stretch against the last one, nanoseconds.
    fn off(&self, stretch: &Stretch) -> i64 {
        let truth = self.stretches.last().map_or(0, |last| last.offset);
        i64::try_from(stretch.offset - truth).unwrap_or(i64::MIN)
    }

    /// For a program.
    pub fn json(&self) -> Value {
        let truth = self.stretches.last().map_or(0, |last| last.offset);
        let stretches = self.stretches.iter().map(|stretch| {
            json!({
                "from": time(stretch.from + truth),
                "to": time(stretch.to + truth),
                "wall_clock_off_ns": self.off(stretch),
            })
        });
        json!({ "boot": self.id, "stretches": stretches.collect::<Vec<_>>() })
    }

    /// For a person.
    pub fn print(&self, out: &mut impl std::io::Write) -> std::io::Result<()> {
        let truth = self.stretches.last().map_or(0, |last| last.offset);
        writeln!(out, "boot {}", printable(&self.id))?;
        for stretch in &self.stretches {
            let off = match self.off(stretch) {
                0 => "right".to_owned(),
                off => format!("off by {}", signed_duration(off)),
            };
            let (from, to) = (time(stretch.from + truth), time(stretch.to + truth));
            writeln!(out, "  {from} to {to}: wall clock {off}")?;
        }
        Ok(())
    }
}
