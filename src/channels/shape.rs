//! What a message looks like, before it has a schema.

/// A message: its fields, in the order of their numbers.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// The fields.
    pub fields: Vec<Field>,
}

/// A field.
#[derive(Clone, Debug)]
pub struct Field {
    /// The name in the definition.
    pub name: String,
    /// What it holds.
    pub kind: Kind,
    /// Any number of them.
    pub repeated: bool,
    /// Unit of the value; empty when not said.
    pub unit: String,
    /// Least and largest value, when said.
    pub range: Option<(f64, f64)>,
    /// Raw values and their texts, sorted. The field then has a twin, `<name>_label`.
    pub labels: Vec<(i128, String)>,
}

/// What a field holds.
#[derive(Clone, Debug)]
pub enum Kind {
    /// Up to 32 bits.
    Uint32,
    /// Up to 64 bits.
    Uint64,
    /// Zigzag, up to 32 bits.
    Sint32,
    /// Zigzag, up to 64 bits.
    Sint64,
    /// IEEE 754, 32 bits.
    Float,
    /// IEEE 754, 64 bits.
    Double,
    /// Yes or no.
    Bool,
    /// A text.
    Text,
    /// Bytes.
    Bytes,
    /// A message inside.
    Message(Shape),
}

impl Field {
    /// A field without unit, range and labels.
    pub fn new(name: impl Into<String>, kind: Kind) -> Self {
        Self {
            name: name.into(),
            kind,
            repeated: false,
            unit: String::new(),
            range: None,
            labels: Vec::new(),
        }
    }

    /// Any number of it.
    #[must_use]
    pub fn repeated(mut self) -> Self {
        self.repeated = true;
        self
    }

    /// The same with texts for raw values.
    #[must_use]
    pub fn labelled(mut self, labels: Vec<(i128, String)>) -> Self {
        self.labels = labels;
        self
    }
}

/// The number of each field and of its label, if it has one: fields count from 1 in their order,
/// their labels go on behind the last. `labelled` says for each field whether it has one.
///
/// 8,192 fields are the most that a message can have here, so none reaches the 19,000 that protobuf
/// keeps for itself.
pub fn numbers(labelled: &[bool]) -> Vec<(u32, Option<u32>)> {
    let mut label = u32::try_from(labelled.len()).unwrap_or(u32::MAX);
    (1..)
        .zip(labelled)
        .map(|(number, labelled)| {
            label += u32::from(*labelled);
            (number, labelled.then_some(label))
        })
        .collect()
}
