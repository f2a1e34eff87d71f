//! The table of a DBC message: its columns, and how frames become rows.

use std::sync::Arc;

use super::table::{Cell, Column, Kind, Row, Table, Value, make_unique};
use crate::decode::can::Value as Decoded;
use crate::decode::dbc::{Message, Number, Signal};
use crate::decode::definition::CanDefinition;
use crate::decode::j1939::Identifier;

/// Labels of signals with up to so many bits are looked up by index.
const DENSE_BITS: u16 = 10;
/// Index of no label.
const UNLABELLED: u32 = u32::MAX;
/// A signal that is not wanted.
const UNWANTED: u32 = u32::MAX;

/// Makes rows of the payloads of one message.
#[derive(Clone, Debug)]
pub struct CanPlan {
    definition: Arc<CanDefinition>,
    message: usize,
    /// By index of the signal: its column, and its labels.
    places: Vec<Place>,
    /// Columns of the addresses in the identifier, source first, of messages that have them.
    addresses: Option<[u32; 2]>,
    columns: usize,
}

/// Columns of messages that have addresses.
pub const ADDRESSES: [&str; 2] = ["source_address", "destination_address"];

/// Bytes of the identifier, the lowest first, behind the data of messages that have addresses.
pub const IDENTIFIER: usize = 4;

#[derive(Clone, Debug)]
struct Place {
    column: u32,
    labels: Lookup,
    whole: Option<Whole>,
}

/// A scaled signal all of whose values are integers.
#[derive(Clone, Copy, Debug)]
struct Whole {
    factor: i64,
    offset: i64,
    /// Bits above the sign of a signed one, 0 for others.
    unused: u16,
    /// Values, not raw ones, that can be below 0.
    signed: bool,
    /// Bits that the values need.
    bits: u8,
}

/// From raw values to indices of labels.
#[derive(Clone, Debug)]
enum Lookup {
    None,
    Dense(Box<[u32]>),
    /// In the signal's own table.
    Search,
}

impl CanPlan {
    /// How rows are made of message number `index`, and the table they belong to. `None` when the
    /// message has no signal that is `wanted`. With `addresses` it has columns for those of J1939,
    /// and payloads end with the [`IDENTIFIER`].
    pub fn new(
        definition: &Arc<CanDefinition>,
        index: usize,
        bus: &str,
        addresses: bool,
        wanted: impl Fn(&str) -> bool,
    ) -> Option<(Self, Table)> {
        let message = definition.messages().get(index)?;
        let mut columns = Vec::new();
        let mut places = Vec::with_capacity(message.signals.len());
        for signal in &message.signals {
            let wanted = wanted(&signal.name);
            let column = if wanted { u32::try_from(columns.len()).ok()? } else { UNWANTED };
            let whole = Whole::of(signal);
            places.push(Place { column, labels: Lookup::of(signal), whole });
            if wanted {
                columns.push(column_of(signal, whole));
            }
        }
        let addresses = addresses.then(|| {
            ADDRESSES.map(|name| {
                if !wanted(name) {
                    return UNWANTED;
                }
                let kind = Kind::Unsigned(8);
                columns.push(Column {
                    name: name.to_owned(),
                    kind,
                    few_values: true,
                    ..Column::default()
                });
                u32::try_from(columns.len() - 1).unwrap_or(UNWANTED)
            })
        });
        if columns.is_empty() {
            return None;
        }
        make_unique(&mut columns);
        let plan = Self {
            definition: Arc::clone(definition),
            message: index,
            places,
            addresses,
            columns: columns.len(),
        };
        Some((plan, table_of(message, bus, columns)))
    }

    /// Gives each value that is in a payload to `visit`, with its column.
    #[inline]
    pub fn visit(&self, payload: &[u8], mut visit: impl FnMut(usize, Cell)) {
        let (data, id) = match (self.addresses, payload.split_last_chunk::<IDENTIFIER>()) {
            (Some(_), Some((data, id))) => (data, Some(u32::from_le_bytes(*id))),
            _ => (payload, None),
        };
        let signals = self.definition.messages().get(self.message);
        let signals = signals.map_or(&[][..], |message| &message.signals);
        self.definition.decode(self.message, data, |reading| {
            let Some(place) = self.places.get(reading.signal) else { return };
            if place.column == UNWANTED {
                return;
            }
            let label = match &place.labels {
                Lookup::None => None,
                Lookup::Dense(labels) => {
                    let label = usize::try_from(reading.raw).ok().and_then(|raw| labels.get(raw));
                    label.copied().filter(|label| *label != UNLABELLED)
                }
                Lookup::Search => {
                    let index =
                        signals.get(reading.signal).and_then(|s| s.label_index(reading.raw));
                    index.and_then(|index| u32::try_from(index).ok())
                }
            };
            let value = match reading.value {
                Decoded::Float(_) if place.whole.is_some() => {
                    place.whole.map_or(Value::Absent, |whole| whole.value(reading.raw))
                }
                Decoded::Unsigned(number) => Value::Unsigned(number),
                Decoded::Signed(number) => Value::Signed(number),
                Decoded::Float(number) => Value::Float(number),
            };
            visit(place.column as usize, Cell { value, label });
        });
        if let (Some(columns), Some(id)) = (self.addresses, id) {
            let id = Identifier::of(id);
            for (column, address) in columns.into_iter().zip([Some(id.source), id.destination]) {
                if let (true, Some(address)) = (column != UNWANTED, address) {
                    let value = Value::Unsigned(address.into());
                    visit(column as usize, Cell { value, label: None });
                }
            }
        }
    }

    /// A row of a payload.
    pub fn row(&self, payload: &[u8], row: &mut Row) {
        row.clear(self.columns);
        let cells = &mut row.cells;
        self.visit(payload, |column, cell| {
            if let Some(place) = cells.get_mut(column) {
                *place = cell;
            }
        });
    }
}

impl Whole {
    fn of(signal: &Signal) -> Option<Self> {
        let signed = match signal.number {
            Number::Unsigned => false,
            Number::Signed => true,
            Number::Float32 | Number::Float64 => return None,
        };
        let (factor, offset) = (integer(signal.factor)?, integer(signal.offset)?);
        if (factor, offset) == (1, 0) {
            return None;
        }
        let span = 1_i128 << (signal.length - u16::from(signed));
        let ends = if signed { [-span, span - 1] } else { [0, span - 1] };
        let [a, b] = ends.map(|raw| raw * i128::from(factor) + i128::from(offset));
        let (least, largest) = (a.min(b), a.max(b));
        let needed = |number: i128| 128 - if number < 0 { !number } else { number }.leading_zeros();
        let below = least < 0;
        let bits = needed(least).max(needed(largest)).max(1) + u32::from(below);
        let bits = u8::try_from(bits).ok().filter(|bits| *bits <= 64)?;
        let unused = if signed { 64 - signal.length } else { 0 };
        Some(Self { factor, offset, unused, signed: below, bits })
    }

    /// The value of raw bits. What wraps comes out right, since it is known to fit.
    #[inline]
    fn value(self, raw: u64) -> Value {
        let raw = ((raw << self.unused) as i64) >> self.unused;
        let value = raw.wrapping_mul(self.factor).wrapping_add(self.offset);
        if self.signed { Value::Signed(value) } else { Value::Unsigned(value as u64) }
    }
}

/// The integer that a float is, if it is one that floats have exactly.
fn integer(number: f64) -> Option<i64> {
    #[allow(clippy::cast_possible_truncation, reason = "the range is checked")]
    (number.fract() == 0.0 && number.abs() <= 9e15).then_some(number as i64)
}

impl Lookup {
    fn of(signal: &Signal) -> Self {
        if signal.labels.is_none() {
            return Self::None;
        }
        if signal.length > DENSE_BITS {
            return Self::Search;
        }
        let index = |raw| signal.label_index(raw).and_then(|index| u32::try_from(index).ok());
        Self::Dense((0..1_u64 << signal.length).map(|r| index(r).unwrap_or(UNLABELLED)).collect())
    }
}

fn table_of(message: &Message, bus: &str, columns: Vec<Column>) -> Table {
    let mut facts = vec![("id".to_owned(), id_text(message))];
    if !message.senders.is_empty() {
        facts.push(("senders".to_owned(), message.senders.join(" ")));
    }
    if message.cycle_time > 0 {
        facts.push(("cycle_time_ms".to_owned(), message.cycle_time.to_string()));
    }
    Table {
        bus: bus.to_owned(),
        message: message.name.clone(),
        comment: message.comment.clone(),
        facts,
        columns,
        repeats: false,
    }
}

/// As candump writes it: 3 digits are 11 bits, 8 are 29.
fn id_text(message: &Message) -> String {
    if message.extended { format!("{:08X}", message.id) } else { format!("{:03X}", message.id) }
}

fn column_of(signal: &Signal, whole: Option<Whole>) -> Column {
    let scaled = signal.factor != 1.0 || signal.offset != 0.0;
    let bits = u8::try_from(signal.length).unwrap_or(64);
    let kind = match (signal.number, whole) {
        (_, Some(Whole { signed: true, bits, .. })) => Kind::Signed(bits),
        (_, Some(Whole { bits, .. })) => Kind::Unsigned(bits),
        _ if scaled => Kind::Float64,
        (Number::Unsigned, _) => Kind::Unsigned(bits),
        (Number::Signed, _) => Kind::Signed(bits),
        (Number::Float32, _) => Kind::Float32,
        (Number::Float64, _) => Kind::Float64,
    };
    let labels = signal.labels.as_ref();
    Column {
        name: signal.name.clone(),
        kind,
        few_values: bits <= 8,
        unit: signal.unit.clone(),
        comment: signal.comment.clone(),
        labels: labels.map(|labels| labels.iter().map(|(_, text)| text.clone()).collect()),
    }
}
