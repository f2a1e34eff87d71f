//! The tables of a decoded channel: how its messages become rows.

mod compile;

use std::collections::BTreeMap;
use std::rc::Rc;

use super::table::{Row, Value};
use crate::recording::wire::{Field, Fields, take_varint};

pub use compile::compile;

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

/// Makes rows of the messages of one channel: of a message one, or one of each element of something
/// that repeats in it.
#[derive(Clone, Debug)]
pub struct MessagePlan {
    rows: Rc<Rows>,
    columns: usize,
}

/// Where the rows of a message come from.
#[derive(Debug)]
enum Rows {
    /// The message itself.
    One(Step),
    /// A field that repeats: the numbers of the fields that lead to it. Its first column counts.
    Each(Vec<u32>, Element),
}

/// One of what repeats.
#[derive(Debug)]
enum Element {
    /// A number or text.
    Value(Form),
    /// A message.
    Message(Step),
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
    Fixed32,
    Fixed64,
    FixedSigned32,
    FixedSigned64,
    Float,
    Double,
    Text,
}

impl MessagePlan {
    /// Gives each row of an encoded message to `visit`; `row` is room for one. Where its bytes are
    /// not a message, the values from there on are absent.
    pub fn rows(&self, message: &[u8], row: &mut Row, mut visit: impl FnMut(&Row)) {
        match &*self.rows {
            Rows::One(step) => {
                row.clear(self.columns);
                fill(step, message, row);
                visit(row);
            }
            Rows::Each(path, element) => {
                let mut index = 0;
                each(path, message, &mut |field| {
                    let mut begin = |row: &mut Row| {
                        row.clear(self.columns);
                        if let Some(first) = row.cells.first_mut() {
                            first.value = Value::Unsigned(index);
                        }
                        index += 1;
                    };
                    match (element, field) {
                        (Element::Message(step), Field::Bytes(bytes)) => {
                            begin(row);
                            fill(step, bytes, row);
                            visit(row);
                        }
                        (Element::Message(_), _) => {}
                        (Element::Value(form), field) => unpack(*form, field, &mut |field| {
                            begin(row);
                            put(row, 1, *form, field);
                            visit(row);
                        }),
                    }
                });
            }
        }
    }
}

/// Gives each field at the end of `path` to `visit`.
fn each(path: &[u32], message: &[u8], visit: &mut dyn FnMut(Field<'_>)) {
    let Some((first, rest)) = path.split_first() else { return };
    for (_, field) in Fields::of(message).filter(|(number, _)| number == first) {
        match field {
            Field::Bytes(inside) if !rest.is_empty() => each(rest, inside, visit),
            field if rest.is_empty() => visit(field),
            _ => {}
        }
    }
}

/// Gives each number of a field that may have many of them packed to `visit`.
fn unpack(form: Form, field: Field<'_>, visit: &mut dyn FnMut(Field<'_>)) {
    let Field::Bytes(mut rest) = field else { return visit(field) };
    let fixed = match form {
        Form::Text => return visit(Field::Bytes(rest)),
        Form::Unsigned | Form::Signed | Form::Zigzag => 0,
        Form::Fixed32 | Form::FixedSigned32 | Form::Float => 4,
        Form::Fixed64 | Form::FixedSigned64 | Form::Double => 8,
    };
    if fixed == 0 {
        while let Some(number) = take_varint(&mut rest) {
            visit(Field::Uint(number));
        }
        return;
    }
    for bytes in rest.chunks_exact(fixed) {
        let number = bytes.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte));
        visit(Field::Fixed(number));
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
        (Form::Unsigned, Field::Uint(number))
        | (Form::Fixed32 | Form::Fixed64, Field::Fixed(number)) => Value::Unsigned(number),
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
