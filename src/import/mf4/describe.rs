//! What the file says of itself: data groups, channel groups, and their fields.

use std::collections::{BTreeMap, HashSet};
use std::io::{Read, Seek};

use super::blocks::{Block, BlockError, File};
use super::channels::{Channel, Channels, VARIABLE, VIRTUAL_MASTER, items};
use super::event::{Event, Kind, Payload};
use super::field::Time;
use super::packed::Packed;
use crate::import::Skipped;
use crate::import::little_endian::{u16_at, u32_at, u64_at};

/// Blocks that are looked at in one file; more are the work of somebody who means harm.
const BLOCKS: usize = 500_000;
/// Channels inside of channels inside of ...
const DEPTH: u32 = 8;
/// `cg_flags`: the times of the records are those of another group.
const REMOTE_MASTER: u16 = 8;
/// A record's bytes; bus events have less than a hundred.
const LONGEST_RECORD: u32 = 1 << 20;

/// Records of one shape.
#[derive(Debug)]
pub(super) struct Group {
    /// Its address, by which others link to it.
    pub at: u64,
    pub record_id: u64,
    /// How many records it has, if that was written.
    pub cycles: u64,
    /// Bytes of a record.
    pub size: usize,
    /// Its records are of any length, and belong to a field of another group.
    pub variable: bool,
    pub time: Time,
    /// The group whose records have the times of this one's (since MDF 4.2); 0 if they are here.
    master: u64,
    /// Where those times are.
    pub times: Option<Times>,
    pub event: Option<Event>,
}

/// Times that stand in records of their own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    /// The data of those records.
    pub data: u64,
    /// Bytes of one.
    pub size: usize,
    pub time: Time,
}

/// Groups whose records stand mixed in one stream of data.
#[derive(Debug)]
pub(super) struct DataGroup {
    /// Its data.
    pub data: u64,
    /// Bytes in front of each record that say which group it belongs to.
    pub id_size: usize,
    pub groups: Vec<Group>,
}

/// All that is said in front of the data.
#[derive(Debug, Default)]
pub(super) struct Description {
    pub data_groups: Vec<DataGroup>,
    /// Groups that hold no CAN frames and their records, by what they are called.
    pub others: BTreeMap<String, u64>,
}

/// Reads the description, from the link to the first data group on.
pub(super) fn read<R: Read + Seek>(
    file: &mut File<R>,
    first: u64,
    skipped: &mut Skipped,
) -> Result<Description, BlockError> {
    let mut reader = Reader { file, seen: HashSet::new(), columns: false, skipped };
    let mut description = Description::default();
    let mut next = first;
    while let Some(group) = reader.block(next, *b"##DG")? {
        next = group.link(0);
        reader.columns = reader.holds_columns(group.link(2))?;
        let mut data_group = DataGroup {
            data: group.link(2),
            id_size: group.data.first().copied().unwrap_or(0).into(),
            groups: Vec::new(),
        };
        let mut at = group.link(1);
        while let Some(block) = reader.block(at, *b"##CG")? {
            if let Some(group) = reader.group(at, &block, &mut description.others)? {
                data_group.groups.push(group);
            }
            at = block.link(0);
        }
        description.data_groups.push(data_group);
    }
    description.find_times(reader.skipped);
    Ok(description)
}

impl Description {
    /// Gives the groups whose times are those of another group the place of these.
    fn find_times(&mut self, skipped: &mut Skipped) {
        let alone = self.data_groups.iter().filter(|group| group.id_size == 0);
        let times: BTreeMap<u64, Times> = alone
            .filter_map(|of| {
                let group = of.groups.first()?;
                let times = Times { data: of.data, size: group.size, time: group.time };
                (group.size > 0).then_some((group.at, times))
            })
            .collect();
        for group in &mut self.data_groups {
            let alone = group.id_size == 0;
            for group in group.groups.iter_mut().filter(|group| group.master != 0) {
                group.times = times.get(&group.master).copied().filter(|_| alone);
                if group.times.is_none() && group.event.take().is_some() {
                    let (at, count) = (group.master, group.cycles.max(1));
                    let why = || format!("the times of {count} frames are not in this block");
                    skipped.add(|| format!("byte {at}"), why);
                    skipped.count += count - 1;
                }
            }
        }
    }
}

struct Reader<'a, R> {
    file: &'a mut File<R>,
    seen: HashSet<u64>,
    /// The data of the group stand in blocks without bits that say what is invalid.
    columns: bool,
    skipped: &'a mut Skipped,
}

impl<R: Read + Seek> Reader<'_, R> {
    /// The block at `at`; `None` if there is none, or it is counted as one that cannot be used.
    fn block(&mut self, at: u64, id: [u8; 4]) -> Result<Option<Block>, BlockError> {
        if at == 0 {
            return Ok(None);
        }
        let odd = if self.seen.len() >= BLOCKS {
            format!("the file has more than {BLOCKS} blocks that describe data")
        } else if !self.seen.insert(at) {
            "a chain of blocks leads back to itself".into()
        } else {
            match self.file.block(at, id) {
                Ok(block) => return Ok(Some(block)),
                Err(BlockError::Odd(why)) => why,
                Err(error) => return Err(error),
            }
        };
        self.skipped.add(|| format!("byte {at}"), || odd);
        Ok(None)
    }

    fn text(&mut self, at: u64) -> Result<String, BlockError> {
        match self.file.text(at) {
            Err(BlockError::Odd(_)) => Ok(String::new()),
            other => other,
        }
    }

    /// True if the data at `link` are blocks DV of MDF 4.2, which have the bits that say what is
    /// invalid in blocks apart (DI).
    fn holds_columns(&mut self, link: u64) -> Result<bool, BlockError> {
        let original = self.file.head(link).and_then(|head| match &head.id {
            b"##DZ" => Packed::of(&head, self.file).map(|packed| packed.original == *b"DV"),
            id => Ok(matches!(id, b"##DV" | b"##LD")),
        });
        match original {
            Err(BlockError::Odd(_)) => Ok(false),
            other => other,
        }
    }

    fn group(
        &mut self,
        at: u64,
        block: &Block,
        others: &mut BTreeMap<String, u64>,
    ) -> Result<Option<Group>, BlockError> {
        let data = &block.data;
        let numbers = (|| {
            Some((
                u64_at(data, 0)?,
                u64_at(data, 8)?,
                u16_at(data, 16)?,
                u32_at(data, 24)?,
                u32_at(data, 28)?,
            ))
        })();
        let Some((record_id, cycles, flags, bytes, invalid)) = numbers else {
            self.skipped.add(|| format!("byte {at}"), || "this block CG is too short".into());
            return Ok(None);
        };
        let variable = flags & 1 != 0;
        let size = bytes.saturating_add(if self.columns { 0 } else { invalid });
        let master = if flags & REMOTE_MASTER == 0 { 0 } else { block.link(6) };
        let (size_of, time, times, event) = (size as usize, Time::NONE, None, None);
        let mut group =
            Group { at, record_id, cycles, size: size_of, variable, time, master, times, event };
        if variable {
            return Ok(Some(group));
        }
        if size > LONGEST_RECORD {
            let odd = || format!("records of {size} bytes are not read");
            self.skipped.add(|| format!("byte {at}"), odd);
            return Ok(None);
        }
        let mut channels = Channels::default();
        self.channels(block.link(1), "", 0, &mut channels)?;
        group.time = channels.time.unwrap_or(Time::NONE);
        let name = self.text(block.link(2))?;
        if let Some(kind) = channels.event() {
            group.event = Some(self.event(kind, channels, &name)?);
        } else {
            let name = channels.other.unwrap_or(name);
            *others.entry(name).or_default() += cycles;
        }
        Ok(Some(group))
    }

    /// Collects the channels from `at` on, and those they are composed of.
    fn channels(
        &mut self,
        mut at: u64,
        parent: &str,
        depth: u32,
        into: &mut Channels,
    ) -> Result<(), BlockError> {
        while let Some(block) = self.block(at, *b"##CN")? {
            let mut name = self.text(block.link(2))?;
            // Fields are called CAN_DataFrame.ID, or ID inside of CAN_DataFrame.
            if !parent.is_empty() && !name.contains('.') {
                name = format!("{parent}.{name}");
            }
            let Some(mut channel) = Channel::of(&block) else {
                self.skipped.add(|| format!("byte {at}"), || "this block CN is too short".into());
                break;
            };
            at = block.link(0);
            let inside = block.link(1);
            if inside != 0 && depth < DEPTH {
                match self.file.head(inside).map(|head| head.id) {
                    Ok(id) if id == *b"##CA" => {
                        let array = self.block(inside, id)?;
                        let items = array.map_or(1, |array| items(&array));
                        channel.field.bits = channel.field.bits.saturating_mul(items);
                    }
                    Ok(_) => self.channels(inside, &name, depth + 1, into)?,
                    Err(BlockError::Odd(_)) => {}
                    Err(error) => return Err(error),
                }
            }
            if channel.is_master() {
                let time = self.time(&channel, block.link(4));
                into.time.get_or_insert(time);
            }
            into.add(name, channel);
        }
        Ok(())
    }

    /// The time that a master channel gives, by its conversion.
    fn time(&mut self, channel: &Channel, conversion: u64) -> Time {
        let field = (channel.role != VIRTUAL_MASTER).then_some(channel.field);
        let plain = Time { field, offset: 0.0, factor: 1.0 };
        if conversion == 0 {
            return plain;
        }
        let Ok(block) = self.file.block(conversion, *b"##CC") else { return plain };
        let value = |at| u64_at(&block.data, at).map(f64::from_bits);
        match (block.data.first(), value(24), value(32)) {
            // Linear.
            (Some(1), Some(offset), Some(factor)) => Time { field, offset, factor },
            _ => plain,
        }
    }

    fn event(
        &mut self,
        kind: Kind,
        mut channels: Channels,
        acquisition: &str,
    ) -> Result<Event, BlockError> {
        let mut take = |name: &str| channels.fields.remove(name);
        let payload = match take("DataBytes") {
            None => Payload::None,
            Some(channel) if channel.role != VARIABLE => Payload::Inline(channel.field),
            Some(channel) => match self.file.head(channel.data) {
                Ok(head) if head.id == *b"##CG" => Payload::Group(channel.field, channel.data),
                Ok(_) => Payload::Signal(channel.field, channel.data),
                Err(BlockError::Odd(why)) => {
                    self.skipped.add(|| format!("byte {}", channel.data), || why);
                    Payload::Signal(channel.field, 0)
                }
                Err(error) => return Err(error),
            },
        };
        let mut field = |name: &str| take(name).map(|channel| channel.field);
        Ok(Event {
            kind,
            id: field("ID"),
            ide: field("IDE"),
            channel: field("BusChannel"),
            dlc: field("DLC"),
            length: field("DataLength"),
            sent: field("Dir"),
            edl: field("EDL"),
            brs: field("BRS"),
            esi: field("ESI"),
            remote: field("RTR"),
            error: field("ErrorType"),
            payload,
            bus: if acquisition.is_empty() { "CAN".into() } else { acquisition.to_owned() },
        })
    }
}
