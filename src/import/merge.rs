//! Several logs as one row of frames, in the order of their times as far as a bounded memory allows.

use std::collections::BTreeMap;

use super::{ImportError, LogFrame, LogReader, Skipped};
use crate::frame::{Frame, Timestamp};

/// A frame may stand so many frames of its log too late, and still comes out in its place: logs of
/// several interfaces are sorted but for a few frames. What stands later yet comes out where it
/// stands.
pub const WINDOW: usize = 16_384;
/// Of more logs than this, each has a part of the room that so many have.
const FULL_WINDOWS: usize = 4;
/// Bytes of serial lines that wait in a window. A read of a line may have megabytes, so counting
/// frames alone bounds nothing.
const WINDOW_BYTES: usize = 32 << 20;
/// Most frames given at once.
const BATCH: usize = 4096;
/// So many frames of a log are read before its turn comes: enough to know when that is.
const PEEK: usize = 1024;

/// A log among others.
pub struct Source {
    reader: Box<dyn LogReader>,
    /// What is added to times that count from the log's own zero.
    start: Timestamp,
    /// For each bus of the log: its index among all.
    buses: Vec<u16>,
    /// Frames read; those before `next` were given.
    frames: Vec<LogFrame>,
    next: usize,
    /// Frames before this one cannot be preceded by one that was not read yet.
    safe: usize,
    /// Its turn has come. Before, only its first frames are read: of logs that follow one another,
    /// only one needs room for many.
    begun: bool,
    ended: bool,
    read: u64,
}

/// Which bus a bus of a log becomes: number of the log, name there; the error is a sentence.
pub type Naming = Box<dyn Fn(usize, &str) -> Result<String, String>>;

/// Gives the frames of all logs.
pub struct Merge {
    sources: Vec<Source>,
    naming: Naming,
    names: Vec<String>,
    index: BTreeMap<String, u16>,
    last: Timestamp,
    disordered: u64,
    /// How late a frame may be, in frames of its log.
    window: usize,
    /// Bytes of a log that may wait.
    window_bytes: usize,
}

impl Merge {
    /// Merges logs; their buses are named by `naming`, and those of one name become one.
    pub fn new(readers: Vec<Box<dyn LogReader>>, start: Timestamp, naming: Naming) -> Self {
        let window = (FULL_WINDOWS * WINDOW / readers.len().max(1)).clamp(PEEK, WINDOW);
        let window_bytes = (FULL_WINDOWS * WINDOW_BYTES / readers.len().max(1)).min(WINDOW_BYTES);
        let source = |reader| Source {
            reader,
            start,
            buses: Vec::new(),
            frames: Vec::new(),
            next: 0,
            safe: 0,
            begun: false,
            ended: false,
            read: 0,
        };
        Self {
            sources: readers.into_iter().map(source).collect(),
            naming,
            names: Vec::new(),
            index: BTreeMap::new(),
            last: Timestamp(0),
            disordered: 0,
            window,
            window_bytes,
        }
    }

    /// The buses met so far; a frame's is among them when it is given.
    pub fn buses(&self) -> &[String] {
        &self.names
    }

    /// Frames that came out behind a later one.
    pub fn disordered(&self) -> u64 {
        self.disordered
    }

    /// The logs, in the order given.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// Replaces the content of `into` by the next frames. `false` at the end.
    pub fn next(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, MergeError> {
        into.clear();
        for number in 0..self.sources.len() {
            self.fill(number)?;
        }
        if let [source] = &mut self.sources[..]
            && source.begun
        {
            // Nothing to compare with.
            let count = (source.safe - source.next).min(BATCH);
            into.extend_from_slice(&source.frames[source.next..source.next + count]);
            source.next += count;
        } else {
            self.interleave(into)?;
        }
        for frame in &*into {
            self.disordered += u64::from(frame.frame.time < self.last);
            self.last = self.last.max(frame.frame.time);
        }
        Ok(!into.is_empty())
    }

    fn interleave(&mut self, into: &mut Vec<LogFrame>) -> Result<(), MergeError> {
        while into.len() < BATCH {
            let mut first: Option<(Timestamp, usize)> = None;
            for (number, source) in self.sources.iter().enumerate() {
                if source.next == source.safe {
                    // Its next frame is not known yet.
                    if source.ended {
                        continue;
                    }
                    return Ok(());
                }
                let time = source.frames[source.next].frame.time;
                if first.is_none_or(|(earliest, _)| time < earliest) {
                    first = Some((time, number));
                }
            }
            let Some((_, number)) = first else { return Ok(()) };
            let source = &mut self.sources[number];
            if !source.begun {
                source.begun = true;
                source.safe = if source.ended { source.frames.len() } else { 0 };
                self.fill(number)?;
                continue;
            }
            into.push(source.frames[source.next].clone());
            source.next += 1;
        }
        Ok(())
    }

    /// Reads until frames of a log can be given; of one that has not begun, until it is
    /// known when it begins.
    fn fill(&mut self, number: usize) -> Result<(), MergeError> {
        let (source, window) = (&mut self.sources[number], self.window);
        if source.next < source.safe || source.ended {
            return Ok(());
        }
        source.frames.drain(..source.next);
        (source.next, source.safe) = (0, 0);
        let enough = if source.begun { 2 * window } else { PEEK };
        let mut bytes = bytes_of(&source.frames);
        while !source.ended && source.frames.len() < enough && bytes < self.window_bytes {
            let before = source.frames.len();
            let more = source.reader.read(&mut source.frames);
            source.ended = !more.map_err(|error| MergeError::Log { number, error })?;
            if source.reader.times_are_relative() {
                for frame in &mut source.frames[before..] {
                    frame.frame.time = source.start.plus(frame.frame.time.nanos());
                }
            }
            while let Some(name) = source.reader.buses().get(source.buses.len()) {
                let name = (self.naming)(number, name).map_err(MergeError::Name)?;
                let next = u16::try_from(self.names.len()).map_err(|_| {
                    MergeError::Name("the logs have more buses than a recording can".to_owned())
                })?;
                let index = *self.index.entry(name.clone()).or_insert(next);
                if index == next {
                    self.names.push(name);
                }
                source.buses.push(index);
            }
            bytes += bytes_of(&source.frames[before..]);
            for frame in &mut source.frames[before..] {
                frame.bus = source.buses.get(usize::from(frame.bus)).copied().unwrap_or(frame.bus);
                let counted = !matches!(frame.frame.value, Frame::Gap(_) | Frame::Notice(_));
                source.read += u64::from(counted);
            }
        }
        if !source.frames.is_sorted_by_key(|frame| frame.frame.time) {
            source.frames.sort_by_key(|frame| frame.frame.time);
        }
        // Where bytes have ended the window before it was full, half of it can be given.
        let kept = if source.ended { 0 } else { window.min(source.frames.len() / 2) };
        source.safe = match source.frames.len() {
            1.. if !source.begun => 1,
            count => count.saturating_sub(kept),
        };
        if source.ended && source.frames.is_empty() {
            source.frames = Vec::new();
        }
        Ok(())
    }
}

/// Bytes that frames keep outside of themselves.
fn bytes_of(frames: &[LogFrame]) -> usize {
    let bytes = |frame: &LogFrame| match &frame.frame.value {
        Frame::Serial(bytes) => bytes.data.len(),
        _ => 0,
    };
    frames.iter().map(bytes).sum()
}

impl Source {
    /// Frames read from it, or reads of a serial line.
    pub fn read(&self) -> u64 {
        self.read
    }

    /// What could not be taken.
    pub fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }

    /// What a person should know about it.
    pub fn notes(&self) -> &[String] {
        self.reader.notes()
    }

    /// Its times are not dates.
    pub fn is_relative(&self) -> bool {
        self.reader.times_are_relative()
    }
}

/// Why merging cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// A log, by its number, cannot be read.
    #[error("{error}")]
    Log {
        /// From 0.
        number: usize,
        /// Why.
        error: ImportError,
    },
    /// A bus cannot have the name it would have.
    #[error("{0}")]
    Name(String),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{CanFlags, CanFrame, Direction, SerialBytes, Stamped};

    /// Gives frames at these times.
    struct Scripted(Vec<u64>, Vec<String>, Skipped, bool);

    impl LogReader for Scripted {
        fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
            let count = self.0.len().min(1000);
            into.extend(self.0.drain(..count).map(|nanos| {
                let value = Frame::Can(CanFrame::new(1, CanFlags::default(), &[]));
                LogFrame { bus: 0, frame: Stamped { time: Timestamp(nanos), value } }
            }));
            Ok(!self.0.is_empty())
        }
        fn buses(&self) -> &[String] {
            &self.1
        }
        fn skipped(&self) -> &Skipped {
            &self.2
        }
        fn times_are_relative(&self) -> bool {
            self.3
        }
    }

    fn merged(logs: &[(&[u64], &str, bool)]) -> (Vec<(u64, u16)>, Vec<String>, u64) {
        let readers = logs.iter().map(|(times, bus, relative)| -> Box<dyn LogReader> {
            Box::new(Scripted(
                times.to_vec(),
                vec![(*bus).to_owned()],
                Skipped::default(),
                *relative,
            ))
        });
        let naming = Box::new(|_, name: &str| Ok(name.to_owned()));
        let mut merge = Merge::new(readers.collect(), Timestamp(100), naming);
        let (mut all, mut some) = (Vec::new(), Vec::new());
        while merge.next(&mut some).unwrap() {
            all.extend(some.iter().map(|frame| (frame.frame.time.nanos(), frame.bus)));
        }
        (all, merge.buses().to_vec(), merge.disordered())
    }

    #[test]
    fn logs_become_one_row_in_time_order() {
        let (frames, buses, disordered) =
            merged(&[(&[105, 101, 103], "a", false), (&[2, 4], "b", true), (&[], "a", false)]);
        assert_eq!(frames, [(101, 0), (102, 1), (103, 0), (104, 1), (105, 0)]);
        assert_eq!((buses, disordered), (vec!["a".to_owned(), "b".to_owned()], 0));
    }

    /// The second log begins before the first one ends, the third when both have ended.
    #[test]
    fn logs_that_follow_one_another_overlap_where_they_do() {
        let times = |range: std::ops::Range<u64>| range.map(|n| 100 + n).collect::<Vec<_>>();
        let count = 3 * WINDOW as u64;
        let (first, second) = (times(0..count), times(count / 2..2 * count));
        let third = times(2 * count..2 * count + 10);
        let (frames, _, disordered) =
            merged(&[(&third, "c", false), (&first, "a", false), (&second, "b", false)]);
        assert_eq!((frames.len(), disordered), (first.len() + second.len() + 10, 0));
        assert!(frames.is_sorted_by_key(|(time, _)| *time));
    }

    /// Gives reads of a line of 1 MiB each.
    struct Heavy(u64, Vec<String>, Skipped);

    impl LogReader for Heavy {
        fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
            self.0 -= 1;
            let data = vec![0; 1 << 20];
            let bytes = SerialBytes { direction: Direction::Rx, data, errors: Vec::new() };
            // Every other one stands behind the next.
            let (time, value) = (Timestamp(self.0 ^ 1), Frame::Serial(bytes));
            into.push(LogFrame { bus: 0, frame: Stamped { time, value } });
            Ok(self.0 > 0)
        }
        fn buses(&self) -> &[String] {
            &self.1
        }
        fn skipped(&self) -> &Skipped {
            &self.2
        }
    }

    #[test]
    fn reads_of_megabytes_wait_in_a_bounded_memory() {
        let heavy = Heavy(200, vec!["rect".to_owned()], Skipped::default());
        let naming = Box::new(|_, name: &str| Ok(name.to_owned()));
        let mut merge = Merge::new(vec![Box::new(heavy)], Timestamp(0), naming);
        let (mut some, mut count) = (Vec::new(), 0);
        while merge.next(&mut some).unwrap() {
            count += some.len();
            let waiting = bytes_of(&merge.sources[0].frames);
            assert!(waiting <= WINDOW_BYTES + (1 << 20), "{waiting} bytes wait");
        }
        assert_eq!(count, 200);
    }

    #[test]
    fn disorder_within_the_window_is_mended_and_beyond_it_counted() {
        let count = 3 * WINDOW as u64;
        let mut times: Vec<u64> = (1000..1000 + count).collect();
        let far = times.len() - 1;
        times.swap(100, 100 + WINDOW - 1);
        let (frames, _, disordered) = merged(&[(&times, "a", false)]);
        assert!(frames.is_sorted());
        assert_eq!((frames.len() as u64, disordered), (count, 0));
        times[far] = 1;
        let (frames, _, disordered) = merged(&[(&times, "a", false)]);
        assert_eq!((frames.len() as u64, disordered), (count, 1));
    }
}
