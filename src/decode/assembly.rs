//! Messages that are put together from several frames.

use std::borrow::Cow;
use std::sync::Arc;

use super::can::{Check, Match};
use crate::frame::Timestamp;
use crate::protocol::payload::{FieldPlan, Payload, Value};

/// Longest message of several frames, in bytes: what one of them may hold back in memory.
pub const LONGEST: usize = 4096;

/// How one kind of message is put together, and what its bytes mean.
#[derive(Debug)]
pub struct Assembly {
    /// Its name; no other message of the protocol has it.
    pub name: Arc<str>,
    /// What kind of thing it is, in one word; several assemblies may share it.
    pub kind: Arc<str>,
    /// For people.
    pub title: Option<Arc<str>>,
    /// Which way it goes, `SENDER-to-RECEIVER`, if the database says so of its first frame.
    pub direction: Option<String>,
    /// Names and texts that each of them has.
    pub constants: Vec<(Arc<str>, Arc<str>)>,
    /// Its fields, in order.
    pub fields: Vec<AssemblyField>,
    /// Under which name all of its bytes are shown.
    pub raw: Option<Arc<str>>,
    /// Layout of the fields in front of the repeated one.
    pub(super) head: Payload,
    pub(super) parts: Parts,
    /// Longest time between two of its frames, nanoseconds.
    pub(super) timeout: Option<u64>,
}

/// A field of an assembly.
#[derive(Clone, Debug)]
pub struct AssemblyField {
    /// Its name, type, unit and value table.
    pub plan: Arc<FieldPlan>,
    /// It repeats up to the end of the bytes.
    pub repeated: bool,
    /// Under which name JSON shows the name of its value, if it does.
    pub label: Option<Arc<str>>,
}

/// How its frames are known.
#[derive(Debug)]
pub(super) enum Parts {
    /// By messages, in this order; place in the database and declared length.
    Listed(Vec<(usize, usize)>),
    /// By a number in the identifier.
    Counted {
        /// Key of the first frame without the number.
        base: u32,
        /// Bits of the identifier that hold the number.
        mask: u32,
        /// Number of the first frame.
        first: u32,
        /// The field that says how many bytes there are, and how many more there are.
        length: (Arc<FieldPlan>, i64),
    },
}

impl Assembly {
    /// Which of its frames one is, counted from 0.
    pub(super) fn number(&self, key: u32, message: Option<usize>) -> Option<u32> {
        match &self.parts {
            Parts::Listed(list) => {
                let at = list.iter().position(|(index, _)| Some(*index) == message)?;
                u32::try_from(at).ok()
            }
            Parts::Counted { base, mask, first, .. } => {
                let number = (key & mask) >> mask.trailing_zeros();
                (key & !mask == *base).then(|| number.checked_sub(*first))?
            }
        }
    }

    /// A frame after the first may be as short as it likes.
    pub(super) fn ends_anywhere(&self) -> bool {
        matches!(self.parts, Parts::Counted { .. })
    }

    /// How many bytes it will have; `None` when its first frame says what cannot be.
    fn total(&self, first: &[u8]) -> Option<usize> {
        match &self.parts {
            Parts::Listed(list) => Some(list.iter().map(|(_, length)| length).sum()),
            Parts::Counted { length: (field, add), .. } => {
                let bytes = first.get(field.at..field.at + field.size?)?;
                let Value::Unsigned(number) = field.read(bytes) else { return None };
                let total = usize::try_from(i64::try_from(number).ok()?.checked_add(*add)?).ok()?;
                (self.head.size.max(1)..=LONGEST).contains(&total).then_some(total)
            }
        }
    }

    /// Reads the complete fields of `bytes`; gives each its place in [`Self::fields`].
    fn decode(&self, bytes: &[u8], mut visit: impl FnMut(usize, Content)) {
        let head = self.head.decode(bytes);
        let fixed = head.fields.len();
        for (index, field) in head.fields.into_iter().enumerate() {
            visit(index, Content::One(field.value));
        }
        let repeated = self.fields.get(fixed).filter(|field| field.repeated);
        if let Some((field, size)) = repeated.and_then(|field| Some((field, field.plan.size?))) {
            let rest = bytes.get(self.head.size..).unwrap_or_default();
            let values = rest.chunks_exact(size.max(1)).map(|item| field.plan.read(item));
            visit(fixed, Content::Many(values.collect()));
        }
    }
}

/// What a field of an assembly holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// One value.
    One(Value),
    /// The values of a repeated field, as many as are complete.
    Many(Vec<Value>),
}

/// The text in front of the first zero byte; what is not UTF-8 becomes U+FFFD.
pub fn text(bytes: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(bytes.split(|byte| *byte == 0).next().unwrap_or_default())
}

/// A message that was put together, or what there is of it.
#[derive(Clone, Copy, Debug)]
pub struct Assembled<'a> {
    /// What it is.
    pub assembly: &'a Assembly,
    /// All of it is there, and it is as long as it says.
    pub complete: bool,
    /// Time of its first frame.
    pub begun: Timestamp,
    /// Time of the last frame that belongs to it.
    pub ended: Timestamp,
    /// How many frames belong to it.
    pub frames: u32,
    /// Its bytes, without those behind the length that it says.
    pub bytes: &'a [u8],
}

impl Assembled<'_> {
    /// Gives each complete field to `visit`, with its place in [`Assembly::fields`].
    pub fn decode(&self, visit: impl FnMut(usize, Content)) {
        self.assembly.decode(self.bytes, visit);
    }
}

/// An assembly on its way: at most one of each kind on a bus.
#[derive(Debug, Default)]
pub(super) struct Open {
    active: bool,
    bytes: Vec<u8>,
    total: usize,
    frames: u32,
    begun: Timestamp,
    ended: Timestamp,
}

impl Open {
    /// Takes a frame that is number `number` of `assembly`.
    pub fn take(
        &mut self,
        assembly: &Assembly,
        number: u32,
        found: Option<&Match<'_>>,
        (time, data): (Timestamp, &[u8]),
        visit: &mut impl FnMut(Assembled<'_>),
    ) {
        let late = assembly.timeout.is_some_and(|longest| time.since(self.ended) > longest);
        if number == 0 || late {
            self.give_up(assembly, visit);
        }
        let short = found.is_some_and(|found| found.check == Check::Short);
        if number == 0 {
            let total = if short { None } else { assembly.total(data) };
            let Some(total) = total else { return };
            self.bytes.clear();
            *self = Self {
                active: true,
                bytes: std::mem::take(&mut self.bytes),
                total,
                begun: time,
                ..Self::default()
            };
        } else if !self.active {
            // Its beginning was not seen.
            return;
        } else if number != self.frames || data.is_empty() {
            self.give_up(assembly, visit);
            return;
        }
        let data = match &assembly.parts {
            Parts::Counted { .. } => data,
            Parts::Listed(list) => {
                let declared = list.get(number as usize).map_or(0, |(_, length)| *length);
                data.get(..declared).unwrap_or(data)
            }
        };
        let fits = self.add(time, data);
        let torn = short && !assembly.ends_anywhere();
        if !fits || torn || self.bytes.len() == self.total {
            self.end(assembly, fits && !torn, visit);
        }
    }

    /// Adds as many bytes as are missing. False if there are more.
    fn add(&mut self, time: Timestamp, data: &[u8]) -> bool {
        let missing = self.total.saturating_sub(self.bytes.len());
        self.bytes.extend_from_slice(data.get(..missing).unwrap_or(data));
        self.frames += 1;
        self.ended = time;
        data.len() <= missing
    }

    /// Tells what there is of it, if anything.
    pub fn give_up(&mut self, assembly: &Assembly, visit: &mut impl FnMut(Assembled<'_>)) {
        if self.active {
            self.end(assembly, false, visit);
        }
    }

    fn end(&mut self, assembly: &Assembly, complete: bool, visit: &mut impl FnMut(Assembled<'_>)) {
        self.active = false;
        visit(Assembled {
            assembly,
            complete,
            begun: self.begun,
            ended: self.ended,
            frames: self.frames,
            bytes: &self.bytes,
        });
    }
}
