//! Layout `batch`: many CAN frames in one `bustape.CanBatch` message, by column.
//!
//! Frames of the same kind (identifier, flags, length) stand together and their bytes are
//! transposed, so that a counter's bytes follow each other and a constant byte becomes a run.
//! That is what makes this layout several times smaller than one message a frame; the exact rules
//! stand in `schemas/bustape/can_batch.proto`.

use super::limits::MAX_BATCH_FRAMES;
use super::wire::{Field, Fields, put_bytes, put_uint, put_varint, take_varint, varint_len};
use crate::frame::{CAN_MAX_DATA, CanFlags, CanFrame, Stamped, Timestamp};

/// Slots of the table that finds a frame's kind; more than twice the frames of a batch.
const SLOTS: usize = 4_096;
/// Most frames in a batch that is being built.
const CAPACITY: usize = SLOTS / 2;
const EMPTY: u16 = u16::MAX;

/// Collects frames of one bus until they are written as one message.
pub struct BatchBuilder {
    limit: usize,
    times: Vec<u64>,
    /// For each frame its kind, by the order of first appearance.
    kind: Vec<u16>,
    /// Packed kinds, see [`pack`], and how many frames each has.
    kinds: Vec<(u64, u32)>,
    slots: Vec<u16>,
    /// All payloads one after another, and where each starts.
    data: Vec<u8>,
    starts: Vec<u32>,
    scratch: Scratch,
}

/// Buffers of [`BatchBuilder::finish`], kept so that it need not allocate.
#[derive(Default)]
struct Scratch {
    /// Kinds by ascending key, as indexes into `kinds`, and back.
    sorted: Vec<u16>,
    rank: Vec<u16>,
    /// Frames by kind: where each kind's begin, and the payload starts in that order.
    begin: Vec<u32>,
    grouped: Vec<u32>,
    table: Vec<u8>,
    columns: Vec<u8>,
}

impl BatchBuilder {
    /// A builder that is full after `limit` frames (at most 2048).
    pub fn new(limit: usize) -> Self {
        Self {
            limit: limit.clamp(1, CAPACITY),
            times: Vec::new(),
            kind: Vec::new(),
            kinds: Vec::new(),
            slots: vec![EMPTY; SLOTS],
            data: Vec::new(),
            starts: Vec::new(),
            scratch: Scratch::default(),
        }
    }

    /// Frames collected so far.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// True when there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// True when the next frame needs a new batch.
    pub fn is_full(&self) -> bool {
        self.times.len() >= self.limit
    }

    /// Time of the first frame.
    pub fn first(&self) -> Option<Timestamp> {
        self.times.first().copied().map(Timestamp)
    }

    /// Time of the last frame.
    pub fn last(&self) -> Option<Timestamp> {
        self.times.last().copied().map(Timestamp)
    }

    /// Adds a frame. A time before that of the frame before is raised to it.
    pub fn push(&mut self, time: Timestamp, frame: &CanFrame) {
        let floor = self.times.last().copied().unwrap_or(0);
        self.times.push(time.nanos().max(floor));
        let kind = self.kind_of(pack(frame));
        self.kind.push(kind);
        self.kinds[usize::from(kind)].1 += 1;
        #[allow(clippy::cast_possible_truncation, reason = "at most 2048 * 64 bytes")]
        self.starts.push(self.data.len() as u32);
        self.data.extend_from_slice(frame.data());
    }

    fn kind_of(&mut self, key: u64) -> u16 {
        // Fibonacci hashing: identifiers differ in their low bits.
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 52) as usize;
        loop {
            match self.slots[slot] {
                EMPTY => {
                    #[allow(clippy::cast_possible_truncation, reason = "at most 2048 kinds")]
                    let kind = self.kinds.len() as u16;
                    self.slots[slot] = kind;
                    self.kinds.push((key, 0));
                    return kind;
                }
                kind if self.kinds[usize::from(kind)].0 == key => return kind,
                _ => slot = (slot + 1) % SLOTS,
            }
        }
    }

    /// Appends the message to `out` and starts over. Does nothing when empty.
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        if self.is_empty() {
            return;
        }
        self.rank_kinds();
        self.transpose();
        put_uint(out, 1, self.times.len() as u64);
        self.put_times(out);
        self.put_kinds(out);
        put_bytes(out, 6, &self.scratch.columns);
        self.clear();
    }

    fn clear(&mut self) {
        self.slots.fill(EMPTY);
        self.times.clear();
        self.kind.clear();
        self.kinds.clear();
        self.data.clear();
        self.starts.clear();
    }

    /// Kinds go by identifier: then the same kinds give the same bytes in every batch.
    fn rank_kinds(&mut self) {
        let Scratch { sorted, rank, .. } = &mut self.scratch;
        sorted.clear();
        sorted.extend((0u16..).take(self.kinds.len()));
        sorted.sort_unstable_by_key(|&kind| self.kinds[usize::from(kind)].0);
        rank.clear();
        rank.resize(sorted.len(), 0);
        for (place, &kind) in (0u16..).zip(&*sorted) {
            rank[usize::from(kind)] = place;
        }
    }

    fn transpose(&mut self) {
        let Scratch { sorted, rank, begin, grouped, columns, .. } = &mut self.scratch;
        begin.clear();
        let mut next = 0;
        for &kind in &*sorted {
            begin.push(next);
            next += self.kinds[usize::from(kind)].1;
        }
        grouped.clear();
        grouped.resize(self.starts.len(), 0);
        for (&kind, &start) in self.kind.iter().zip(&self.starts) {
            let place = &mut begin[usize::from(rank[usize::from(kind)])];
            grouped[*place as usize] = start;
            *place += 1;
        }
        columns.clear();
        columns.reserve(self.data.len());
        let mut rest = &grouped[..];
        for &kind in &*sorted {
            let (key, count) = self.kinds[usize::from(kind)];
            let (frames, tail) = rest.split_at(count as usize);
            rest = tail;
            for byte in 0..unpack(key).length {
                columns.extend(frames.iter().map(|&start| self.data[start as usize + byte]));
            }
        }
    }

    fn put_times(&self, out: &mut Vec<u8>) {
        let first = self.times[0];
        let tick =
            if self.times.iter().all(|t| (t - first).is_multiple_of(1000)) { 1000 } else { 1 };
        put_uint(out, 2, tick);
        let deltas = || {
            let before = std::iter::once(&first).chain(&self.times);
            before.zip(&self.times).map(|(before, time)| (time - before) / tick)
        };
        put_packed(out, 3, deltas);
    }

    fn put_kinds(&mut self, out: &mut Vec<u8>) {
        for &kind in &self.scratch.sorted {
            let kind = unpack(self.kinds[usize::from(kind)].0);
            let table = &mut self.scratch.table;
            table.clear();
            put_uint(table, 1, u64::from(kind.id));
            put_uint(table, 2, u64::from(kind.flags.0));
            put_uint(table, 3, u64::from(kind.dlc));
            put_uint(table, 4, kind.length as u64);
            put_varint(out, 4 << 3 | 2);
            put_varint(out, table.len() as u64);
            out.extend_from_slice(table);
        }
        let rank = &self.scratch.rank;
        put_packed(out, 5, || self.kind.iter().map(|&kind| u64::from(rank[usize::from(kind)])));
    }
}

fn put_packed<I: Iterator<Item = u64>>(out: &mut Vec<u8>, field: u64, values: impl Fn() -> I) {
    put_varint(out, field << 3 | 2);
    put_varint(out, values().map(varint_len).sum::<usize>() as u64);
    values().for_each(|value| put_varint(out, value));
}

struct Kind {
    id: u32,
    flags: CanFlags,
    dlc: u8,
    length: usize,
}

/// A kind as one number: identifier in the upper half so that kinds sort by it.
fn pack(frame: &CanFrame) -> u64 {
    let low = u32::from(frame.flags.0) << 16 | u32::from(frame.dlc) << 8;
    #[allow(clippy::cast_possible_truncation, reason = "at most 64")]
    let length = frame.data().len() as u32;
    u64::from(frame.id) << 32 | u64::from(low | length)
}

fn unpack(key: u64) -> Kind {
    let [length, dlc, flags, ..] = key.to_le_bytes();
    #[allow(clippy::cast_possible_truncation, reason = "the upper half")]
    let id = (key >> 32) as u32;
    Kind { id, flags: CanFlags(flags), dlc, length: usize::from(length) }
}

/// Reads a batch whose message has the given log time. `None` if the bytes are not one.
pub fn decode(log_time: Timestamp, bytes: &[u8]) -> Option<Vec<Stamped<CanFrame>>> {
    let parts = Parts::of(bytes)?;
    let mut counts = vec![0usize; parts.kinds.len()];
    let mut rest = parts.kind;
    for _ in 0..parts.count {
        *counts.get_mut(usize::try_from(take_varint(&mut rest)?).ok()?)? += 1;
    }
    // Where each kind's block of columns begins, and how many of its frames were given out.
    let mut blocks = Vec::with_capacity(parts.kinds.len());
    let mut end = 0;
    for (kind, &count) in parts.kinds.iter().zip(&counts) {
        blocks.push((end, 0));
        end += kind.length * count;
    }
    if end != parts.data.len() {
        return None;
    }
    let mut frames = Vec::with_capacity(parts.count);
    let (mut time, mut deltas, mut rest) = (log_time, parts.delta, parts.kind);
    for _ in 0..parts.count {
        time = time.plus(take_varint(&mut deltas)?.saturating_mul(parts.tick));
        let index = usize::try_from(take_varint(&mut rest)?).ok()?;
        let (kind, (begin, given)) = (&parts.kinds[index], &mut blocks[index]);
        let mut data = [0; CAN_MAX_DATA];
        for (byte, value) in data[..kind.length].iter_mut().enumerate() {
            *value = parts.data[*begin + byte * counts[index] + *given];
        }
        *given += 1;
        let frame = CanFrame::new(kind.id, kind.flags, &data[..kind.length]).with_dlc(kind.dlc);
        frames.push(Stamped { time, value: frame });
    }
    Some(frames)
}

struct Parts<'a> {
    count: usize,
    tick: u64,
    delta: &'a [u8],
    kinds: Vec<Kind>,
    kind: &'a [u8],
    data: &'a [u8],
}

impl<'a> Parts<'a> {
    fn of(bytes: &'a [u8]) -> Option<Self> {
        let (delta, kind, data) = (&[][..], &[][..], &[][..]);
        let mut parts = Parts { count: 0, tick: 1, delta, kinds: Vec::new(), kind, data };
        let mut fields = Fields::of(bytes);
        for (number, field) in fields.by_ref() {
            match (number, field) {
                (1, Field::Uint(value)) => parts.count = usize::try_from(value).ok()?,
                (2, Field::Uint(value)) => parts.tick = value,
                (3, Field::Bytes(bytes)) => parts.delta = bytes,
                (4, Field::Bytes(_)) if parts.kinds.len() >= MAX_BATCH_FRAMES => return None,
                (4, Field::Bytes(bytes)) => parts.kinds.push(decode_kind(bytes)?),
                (5, Field::Bytes(bytes)) => parts.kind = bytes,
                (6, Field::Bytes(bytes)) => parts.data = bytes,
                _ => {}
            }
        }
        // Each frame needs at least a byte of `kind`, so the bytes bound what is allocated.
        let plausible = parts.count <= parts.kind.len().min(MAX_BATCH_FRAMES);
        (fields.sound() && plausible).then_some(parts)
    }
}

fn decode_kind(bytes: &[u8]) -> Option<Kind> {
    let mut kind = Kind { id: 0, flags: CanFlags::default(), dlc: 0, length: 0 };
    let mut fields = Fields::of(bytes);
    for (number, field) in fields.by_ref() {
        let Field::Uint(value) = field else { continue };
        match number {
            1 => kind.id = u32::try_from(value).ok()?,
            2 => kind.flags = CanFlags(u8::try_from(value).ok()?),
            3 => kind.dlc = u8::try_from(value).ok()?,
            4 => kind.length = usize::try_from(value).ok()?,
            _ => {}
        }
    }
    (fields.sound() && kind.length <= CAN_MAX_DATA).then_some(kind)
}
