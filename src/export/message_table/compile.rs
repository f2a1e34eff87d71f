//! What columns the tables of a channel have, by the schema of its messages.

use std::collections::BTreeMap;
use std::rc::Rc;

use prost_reflect::{FieldDescriptor, Kind as ProtoKind, MessageDescriptor};

use super::{Described, Element, Form, MessagePlan, Place, Rows, Step};
use crate::export::table::{Column, Kind, Table, make_unique};
use crate::recording::descriptor;

/// So deep messages inside of messages are followed.
const DEEPEST: usize = 4;
/// So many columns a table has at most.
const MOST_COLUMNS: usize = 1 << 14;
/// So many fields of a message may repeat.
const MOST_LISTS: usize = 256;

/// How rows are made, and the tables they belong to: that of the messages themselves, and one for
/// each field that repeats. Without those of which nothing is `wanted`; none at all when the type is
/// not described. Lists inside of lists have no table.
pub fn compile(
    described: &Described<'_>,
    wanted: impl Fn(&str) -> bool,
) -> Vec<(MessagePlan, Table)> {
    let pool = descriptor::types(described.descriptor);
    let Some(root) = pool.and_then(|pool| pool.get_message_by_name(described.schema)) else {
        return Vec::new();
    };
    let metadata = described.metadata;
    let mut compiler =
        Compiler { metadata, wanted: &wanted, columns: Vec::new(), lists: Vec::new() };
    let step = compiler.step(&root, &Prefix::default());
    let Compiler { columns, lists, .. } = compiler;
    let table = Table {
        bus: described.bus.to_owned(),
        message: described.message.to_owned(),
        comment: metadata.get("comment").cloned().unwrap_or_default(),
        facts: facts(metadata),
        columns,
        ..Table::default()
    };
    let inside = lists.into_iter().filter_map(|list| list.compile(&table, metadata, &wanted));
    let inside: Vec<_> = inside.collect();
    let whole = (!table.columns.is_empty()).then(|| finished(Rows::One(step), table));
    whole.into_iter().chain(inside).collect()
}

fn facts(metadata: &BTreeMap<String, String>) -> Vec<(String, String)> {
    let known = ["id", "pgn", "cycle_ms", "sender", "protocol"];
    let facts =
        known.iter().filter_map(|key| Some(((*key).to_owned(), metadata.get(*key)?.clone())));
    facts.collect()
}

fn finished(rows: Rows, mut table: Table) -> (MessagePlan, Table) {
    make_unique(&mut table.columns);
    (MessagePlan { rows: Rc::new(rows), columns: table.columns.len() }, table)
}

/// Where a message stands in the one of the channel.
#[derive(Clone, Default)]
struct Prefix {
    /// What the metadata call its fields by, with a dot at the end.
    key: String,
    /// What its columns begin with.
    column: String,
    /// The numbers of the fields that lead to it.
    numbers: Vec<u32>,
}

impl Prefix {
    fn inside(&self, field: &FieldDescriptor) -> Self {
        let mut numbers = self.numbers.clone();
        numbers.push(field.number());
        let with = |text: &str| format!("{text}{}.", field.name());
        Self { key: with(&self.key), column: with(&self.column), numbers }
    }
}

/// A field that repeats.
struct List {
    field: FieldDescriptor,
    at: Prefix,
}

impl List {
    /// How its elements become rows, and of which table; `of` is that of the message.
    fn compile(
        self,
        of: &Table,
        metadata: &BTreeMap<String, String>,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Option<(MessagePlan, Table)> {
        let count =
            Column { name: "index".to_owned(), kind: Kind::Unsigned(32), ..Column::default() };
        let mut compiler = Compiler { metadata, wanted, columns: vec![count], lists: Vec::new() };
        let inside = self.at.inside(&self.field);
        let element = match self.field.kind() {
            ProtoKind::Message(message) => {
                let at = Prefix { column: String::new(), ..inside.clone() };
                Element::Message(compiler.step(&message, &at))
            }
            kind => {
                let (kind, form) = form_of(&kind)?;
                compiler.column(&self.at, self.field.name(), kind)?;
                Element::Value(form)
            }
        };
        let columns = compiler.columns;
        let name = inside.column.trim_end_matches('.');
        let table = Table {
            message: format!("{}.{name}", of.message),
            columns,
            repeats: true,
            ..of.clone()
        };
        (table.columns.len() > 1).then(|| finished(Rows::Each(inside.numbers, element), table))
    }
}

struct Compiler<'a> {
    metadata: &'a BTreeMap<String, String>,
    wanted: &'a dyn Fn(&str) -> bool,
    columns: Vec<Column>,
    lists: Vec<List>,
}

impl Compiler<'_> {
    fn step(&mut self, message: &MessageDescriptor, at: &Prefix) -> Step {
        let mut step = Step::default();
        let mut columns = BTreeMap::new();
        for field in message.fields().filter(|field| !field.is_map()) {
            if field.is_list() {
                if self.lists.len() < MOST_LISTS {
                    self.lists.push(List { field, at: at.clone() });
                }
                continue;
            }
            let place = match field.kind() {
                ProtoKind::Message(inner) if at.numbers.len() < DEEPEST => {
                    Place::Message(self.step(&inner, &at.inside(&field)))
                }
                ProtoKind::Message(_) | ProtoKind::Enum(_) => continue,
                kind => {
                    let Some((kind, form)) = form_of(&kind) else { continue };
                    let Some(column) = self.column(at, field.name(), kind) else { continue };
                    columns.insert(field.name().to_owned(), column);
                    Place::Value(column, form)
                }
            };
            step.fields.push((field.number(), place));
        }
        for field in message.fields().filter(|field| !field.is_list()) {
            step.fields.extend(self.labels(&field, at, &columns));
        }
        step.fields.sort_unstable_by_key(|(number, _)| *number);
        step
    }

    /// What to do with the twin of a field that has texts for its values.
    fn labels(
        &mut self,
        field: &FieldDescriptor,
        at: &Prefix,
        columns: &BTreeMap<String, usize>,
    ) -> Option<(u32, Place)> {
        let ProtoKind::Enum(values) = field.kind() else { return None };
        let name = field.name().strip_suffix("_label")?;
        let column = *columns.get(name)?;
        let mut numbers = Vec::new();
        let mut texts: Vec<Box<str>> = Vec::new();
        for value in values.values() {
            let text = self.metadata.get(&format!("label.{}{name}.{}", at.key, value.number()));
            let index = u32::try_from(texts.len()).unwrap_or(u32::MAX);
            // Enums below 0 stand on the wire as 64 bits.
            numbers.push((i64::from(value.number()) as u64, index));
            texts.push(text.map_or(value.name(), String::as_str).into());
        }
        numbers.sort_unstable();
        numbers.dedup_by_key(|(number, _)| *number);
        self.columns.get_mut(column)?.labels = Some(texts.into());
        Some((field.number(), Place::Label(column, numbers)))
    }

    /// Adds the column of a field.
    fn column(&mut self, at: &Prefix, field: &str, kind: Kind) -> Option<usize> {
        let fact = |what: &str| self.metadata.get(&format!("{what}.{}{field}", at.key));
        let name = format!("{}{}", at.column, fact("name").map_or(field, String::as_str));
        if !(self.wanted)(&name) || self.columns.len() >= MOST_COLUMNS {
            return None;
        }
        self.columns.push(Column {
            name,
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
        ProtoKind::Fixed32 => (Kind::Unsigned(32), Form::Fixed32),
        ProtoKind::Fixed64 => (Kind::Unsigned(64), Form::Fixed64),
        ProtoKind::Bool => (Kind::Unsigned(1), Form::Unsigned),
        ProtoKind::String => (Kind::Text, Form::Text),
        ProtoKind::Bytes => (Kind::Bytes, Form::Text),
        ProtoKind::Message(_) | ProtoKind::Enum(_) => return None,
    })
}
