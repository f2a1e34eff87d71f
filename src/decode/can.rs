//! Decodes CAN frames with a database.

use super::dbc::{Database, Format, Message};
use super::j1939::Identifier;
use super::layout::Payload;
pub use super::layout::Value;
use super::plan::Plan;
pub use super::plan::Reading;
use crate::frame::{CanFlags, CanFrame};

/// How the frame's length compares to the declared one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// As declared; for CAN FD also padded to the next length that exists.
    Exact,
    /// Shorter: some signals may be absent.
    Short,
    /// Longer: what is behind the declared length is extra.
    Long,
}

impl Check {
    /// As `explain` writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Short => "short",
            Self::Long => "long",
        }
    }
}

/// The message that a frame carries.
#[derive(Clone, Copy, Debug)]
pub struct Match<'a> {
    /// Its place in [`Database::messages`].
    pub index: usize,
    /// What the database says about it.
    pub message: &'a Message,
    /// The length of the frame.
    pub check: Check,
    /// The frame's addresses, when it was recognised as J1939.
    pub j1939: Option<Identifier>,
    plan: &'a Plan,
}

/// A database, compiled.
#[derive(Debug)]
pub struct CanDecoder {
    database: Database,
    plans: Vec<Plan>,
    /// Identifier (bit 31: extended) and message, sorted.
    exact: Vec<(u32, u32)>,
    /// J1939: number, then source address, and message, sorted.
    groups: Vec<(u32, u32)>,
}

/// Which message a frame carries.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// Place of the message in the database.
    pub index: usize,
    /// The frame's addresses, when it was recognised as J1939.
    pub j1939: Option<Identifier>,
}

const EXTENDED: u32 = 0x8000_0000;

/// An identifier, and in bit 31 whether it is one of 29 bits.
#[inline]
pub(super) fn key(id: u32, extended: bool) -> u32 {
    id | if extended { EXTENDED } else { 0 }
}

impl CanDecoder {
    /// Compiles `database`. With `j1939` every message with a 29-bit identifier is recognised by
    /// its parameter group number, whatever the database says.
    pub fn new(database: Database, j1939: bool) -> Self {
        Self::with_meanings(database, j1939, 0)
    }

    /// The same; the last `meanings` messages are not recognised by their identifiers.
    pub(super) fn with_meanings(database: Database, j1939: bool, meanings: usize) -> Self {
        let plans = database.messages.iter().map(Plan::of).collect();
        let (mut exact, mut groups) = (Vec::new(), Vec::new());
        let recognised = database.messages.len().saturating_sub(meanings);
        for (index, message) in (0..).zip(&database.messages).take(recognised) {
            exact.push((key(message.id, message.extended), index));
            if message.extended && (j1939 || message.format == Format::J1939) {
                groups.push((group_key(Identifier::of(message.id)), index));
            }
        }
        exact.sort_unstable();
        groups.sort_unstable();
        Self { database, plans, exact, groups }
    }

    /// What it was made of.
    pub fn database(&self) -> &Database {
        &self.database
    }

    /// For each message whether it is recognised by its parameter group number.
    pub(super) fn grouped(&self) -> Vec<bool> {
        let mut grouped = vec![false; self.database.messages.len()];
        for (_, index) in &self.groups {
            if let Some(is) = grouped.get_mut(*index as usize) {
                *is = true;
            }
        }
        grouped
    }

    /// The message that `frame` carries. Remote and error frames carry none.
    pub fn find(&self, frame: &CanFrame) -> Option<Match<'_>> {
        self.as_message(self.identify(frame)?, frame)
    }

    /// The same, as a place in the database.
    #[inline]
    pub(super) fn identify(&self, frame: &CanFrame) -> Option<Found> {
        if frame.flags.has(CanFlags::REMOTE) || frame.flags.has(CanFlags::ERROR) {
            return None;
        }
        let extended = frame.flags.has(CanFlags::EXTENDED);
        let exact = search(&self.exact, key(frame.id, extended));
        let group = if extended { self.find_group(frame.id, exact) } else { None };
        let index = group.map(|(index, _)| index).or(exact)? as usize;
        Some(Found { index, j1939: group.map(|(_, id)| id) })
    }

    /// `frame` as the message that was found for it.
    #[inline]
    pub(super) fn as_message(&self, found: Found, frame: &CanFrame) -> Option<Match<'_>> {
        let message = self.database.messages.get(found.index)?;
        let plan = self.plans.get(found.index)?;
        let check = check(message, frame);
        Some(Match { index: found.index, message, check, j1939: found.j1939, plan })
    }

    /// By number and source address, else by number: databases give messages the address 0xFE
    /// (nobody's) or that of one device of many. The same identifier wins over both.
    fn find_group(&self, id: u32, exact: Option<u32>) -> Option<(u32, Identifier)> {
        if self.groups.is_empty() {
            return None;
        }
        let id = Identifier::of(id);
        let key = group_key(id);
        let first = |at: usize| self.groups.get(at).copied();
        let same_number = |(other, _): &(u32, u32)| other >> 8 == id.pgn;
        let from = self.groups.partition_point(|(other, _)| *other < id.pgn << 8);
        let any = first(from).filter(same_number)?.1;
        let by_source = first(self.groups.partition_point(|(other, _)| *other < key));
        let by_source = by_source.filter(|(other, _)| *other == key).map(|(_, index)| index);
        Some((exact.or(by_source).unwrap_or(any), id))
    }
}

impl Match<'_> {
    /// Gives every signal that is in `frame` to `visit`; those that are not (multiplexed away, or
    /// beyond the end of a short frame) are not given. Allocates nothing, cannot fail.
    #[inline]
    pub fn decode(&self, frame: &CanFrame, visit: impl FnMut(Reading)) {
        self.plan.decode(&Payload::new(frame.data()), visit);
    }

    /// The bytes behind the declared length.
    pub fn extra<'f>(&self, frame: &'f CanFrame) -> &'f [u8] {
        match self.check {
            Check::Long => frame.data().get(usize::from(self.message.length)..).unwrap_or_default(),
            Check::Exact | Check::Short => &[],
        }
    }
}

fn group_key(id: Identifier) -> u32 {
    id.pgn << 8 | u32::from(id.source)
}

fn search(sorted: &[(u32, u32)], key: u32) -> Option<u32> {
    let at = sorted.partition_point(|(other, _)| *other < key);
    sorted.get(at).filter(|(other, _)| *other == key).map(|(_, index)| *index)
}

fn check(message: &Message, frame: &CanFrame) -> Check {
    let (declared, len) = (usize::from(message.length), frame.data().len());
    if len < declared {
        Check::Short
    } else if len == declared || (frame.flags.has(CanFlags::FD) && fd_length(declared) == len) {
        Check::Exact
    } else {
        Check::Long
    }
}

/// The shortest CAN FD frame that carries `len` bytes (ISO 11898-1: above 8 not every length exists).
fn fd_length(len: usize) -> usize {
    const LONGER: [usize; 7] = [12, 16, 20, 24, 32, 48, 64];
    if len <= 8 { len } else { LONGER.into_iter().find(|fits| len <= *fits).unwrap_or(len) }
}
