//! Messages of several CAN frames: shape and encoding.

use super::fields::{Encoder, of_plan};
use super::shape::{Field, Kind, Shape};
use crate::decode::assembly::{Assembled, Assembly, Content, text};
use crate::protocol::payload::Value;

/// How one kind of them is encoded.
pub struct AssemblyShape {
    encoder: Encoder,
    /// By field its place and that of its twin.
    places: Vec<(usize, usize)>,
    /// Where the facts about it begin: complete, frames, constants, all bytes.
    facts: usize,
}

impl AssemblyShape {
    /// That of `assembly`.
    pub fn new(assembly: &Assembly) -> Self {
        let mut fields: Vec<Field> = Vec::new();
        let mut places = Vec::new();
        for field in &assembly.fields {
            let (shape, twin) = of_plan(&field.plan);
            if field.repeated {
                // An element has no twin of its own.
                fields.push(Field { labels: Vec::new(), ..shape }.repeated());
                places.push((fields.len() - 1, usize::MAX));
                continue;
            }
            fields.push(shape);
            let place = fields.len() - 1;
            fields.extend(twin);
            places.push((place, fields.len() - 1));
        }
        let facts = fields.len();
        fields.push(Field::new("complete", Kind::Bool));
        fields.push(Field::new("frames", Kind::Uint32));
        let constants = assembly.constants.iter().map(|(name, _)| Field::new(&**name, Kind::Text));
        fields.extend(constants);
        fields.extend(assembly.raw.as_ref().map(|name| Field::new(&**name, Kind::Bytes)));
        Self { encoder: Encoder::new(Shape { fields }), places, facts }
    }

    /// For the schema.
    pub fn shape(&self) -> &Shape {
        self.encoder.shape()
    }

    /// Appends a message.
    pub fn encode(&self, assembled: &Assembled<'_>, out: &mut Vec<u8>) {
        let assembly = assembled.assembly;
        assembled.decode(|field, content| {
            let plan = assembly.fields.get(field).map(|field| &field.plan);
            let (Some(plan), Some(&(place, twin))) = (plan, self.places.get(field)) else { return };
            match content {
                // Names may be in UTF-8 here.
                Content::One(Value::Text(bytes)) => {
                    self.encoder.bytes(place, text(&bytes).as_bytes(), out);
                }
                Content::One(value) => self.encoder.value(place, twin, plan, &value, out),
                Content::Many(values) => {
                    for value in values {
                        match value {
                            // An element that is left out would give its index to the next one.
                            Value::Text(bytes) => {
                                self.encoder.bytes(place, text(&bytes).as_bytes(), out);
                            }
                            value => self.encoder.value(place, usize::MAX, plan, &value, out),
                        }
                    }
                }
            }
        });
        self.encoder.uint(self.facts, u64::from(assembled.complete), out);
        self.encoder.uint(self.facts + 1, assembled.frames.into(), out);
        let mut place = self.facts + 2;
        for (_, value) in &assembly.constants {
            self.encoder.bytes(place, value.as_bytes(), out);
            place += 1;
        }
        if assembly.raw.is_some() {
            self.encoder.bytes(place, assembled.bytes, out);
        }
    }
}
