//! The table of a decoded channel: its columns by the schema of its messages, compiled once.

use std::collections::BTreeMap;
use std::rc::Rc;

use prost_reflect::{DescriptorPool, Kind as ProtoKind, MessageDescriptor};

use super::table::{Column, Kind, Row, Table, Value, make_unique};
use crate::recording::wire::{Field, Fields};

/// So deep messages inside of messages are followed.
const DEEPEST: usize = 4;
/// So many columns a table has at most.
const MOST_COLUMNS: usize = 1 << 14;

/// A decoded channel, as the recording describes it.
#[derive(Clone, Copy, Debug)]
pub struct Described<'a> {
    /// Name of the bus.
    pub bus: &'a str,
    /// Name of the message.
    pub message: &'a str,
    /// Name of its type.
    pub schema: &'a str,
    /// A `google.protobuf.FileDescriptorSet`.
    pub descriptor: &'a [u8],
    /// `unit.<field>`, `name.<field>`, `label.<field>.<value>`, `id`, `comment` and so on.
    pub metadata: &'a BTreeMap<String, String>,
}

/// Makes rows of the messages of one channel.
#[derive(Clone, Debug)]
pub struct MessagePlan {
    root: Rc<Step>,
    columns: usize,
}

/// What to do with the fields of one message type.
#[derive(Clone, Debug, Default)]
struct Step {
    /// By number of the field, sorted.
    fields: Vec<(u32, Place)>,
}

#[derive(Clone, Debug)]
enum Place {
    /// A number or text of a column.
    Value(usize, Form),
    /// The label of a column: numbers of the enum and indices of texts, sorted.
    Label(usize, Vec<(u64, u32)>),
    /// A message inside.
    Message(Step),
}

/// How a value stands on the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Unsigned,
    Signed,
    Zigzag,
    Fixed,
    FixedSigned32,
    FixedSigned64,
    Float,
    Double,
    Text,
}

impl MessagePlan {
    /// How rows are made, and the table they belong to. `None` when the type is not described, or
    /// has no field that is `wanted`.
    pub fn new(described: &Described<'_>, wanted: impl Fn(&str) -> bool) -> Option<(Self, Table)> {
        let pool = DescriptorPool::decode(described.descriptor).ok()?;
        let root = pool.get_message_by_name(described.schema)?;
        let mut compiler =
            Compiler { metadata: described.metadata, wanted: &wanted, columns: Vec::new() };
        let step = compiler.step(&root, "", 0);
        let mut columns = compiler.columns;
        if columns.is_empty() {
            return None;
        }
        make_unique(&mut columns);
        let plan = Self { root: Rc::new(step), columns: columns.len() };
        let known = ["id", "pgn", "cycle_ms", "sender", "protocol"];
        let facts = known.iter().filter_map(|key| {
            let text = described.metadata.get(*key)?;
            Some(((*key).to_owned(), text.clone()))
        });
        let table = Table {
            bus: described.bus.to_owned(),
            message: described.message.to_owned(),
            comment: described.metadata.get("comment").cloned().unwrap_or_default(),
            facts: facts.collect(),
            columns,
        };
        Some((plan, table))
    }

    /// A row of an encoded message. Where its bytes are not one, the values from there on are absent.
    pub fn row(&self, message: &[u8], row: &mut Row) {
        row.clear(self.columns);
        fill(&self.root, message, row);
    }
}

fn fill(step: &Step, message: &[u8], row: &mut Row) {
    for (number, field) in Fields::of(message) {
        let Ok(at) = step.fields.binary_search_by_key(&number, |(number, _)| *number) else {
            continue;
        };
        match (&step.fields[at].1, field) {
            (Place::Value(column, form), field) => put(row, *column, *form, field),
            (Place::Label(column, labels), Field::Uint(value)) => {
                let found = labels.binary_search_by_key(&value, |(value, _)| *value).ok();
                if let (Some(found), Some(cell)) = (found, row.cells.get_mut(*column)) {
                    cell.label = labels.get(found).map(|(_, index)| *index);
                }
            }
            (Place::Message(step), Field::Bytes(bytes)) => fill(step, bytes, row),
            _ => {}
        }
    }
}

#[allow(clippy::cast_possible_truncation, reason = "fields of 32 bits")]
fn put(row: &mut Row, column: usize, form: Form, field: Field<'_>) {
    let value = match (form, field) {
        (Form::Unsigned, Field::Uint(number)) | (Form::Fixed, Field::Fixed(number)) => {
            Value::Unsigned(number)
        }
        (Form::Signed, Field::Uint(number)) | (Form::FixedSigned64, Field::Fixed(number)) => {
            Value::Signed(number as i64)
        }
        (Form::Zigzag, Field::Uint(number)) => {
            Value::Signed((number >> 1) as i64 ^ -((number & 1) as i64))
        }
        (Form::FixedSigned32, Field::Fixed(number)) => Value::Signed(i64::from(number as i32)),
        (Form::Float, Field::Fixed(bits)) => Value::Float(f32::from_bits(bits as u32).into()),
        (Form::Double, Field::Fixed(bits)) => Value::Float(f64::from_bits(bits)),
        (Form::Text, Field::Bytes(bytes)) => {
            row.push_bytes(bytes);
            row.cells.pop().unwrap_or_default().value
        }
        _ => return,
    };
    if let Some(cell) = row.cells.get_mut(column) {
        cell.value = value;
    }
}

struct Compiler<'a> {
    metadata: &'a BTreeMap<String, String>,
    wanted: &'a dyn Fn(&str) -> bool,
    columns: Vec<Column>,
}

impl Compiler<'_> {
    fn step(&mut self, message: &MessageDescriptor, path: &str, depth: usize) -> Step {
        let mut step = Step::default();
        let mut columns = BTreeMap::new();
        let fields = || message.fields().filter(|field| !field.is_list() && !field.is_map());
        for field in fields() {
            let name = format!("{path}{}", field.name());
            let place = match field.kind() {
                ProtoKind::Message(inner) if depth < DEEPEST => {
                    Place::Message(self.step(&inner, &format!("{name}."), depth + 1))
                }
                ProtoKind::Message(_) | ProtoKind::Enum(_) => continue,
                kind => {
                    let Some((kind, form)) = form_of(&kind) else { continue };
                    let Some(column) = self.column(&name, kind) else { continue };
                    columns.insert(field.name().to_owned(), column);
                    Place::Value(column, form)
                }
            };
            step.fields.push((field.number(), place));
        }
        for field in fields() {
            let ProtoKind::Enum(values) = field.kind() else { continue };
            let of = field.name().strip_suffix("_label").and_then(|name| columns.get(name));
            let Some(&column) = of else { continue };
            let path = format!("{path}{}", field.name().trim_end_matches("_label"));
            let mut numbers = Vec::new();
            let mut texts: Vec<Box<str>> = Vec::new();
            for value in values.values() {
                let text = self.metadata.get(&format!("label.{path}.{}", value.number()));
                let text = text.map_or(value.name(), String::as_str);
                let index = u32::try_from(texts.len()).unwrap_or(u32::MAX);
                // Enums below 0 stand on the wire as 64 bits.
                numbers.push((i64::from(value.number()) as u64, index));
                texts.push(text.into());
            }
            numbers.sort_unstable();
            numbers.dedup_by_key(|(number, _)| *number);
            if let Some(column) = self.columns.get_mut(column) {
                column.labels = Some(texts.into());
            }
            step.fields.push((field.number(), Place::Label(column, numbers)));
        }
        step.fields.sort_unstable_by_key(|(number, _)| *number);
        step
    }

    fn column(&mut self, path: &str, kind: Kind) -> Option<usize> {
        let fact = |what: &str| self.metadata.get(&format!("{what}.{path}"));
        let name = fact("name").map_or(path, String::as_str);
        if !(self.wanted)(name) || self.columns.len() >= MOST_COLUMNS {
            return None;
        }
        self.columns.push(Column {
            name: name.to_owned(),
            kind,
            unit: fact("unit").cloned().unwrap_or_default(),
            few_values: kind == Kind::Unsigned(1),
            ..Column::default()
        });
        Some(self.columns.len() - 1)
    }
}

fn form_of(kind: &ProtoKind) -> Option<(Kind, Form)> {
    Some(match kind {
        ProtoKind::Double => (Kind::Float64, Form::Double),
        ProtoKind::Float => (Kind::Float32, Form::Float),
        ProtoKind::Int32 => (Kind::Signed(32), Form::Signed),
        ProtoKind::Int64 => (Kind::Signed(64), Form::Signed),
        ProtoKind::Sint32 => (Kind::Signed(32), Form::Zigzag),
        ProtoKind::Sint64 => (Kind::Signed(64), Form::Zigzag),
        ProtoKind::Sfixed32 => (Kind::Signed(32), Form::FixedSigned32),
        ProtoKind::Sfixed64 => (Kind::Signed(64), Form::FixedSigned64),
        ProtoKind::Uint32 => (Kind::Unsigned(32), Form::Unsigned),
        ProtoKind::Uint64 => (Kind::Unsigned(64), Form::Unsigned),
        ProtoKind::Fixed32 => (Kind::Unsigned(32), Form::Fixed),
        ProtoKind::Fixed64 => (Kind::Unsigned(64), Form::Fixed),
        ProtoKind::Bool => (Kind::Unsigned(1), Form::Unsigned),
        ProtoKind::String => (Kind::Text, Form::Text),
        ProtoKind::Bytes => (Kind::Bytes, Form::Text),
        ProtoKind::Message(_) | ProtoKind::Enum(_) => return None,
    })
}
