//! The records of one data group, in their order.

use std::collections::VecDeque;
use std::io::{Read, Seek};

use super::blocks::{BlockError, File};
use super::data::Data;
use super::describe::{DataGroup, Group, Times};
use super::event::Payload;
use super::signal::{LONGEST, Mixed, Place, Signal, Waiting};
use crate::frame::CanFrame;
use crate::import::Skipped;
use crate::import::little_endian::u32_at;

/// Frames that are made ready at a time.
const READY: usize = 512;

/// What a record tells.
pub(super) struct Told {
    /// Nanoseconds since the start of the file.
    pub time: i64,
    /// The number of the bus; `None` when the records of its group do not say it.
    pub channel: Option<u64>,
    /// Index of the group.
    pub group: usize,
    pub frame: CanFrame,
}

/// How a file was left that was not finished (`id_unfin_flags`).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Unfinished {
    /// Lengths of the last blocks may be missing.
    pub lengths: bool,
    /// Places of values of any length may be missing.
    pub offsets: bool,
}

/// Reads the records of a data group.
pub(super) struct Records {
    data: Data,
    id_size: usize,
    pub groups: Vec<Group>,
    /// Records of each group so far.
    counts: Vec<u64>,
    /// Values apart from the records, for each group that has some in signal data.
    signals: Vec<Option<Signal>>,
    mixed: Vec<Mixed>,
    /// Times apart from the records, for each group that has them so.
    clocks: Vec<Option<Clock>>,
    pub ready: VecDeque<Told>,
    ended: bool,
}

/// Times that are read beside the records they belong to.
struct Clock {
    data: Data,
    times: Times,
}

impl Clock {
    /// The time of record `number`, nanoseconds since the start of the file, if it is there. Numbers
    /// rise.
    fn nanos<R: Read + Seek>(
        &mut self,
        number: u64,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<Option<i64>, BlockError> {
        let Times { size, time, .. } = self.times;
        let at = number.saturating_mul(size as u64);
        let there = self.data.go_to(at, file, skipped)? && self.data.want(size, file, skipped)?;
        Ok(there.then(|| time.nanos(&self.data.bytes()[..size], number)))
    }
}

impl Records {
    pub fn new(group: DataGroup, unfinished: Unfinished) -> Self {
        let payloads = || group.groups.iter().map(|g| g.event.as_ref().map(|event| event.payload));
        let signals = payloads().map(|payload| match payload {
            Some(Payload::Signal(_, link)) => Some(Signal::new(link, unfinished.lengths)),
            _ => None,
        });
        let mixed = payloads().filter_map(|payload| match payload {
            Some(Payload::Group(_, at)) => Some(Mixed::new(at, unfinished.offsets)),
            _ => None,
        });
        let clock = |times: Times| Clock { data: Data::new(times.data, unfinished.lengths), times };
        let clocks = group.groups.iter().map(|group| group.times.map(clock)).collect();
        Self {
            data: Data::new(group.data, unfinished.lengths),
            id_size: group.id_size,
            counts: vec![0; group.groups.len()],
            signals: signals.collect(),
            mixed: mixed.collect(),
            clocks,
            groups: group.groups,
            ready: VecDeque::new(),
            ended: false,
        }
    }

    /// Makes frames ready; none are at the end.
    pub fn fill<R: Read + Seek>(
        &mut self,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<(), BlockError> {
        while self.ready.len() < READY && !self.ended {
            let more = if self.id_size == 0 {
                self.sorted(file, skipped)?
            } else {
                self.unsorted(file, skipped)?
            };
            if !more {
                self.end(skipped);
            }
        }
        Ok(())
    }

    /// One record of a group that has the data for itself; `false` at the end.
    fn sorted<R: Read + Seek>(
        &mut self,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<bool, BlockError> {
        let Some(Group { size, cycles, .. }) = self.groups.first() else { return Ok(false) };
        let (size, cycles) = (*size, *cycles);
        if size == 0 || cycles > 0 && self.counts[0] >= cycles {
            return Ok(false);
        }
        if self.data.want(size, file, skipped)? {
            let record = self.data.bytes()[..size].to_vec();
            self.data.take(size);
            self.record(0, record, file, skipped)?;
            return Ok(true);
        }
        if self.data.pass_hole() == 0 {
            return Ok(false);
        }
        // On to where the next whole record begins.
        let records = self.data.offset.div_ceil(size as u64);
        let rest = usize::try_from(records * size as u64 - self.data.offset).unwrap_or(0);
        if rest > 0 && self.data.want(rest, file, skipped)? {
            self.data.take(rest);
        }
        skipped.count += (records - self.counts[0]).saturating_sub(1);
        self.counts[0] = records;
        Ok(true)
    }

    /// One record of several groups that share the data; `false` at the end.
    fn unsorted<R: Read + Seek>(
        &mut self,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<bool, BlockError> {
        let id_size = self.id_size.min(8);
        if !self.data.want(id_size, file, skipped)? {
            return Ok(false);
        }
        let at = self.data.offset;
        let place = || format!("byte {at} of the records");
        let id = self.data.bytes()[..id_size].iter().rev().fold(0, |id, b| id << 8 | u64::from(*b));
        let Some(index) = self.groups.iter().position(|group| group.record_id == id) else {
            skipped.add(place, || format!("no group has records of the number {id}"));
            self.data = Data::new(0, false);
            return Ok(false);
        };
        let (mut start, mut size) = (id_size, self.groups[index].size);
        if self.groups[index].variable {
            if !self.data.want(id_size + 4, file, skipped)? {
                return Ok(false);
            }
            start += 4;
            size = u32_at(self.data.bytes(), id_size).unwrap_or(0) as usize;
            if size > LONGEST {
                skipped.add(place, || format!("a value of {size} bytes is not believed"));
                self.data = Data::new(0, false);
                return Ok(false);
            }
        }
        if !self.data.want(start + size, file, skipped)? {
            return Ok(false);
        }
        let record = self.data.bytes()[start..start + size].to_vec();
        self.data.take(start + size);
        if self.groups[index].variable {
            let group = self.groups[index].at;
            self.counts[index] += 1;
            if let Some(mixed) = self.mixed.iter_mut().find(|mixed| mixed.group == group) {
                mixed.add_value(&record);
                self.pair(false, skipped);
            }
        } else {
            self.record(index, record, file, skipped)?;
        }
        Ok(true)
    }

    /// Takes a record whose payload is in it, or in signal data; others wait for theirs.
    fn record<R: Read + Seek>(
        &mut self,
        index: usize,
        record: Vec<u8>,
        file: &mut File<R>,
        skipped: &mut Skipped,
    ) -> Result<(), BlockError> {
        let number = self.counts[index];
        self.counts[index] += 1;
        let time = match &mut self.clocks[index] {
            Some(clock) => clock.nanos(number, file, skipped)?,
            None => Some(self.groups[index].time.nanos(&record, number)),
        };
        let Some(event) = &self.groups[index].event else { return Ok(()) };
        let Some(time) = time else {
            let why = || "the time of this frame is not in the file".into();
            skipped.add(|| format!("record {number}"), why);
            return Ok(());
        };
        let place = Place { group: index, number, time };
        match event.payload {
            Payload::None => self.take(place, &record, &[], skipped),
            Payload::Inline(field) => {
                let data = field.bytes(&record).to_vec();
                self.take(place, &record, &data, skipped);
            }
            Payload::Signal(field, _) => {
                let offset = field.number(&record);
                let value = match &mut self.signals[index] {
                    Some(signal) => signal.value(offset, file, skipped)?.map(<[u8]>::to_vec),
                    None => None,
                };
                self.with_value(place, &record, value, skipped);
            }
            Payload::Group(field, at) => {
                let offset = field.number(&record);
                let waiting = Waiting { place, offset, record };
                if let Some(mixed) = self.mixed.iter_mut().find(|mixed| mixed.group == at) {
                    mixed.add_record(waiting);
                }
                self.pair(false, skipped);
            }
        }
        Ok(())
    }

    /// Takes the records that have their values now; all of them when no more values come.
    fn pair(&mut self, ended: bool, skipped: &mut Skipped) {
        for index in 0..self.mixed.len() {
            while let Some((waiting, value)) = self.mixed[index].next(ended) {
                let Waiting { place, record, .. } = waiting;
                self.with_value(place, &record, value, skipped);
            }
        }
    }

    fn with_value(
        &mut self,
        place: Place,
        record: &[u8],
        value: Option<Vec<u8>>,
        skipped: &mut Skipped,
    ) {
        match value {
            Some(value) => self.take(place, record, &value, skipped),
            None => skipped.add(
                || format!("record {}", place.number),
                || "the bytes of this frame are not in the file".into(),
            ),
        }
    }

    fn take(&mut self, place: Place, record: &[u8], data: &[u8], skipped: &mut Skipped) {
        let Place { group, number, time } = place;
        let Some(event) = &self.groups[group].event else { return };
        let channel = event.channel.map(|field| field.number(record));
        match event.frame(record, data) {
            Ok(frame) => self.ready.push_back(Told { time, channel, group, frame }),
            Err(why) => skipped.add(
                || format!("record {number}"),
                || format!("this frame cannot be taken: {why}"),
            ),
        }
    }

    /// Counts what should have been there.
    fn end(&mut self, skipped: &mut Skipped) {
        self.ended = true;
        self.pair(true, skipped);
        let left = self.data.bytes().len();
        let mut missing = 0;
        for (group, count) in self.groups.iter().zip(&self.counts) {
            if group.event.is_some() {
                missing += group.cycles.saturating_sub(*count);
            }
        }
        let offset = self.data.offset;
        let place = || format!("byte {offset} of the records");
        if missing > 0 {
            skipped.add(place, || format!("{missing} records that are announced are missing"));
            skipped.count += missing - 1;
        } else if left > 0 && self.groups.iter().all(|group| group.cycles == 0) {
            skipped.add(place, || format!("the last record has only {left} bytes"));
        }
    }
}
