//! The data of a command: fields one behind the other, alone or as records.

use std::sync::Arc;

use super::definition::ByteOrder;
use super::word::{Values, unsigned};

/// What a field is on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// Unsigned number of 1, 2, 4 or 8 bytes.
    Unsigned,
    /// Two's complement number of 1, 2, 4 or 8 bytes.
    Signed,
    /// IEEE 754 number of 4 or 8 bytes.
    Float,
    /// Bytes that are text when they look like it.
    Text,
    /// Bytes.
    Bytes,
}

/// One field of a command.
#[derive(Clone, Debug)]
pub struct FieldPlan {
    /// Its name.
    pub name: Arc<str>,
    /// What it is.
    pub kind: FieldType,
    /// Bytes; `None` for all that are left.
    pub size: Option<usize>,
    /// First byte, counted from the start of the data or of the record.
    pub at: usize,
    /// Byte order.
    pub order: ByteOrder,
    /// Unit, as printed by the source of the definition.
    pub unit: Option<Arc<str>>,
    /// What people call it.
    pub title: Option<Arc<str>>,
    /// The value in its unit is the number times `scale` plus `offset`.
    pub scale: Option<(f64, f64)>,
    /// Names of its values.
    pub values: Option<Arc<Values>>,
    /// Names of its bits, by mask.
    pub flags: Option<Arc<Values>>,
}

impl FieldPlan {
    /// The type's name in a definition: `u8`, `f32`, `text`, ...
    pub fn type_name(&self) -> String {
        let bits = self.size.unwrap_or_default() * 8;
        match self.kind {
            FieldType::Unsigned => format!("u{bits}"),
            FieldType::Signed => format!("i{bits}"),
            FieldType::Float => format!("f{bits}"),
            FieldType::Text => "text".to_owned(),
            FieldType::Bytes => "bytes".to_owned(),
        }
    }

    /// The value of the field's bytes.
    pub fn read(&self, bytes: &[u8]) -> Value {
        let number = || unsigned(bytes, self.order);
        match (self.kind, bytes.len()) {
            (FieldType::Unsigned, _) => Value::Unsigned(number()),
            (FieldType::Signed, size) => {
                let unused = 64 - 8 * u32::try_from(size).unwrap_or(8).min(8);
                Value::Signed(((number() << unused) as i64) >> unused)
            }
            #[allow(clippy::cast_possible_truncation, reason = "4 bytes")]
            (FieldType::Float, 4) => Value::F32(number() as u32),
            (FieldType::Float, _) => Value::F64(number()),
            (FieldType::Text, _) => Value::Text(bytes.to_vec()),
            (FieldType::Bytes, _) => Value::Bytes(bytes.to_vec()),
        }
    }
}

/// A field's value as it was sent.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Unsigned number.
    Unsigned(u64),
    /// Signed number.
    Signed(i64),
    /// Bits of an IEEE 754 single precision number.
    F32(u32),
    /// Bits of an IEEE 754 double precision number.
    F64(u64),
    /// Bytes that may be text.
    Text(Vec<u8>),
    /// Bytes.
    Bytes(Vec<u8>),
}

impl Value {
    /// The value as a number, if it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Unsigned(number) => Some(*number as f64),
            Self::Signed(number) => Some(*number as f64),
            Self::F32(bits) => Some(f32::from_bits(*bits).into()),
            Self::F64(bits) => Some(f64::from_bits(*bits)),
            Self::Text(_) | Self::Bytes(_) => None,
        }
    }

    /// The text in front of the first zero byte, without spaces at its end; `None` when that is
    /// not printable ASCII.
    pub fn text(&self) -> Option<&str> {
        let Self::Text(bytes) = self else { return None };
        let shown = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
        let text = std::str::from_utf8(shown).ok()?.trim_end_matches(' ');
        text.bytes().all(|byte| (0x20..0x7F).contains(&byte)).then_some(text)
    }
}

/// A field that was decoded.
#[derive(Clone, Debug)]
pub struct Field {
    /// What it is.
    pub plan: Arc<FieldPlan>,
    /// First byte, counted from the start of the data.
    pub offset: usize,
    /// Which record it is part of, counted from 0.
    pub record: Option<usize>,
    /// Its value.
    pub value: Value,
}

impl Field {
    /// The name of the value; `None` when there is no table, or it has none for this value.
    pub fn label(&self) -> Option<&Arc<str>> {
        let Value::Unsigned(number) = &self.value else { return None };
        self.plan.values.as_ref()?.get(number)
    }

    /// The names of the bits that are set, and the bits without a name; `None` for other fields.
    pub fn flags(&self) -> Option<(Vec<&Arc<str>>, u64)> {
        let (Some(flags), Value::Unsigned(number)) = (&self.plan.flags, &self.value) else {
            return None;
        };
        let set = flags.iter().filter(|(mask, _)| number & **mask == **mask);
        let known = flags.keys().fold(0, |known, mask| known | mask);
        Some((set.map(|(_, name)| name).collect(), number & !known))
    }
}

/// Whether the data are as long as the definition says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// They are.
    Exact,
    /// A field or record is not complete, or none is there.
    Short,
    /// Bytes are left.
    Long,
}

/// Data, decoded.
#[derive(Clone, Debug, Default)]
pub struct Decoded {
    /// The complete fields.
    pub fields: Vec<Field>,
    /// How the length fits; `None` when the definition says nothing about these data.
    pub fit: Option<Fit>,
    /// Bytes that belong to no complete field.
    pub extra: Vec<u8>,
}

impl Decoded {
    /// Data of which nothing is known.
    pub fn unknown(data: &[u8]) -> Self {
        Self { fields: Vec::new(), fit: None, extra: data.to_vec() }
    }
}

/// The layout of a command's data.
#[derive(Debug, Default)]
pub struct Payload {
    /// The fields, in order.
    pub fields: Vec<Arc<FieldPlan>>,
    /// Bytes of all fields, or of one record.
    pub size: usize,
    /// The fields repeat, at most so many times.
    pub records: Option<usize>,
}

impl Payload {
    /// True when `data` is a whole number of records, and not none.
    pub fn is_whole(&self, data: &[u8]) -> bool {
        !data.is_empty() && self.decode(data).fit == Some(Fit::Exact)
    }

    /// Decodes `data`.
    pub fn decode(&self, data: &[u8]) -> Decoded {
        let mut fields = Vec::new();
        let (used, full) = match self.records {
            None => {
                let used = self.decode_one(data, 0, None, &mut fields);
                (used, fields.len() == self.fields.len())
            }
            Some(max) => {
                let whole = (data.len() / self.size.max(1)).min(max);
                for record in 0..whole {
                    self.decode_one(data, record * self.size, Some(record), &mut fields);
                }
                let used = whole * self.size;
                (used, whole == max || whole > 0 && used == data.len())
            }
        };
        let extra = data.get(used..).unwrap_or_default().to_vec();
        let fit = match (full, extra.is_empty()) {
            (false, _) => Fit::Short,
            (true, true) => Fit::Exact,
            (true, false) => Fit::Long,
        };
        Decoded { fields, fit: Some(fit), extra }
    }

    /// Adds the complete fields that begin at `start`; where they end.
    fn decode_one(
        &self,
        data: &[u8],
        start: usize,
        record: Option<usize>,
        fields: &mut Vec<Field>,
    ) -> usize {
        let mut offset = start;
        for plan in &self.fields {
            let rest = data.get(offset..).unwrap_or_default();
            let Some(bytes) = rest.get(..plan.size.unwrap_or(rest.len())) else { break };
            let value = plan.read(bytes);
            fields.push(Field { plan: plan.clone(), offset, record, value });
            offset += bytes.len();
        }
        offset
    }
}
