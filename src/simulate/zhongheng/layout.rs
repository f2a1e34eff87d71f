//! How a command's data are laid out, and how the slave fills them.
//!
//! Fields follow each other without padding; numbers are sent high byte first (Zhongheng 09-series
//! RS232 protocol, section 6.2, where this is an assumption for all data).

use super::plant::Plant;
use super::readings_table::READINGS;
use super::settings_table::SETTINGS;

/// Type of a field on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the document's")]
pub enum Kind {
    U8,
    U16,
    U32,
    F32,
    /// That many characters, filled up with NUL.
    Text(u8),
    /// That many bytes.
    Bytes(u8),
}

/// Where a field's value comes from.
#[derive(Clone, Copy)]
pub enum Value {
    /// Always this: a setting as it left the factory, or something that does not change.
    Is(f64),
    /// One text a record.
    Names(&'static [&'static str]),
    /// Looked up in the plant. The number is the record, the element of an array, or the position
    /// the request asks for.
    Live(fn(&Plant, usize) -> f64),
}

/// What the document calls enable and disable.
pub const ENABLED: Value = Value::Is(20.0);
/// See [`ENABLED`].
pub const DISABLED: Value = Value::Is(21.0);

/// One field, or an array of equal ones.
#[derive(Clone, Copy)]
pub struct Field {
    /// Name, as in the protocol's tables.
    pub name: &'static str,
    /// Type on the line.
    pub kind: Kind,
    /// How many follow each other; 1 for most.
    pub count: u8,
    /// Where the value comes from.
    pub value: Value,
}

/// One command.
#[derive(Clone, Copy)]
pub struct Command {
    /// CmdID without the CT bit.
    pub id: u16,
    /// Name, as in the protocol's tables.
    pub name: &'static str,
    /// True if it can be set as well as read.
    pub settable: bool,
    /// `Some(n)`: the fields are one record, and this slave has n of them.
    pub records: Option<u8>,
    /// The fields, in order.
    pub fields: &'static [Field],
}

/// All 32 commands.
pub fn commands() -> impl Iterator<Item = &'static Command> {
    READINGS.iter().chain(SETTINGS)
}

/// The command with CmdID `id`. 0x414f is the alarm list too: the document names it both ways (Z1).
pub fn command(id: u16) -> Option<&'static Command> {
    let id = if id == 0x414F { 0x414B } else { id };
    commands().find(|command| command.id == id)
}

impl Command {
    /// Bytes of one record, or of the whole when there are no records.
    pub fn record_length(&self) -> usize {
        self.fields.iter().map(Field::length).sum()
    }

    /// The data, from the plant and the factory settings; `position` is what 0x40ec asks for.
    pub fn fill(&self, plant: &Plant, position: usize) -> Vec<u8> {
        let mut data = Vec::new();
        for record in 0..usize::from(self.records.unwrap_or(1)) {
            for field in self.fields {
                for element in 0..usize::from(field.count) {
                    field.fill(plant, record + element + position, &mut data);
                }
            }
        }
        data
    }

    /// True if `length` bytes are a complete set of this command.
    pub fn accepts(&self, length: usize) -> bool {
        let record = self.record_length();
        match self.records {
            None => length == record,
            Some(_) => length > 0 && length.is_multiple_of(record),
        }
    }

    /// The value of the number `name` in `data`.
    pub fn number(&self, name: &str, data: &[u8]) -> Option<f64> {
        let mut at = 0;
        for field in self.fields {
            if field.name == name {
                let bytes = data.get(at..at + field.kind.length())?;
                return field.kind.read(bytes);
            }
            at += field.length();
        }
        None
    }
}

impl Field {
    /// Bytes on the line.
    pub fn length(&self) -> usize {
        self.kind.length() * usize::from(self.count)
    }

    fn fill(&self, plant: &Plant, index: usize, data: &mut Vec<u8>) {
        let (number, text) = match self.value {
            Value::Is(number) => (number, ""),
            Value::Live(look) => (look(plant, index), ""),
            Value::Names(names) => (0.0, names.get(index).copied().unwrap_or_default()),
        };
        // `as` keeps within the range of the type.
        match self.kind {
            Kind::U8 => data.push(number as u8),
            Kind::U16 => data.extend((number as u16).to_be_bytes()),
            Kind::U32 => data.extend((number as u32).to_be_bytes()),
            Kind::F32 => data.extend((number as f32).to_be_bytes()),
            Kind::Text(length) | Kind::Bytes(length) => {
                let characters = text.bytes().chain(std::iter::repeat(0));
                data.extend(characters.take(usize::from(length)));
            }
        }
    }
}

impl Kind {
    fn length(self) -> usize {
        match self {
            Kind::U8 => 1,
            Kind::U16 => 2,
            Kind::U32 | Kind::F32 => 4,
            Kind::Text(length) | Kind::Bytes(length) => usize::from(length),
        }
    }

    fn read(self, bytes: &[u8]) -> Option<f64> {
        match (self, bytes) {
            (Kind::U8, [a]) => Some(f64::from(*a)),
            (Kind::U16, [a, b]) => Some(f64::from(u16::from_be_bytes([*a, *b]))),
            (Kind::U32, [a, b, c, d]) => Some(f64::from(u32::from_be_bytes([*a, *b, *c, *d]))),
            (Kind::F32, [a, b, c, d]) => Some(f64::from(f32::from_be_bytes([*a, *b, *c, *d]))),
            _ => None,
        }
    }
}

// What the tables are written with.

pub(super) const fn u8(name: &'static str, value: Value) -> Field {
    Field { name, kind: Kind::U8, count: 1, value }
}

pub(super) const fn u16(name: &'static str, value: Value) -> Field {
    Field { name, kind: Kind::U16, count: 1, value }
}

pub(super) const fn u32(name: &'static str, value: Value) -> Field {
    Field { name, kind: Kind::U32, count: 1, value }
}

pub(super) const fn f32(name: &'static str, value: Value) -> Field {
    Field { name, kind: Kind::F32, count: 1, value }
}

pub(super) const fn text(name: &'static str, length: u8, value: Value) -> Field {
    Field { name, kind: Kind::Text(length), count: 1, value }
}

pub(super) const fn bytes(name: &'static str, length: u8, value: Value) -> Field {
    Field { name, kind: Kind::Bytes(length), count: 1, value }
}

/// Bytes that follow each other; the document names each of them.
pub(super) const fn array(name: &'static str, count: u8, value: Value) -> Field {
    Field { name, kind: Kind::U8, count, value }
}

pub(super) const fn read(id: u16, name: &'static str, fields: &'static [Field]) -> Command {
    Command { id, name, settable: false, records: None, fields }
}

pub(super) const fn set(id: u16, name: &'static str, fields: &'static [Field]) -> Command {
    Command { id, name, settable: true, records: None, fields }
}

pub(super) const fn read_records(
    id: u16,
    name: &'static str,
    records: u8,
    fields: &'static [Field],
) -> Command {
    Command { id, name, settable: false, records: Some(records), fields }
}

pub(super) const fn set_records(
    id: u16,
    name: &'static str,
    records: u8,
    fields: &'static [Field],
) -> Command {
    Command { id, name, settable: true, records: Some(records), fields }
}
