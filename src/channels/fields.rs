//! Fields of serial commands, and of messages of several CAN frames: shape and encoding.

use super::encoder::{integer_kind, whole_number, zigzag};
use super::shape::{Field, Kind, Shape, numbers};
use crate::protocol::payload::{FieldPlan, FieldType, Value};
use crate::protocol::word::{Quantity, Reading, Values};
use crate::recording::wire;

/// A message being encoded: puts the fields of its shape by their places.
pub struct Encoder {
    shape: Shape,
    numbers: Vec<(u32, Option<u32>)>,
}

impl Encoder {
    /// That of messages that look like `shape`.
    pub fn new(shape: Shape) -> Self {
        let labelled: Vec<bool> = shape.fields.iter().map(|f| !f.labels.is_empty()).collect();
        Self { numbers: numbers(&labelled), shape }
    }

    /// What it encodes.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    fn number(&self, at: usize) -> Option<(u32, Option<u32>)> {
        self.numbers.get(at).copied()
    }

    /// Puts a number without sign.
    pub fn uint(&self, at: usize, value: u64, out: &mut Vec<u8>) {
        if let Some((number, _)) = self.number(at) {
            put_varint(out, number, value);
        }
    }

    /// Puts bytes or a text.
    pub fn bytes(&self, at: usize, value: &[u8], out: &mut Vec<u8>) {
        if let Some((number, _)) = self.number(at) {
            put_bytes(out, number, value);
        }
    }

    /// Puts a number of a header, and its name if it has one.
    pub fn reading(&self, at: usize, reading: &Reading, out: &mut Vec<u8>) {
        self.uint(at, reading.value, out);
        if reading.label().is_some() {
            self.label(at, reading.value, out);
        }
    }

    fn label(&self, at: usize, value: u64, out: &mut Vec<u8>) {
        // An enum has numbers up to 31 bits.
        if let (Some((_, Some(label))), Ok(_)) = (self.number(at), i32::try_from(value)) {
            put_varint(out, label, value);
        }
    }

    /// Puts a value, and in its twin at `twin` what the value itself cannot show.
    pub fn value(
        &self,
        at: usize,
        twin: usize,
        plan: &FieldPlan,
        value: &Value,
        out: &mut Vec<u8>,
    ) {
        let Some((number, _)) = self.number(at) else { return };
        let kind = self.shape.fields.get(at).map(|field| &field.kind);
        match (value, plan.scale) {
            (Value::Text(bytes), _) => match value.text() {
                Some(text) => put_bytes(out, number, text.as_bytes()),
                None => self.bytes(twin, bytes, out),
            },
            (Value::Bytes(bytes), _) => put_bytes(out, number, bytes),
            (_, Some((scale, offset))) => {
                let scaled = value.number().unwrap_or(f64::NAN) * scale + offset;
                put_scaled(out, number, kind, scaled);
            }
            (Value::Unsigned(value), None) => put_varint(out, number, *value),
            (Value::Signed(value), None) => put_varint(out, number, zigzag(*value)),
            (Value::F32(bits), None) => put_fixed(out, number, wire::FIXED32, &bits.to_le_bytes()),
            (Value::F64(bits), None) => put_fixed(out, number, wire::FIXED64, &bits.to_le_bytes()),
        }
        let Value::Unsigned(raw) = value else { return };
        if plan.values.as_ref().is_some_and(|values| values.contains_key(raw)) {
            self.label(at, *raw, out);
        }
        if let Some(flags) = &plan.flags {
            let mut inside = Vec::new();
            for (number, mask) in (1..).zip(flags.keys()) {
                put_varint(&mut inside, number, u64::from(raw & mask == *mask));
            }
            self.bytes(twin, &inside, out);
        }
    }
}

/// A number of a header, by its name.
pub fn of_quantity(quantity: &Quantity) -> Field {
    let labels = quantity.values.as_ref().map_or(Vec::new(), |values| labels(values));
    Field::new(&*quantity.name, Kind::Uint32).labelled(labels)
}

/// A field, and its twin if it needs one: the bits of flags, the bytes of what is no text.
pub fn of_plan(plan: &FieldPlan) -> (Field, Option<Field>) {
    let mut field = Field::new(&*plan.name, kind(plan));
    plan.unit.as_deref().unwrap_or_default().clone_into(&mut field.unit);
    field.labels = plan.values.as_ref().map_or(Vec::new(), |values| labels(values));
    let twin = match (&plan.flags, plan.kind) {
        (Some(flags), _) => {
            let bits = flags.values().map(|name| Field::new(&**name, Kind::Bool)).collect();
            let name = format!("{}_flags", plan.name);
            Some(Field::new(name, Kind::Message(Shape { fields: bits })))
        }
        (None, FieldType::Text) => Some(Field::new(format!("{}_bytes", plan.name), Kind::Bytes)),
        (None, _) => None,
    };
    (field, twin)
}

fn labels(values: &Values) -> Vec<(i128, String)> {
    values.iter().map(|(value, name)| (i128::from(*value), name.to_string())).collect()
}

fn kind(plan: &FieldPlan) -> Kind {
    let bits = u32::try_from(plan.size.unwrap_or(8).min(8)).unwrap_or(8) * 8;
    let whole = plan.scale.map(|(scale, offset)| {
        let (scale, offset) = (whole_number(scale)?, whole_number(offset)?);
        let span = 1_i128 << bits;
        let ends = match plan.kind {
            FieldType::Unsigned => [0, span - 1],
            FieldType::Signed => [-span / 2, span / 2 - 1],
            FieldType::Float | FieldType::Text | FieldType::Bytes => return None,
        };
        let [a, b] = ends.map(|raw| raw * i128::from(scale) + i128::from(offset));
        // Larger ones are no integers once they have been scaled.
        let exact = a.abs().max(b.abs()) < 1 << 53;
        integer_kind(a.min(b), a.max(b)).filter(|_| exact)
    });
    match (plan.kind, whole) {
        (FieldType::Text, _) => Kind::Text,
        (FieldType::Bytes, _) => Kind::Bytes,
        (_, Some(whole)) => whole.unwrap_or(Kind::Double),
        (FieldType::Unsigned, None) if bits <= 32 => Kind::Uint32,
        (FieldType::Unsigned, None) => Kind::Uint64,
        (FieldType::Signed, None) if bits <= 32 => Kind::Sint32,
        (FieldType::Signed, None) => Kind::Sint64,
        (FieldType::Float, None) if bits <= 32 => Kind::Float,
        (FieldType::Float, None) => Kind::Double,
    }
}

#[allow(clippy::cast_possible_truncation, reason = "the kind was chosen so that all values fit")]
fn put_scaled(out: &mut Vec<u8>, number: u32, kind: Option<&Kind>, scaled: f64) {
    match kind {
        Some(Kind::Uint32 | Kind::Uint64) => put_varint(out, number, scaled as u64),
        Some(Kind::Sint32 | Kind::Sint64) => put_varint(out, number, zigzag(scaled as i64)),
        _ => put_fixed(out, number, wire::FIXED64, &scaled.to_bits().to_le_bytes()),
    }
}

/// Unlike [`wire::put_uint`] also writes 0: what is not written is absent.
fn put_varint(out: &mut Vec<u8>, number: u32, value: u64) {
    wire::put_varint(out, u64::from(number << 3 | wire::VARINT));
    wire::put_varint(out, value);
}

/// Also writes no bytes at all: what is not written is absent.
fn put_bytes(out: &mut Vec<u8>, number: u32, bytes: &[u8]) {
    wire::put_varint(out, u64::from(number << 3 | wire::BYTES));
    wire::put_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

fn put_fixed(out: &mut Vec<u8>, number: u32, wire_type: u32, bytes: &[u8]) {
    wire::put_varint(out, u64::from(number << 3 | wire_type));
    out.extend_from_slice(bytes);
}
