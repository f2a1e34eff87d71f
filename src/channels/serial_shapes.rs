//! What the messages of a serial protocol look like.

use std::sync::Arc;

use super::fields::{Encoder, of_plan, of_quantity};
use super::shape::{Field, Kind, Shape};
use crate::protocol::message::{Asked, Command};
use crate::protocol::payload::{Decoded, Field as DecodedField, Fit, Payload};
use crate::protocol::word::{Quantity, Reading};
use crate::protocol::{FrameItem, Protocol};

/// Places of fields, by the definition's order, each with its twin's.
type Places = Vec<(usize, usize)>;

/// A message of a command, or of frames that no command is known for.
pub struct MessageShape {
    encoder: Encoder,
    fields: Places,
    /// The fields repeat, in messages of their own.
    records: Option<(usize, Encoder)>,
    args: Places,
    status: Vec<usize>,
    header: Vec<Option<usize>>,
    /// Where the facts about a message begin; see [`FACTS`].
    facts: usize,
}

/// What is said of a message beside its fields, in this order.
#[derive(Clone, Copy, Debug)]
pub enum Fact {
    /// Number of the command.
    CommandId,
    /// Name of the operation.
    Operation,
    /// `exact`, `short` or `long`.
    Check,
    /// Bytes that belong to no field.
    Extra,
    /// There is a request for it.
    Paired,
    /// Why there is none.
    Reason,
    /// What it answers.
    Answers,
}

/// Names and types of [`Fact`]s.
const FACTS: [(&str, Kind); 7] = [
    ("command_id", Kind::Uint64),
    ("operation", Kind::Text),
    ("check", Kind::Text),
    ("extra", Kind::Bytes),
    ("paired", Kind::Bool),
    ("reason", Kind::Text),
    ("answers", Kind::Text),
];

/// What a message says.
#[derive(Default)]
pub struct Said<'a> {
    /// The request, as far as it is known.
    pub asked: Option<&'a Asked>,
    /// Its data.
    pub data: Option<&'a Decoded>,
    /// The numbers in front of the data of a response.
    pub status: &'a [Reading],
    /// Whether there is a request for a response, and why not.
    pub paired: Option<Result<(), &'a str>>,
    /// What it answers.
    pub answers: Option<String>,
    /// Bytes of which nothing is known.
    pub extra: &'a [u8],
}

impl MessageShape {
    /// That of `command`'s requests (or reports), or responses; without a command that of frames
    /// that belong to none.
    pub fn new(protocol: &Protocol, command: Option<&Command>, response: bool) -> Self {
        let mut shape = Shape::default();
        let (mut fields, mut args, mut records) = (Places::new(), Places::new(), None);
        if let Some(command) = command {
            // Before all others, so that a field keeps its name.
            if command.fields.records.is_some() {
                let mut inside = Shape::default();
                fields = places(&command.fields, &mut inside);
                let record = Field::new("records", Kind::Message(inside.clone())).repeated();
                records = Some((push(&mut shape, record), Encoder::new(inside)));
            } else {
                fields = places(&command.fields, &mut shape);
            }
            args = places(&command.args, &mut shape);
        }
        let quantities = |list: &[Arc<Quantity>], shape: &mut Shape| -> Vec<Option<usize>> {
            let place = |q: &Arc<Quantity>| (!q.hidden).then(|| push(shape, of_quantity(q)));
            list.iter().map(place).collect()
        };
        let with_status = response || command.is_none();
        let status = if with_status { protocol.status() } else { &[] };
        let status = status.iter().map(|q| push(&mut shape, of_quantity(q))).collect();
        let header = quantities(protocol.header(), &mut shape);
        let facts = shape.fields.len();
        shape.fields.extend(FACTS.map(|(name, kind)| Field::new(name, kind)));
        Self { encoder: Encoder::new(shape), fields, records, args, status, header, facts }
    }

    /// For the schema.
    pub fn shape(&self) -> &Shape {
        self.encoder.shape()
    }

    /// Appends a message.
    pub fn encode(&self, frame: &FrameItem, said: &Said<'_>, out: &mut Vec<u8>) {
        let encoder = &self.encoder;
        for (place, reading) in self.header.iter().zip(&frame.header) {
            if let Some(place) = place {
                encoder.reading(*place, reading, out);
            }
        }
        for (place, reading) in self.status.iter().zip(said.status) {
            encoder.reading(*place, reading, out);
        }
        if let Some(asked) = said.asked {
            self.put_asked(asked, out);
        }
        if let Some(data) = said.data {
            self.put_data(data, out);
        }
        match said.paired {
            Some(Ok(())) => encoder.uint(self.at(Fact::Paired), 1, out),
            Some(Err(reason)) => {
                encoder.uint(self.at(Fact::Paired), 0, out);
                encoder.bytes(self.at(Fact::Reason), reason.as_bytes(), out);
            }
            None => {}
        }
        if let Some(answers) = &said.answers {
            encoder.bytes(self.at(Fact::Answers), answers.as_bytes(), out);
        }
        if !said.extra.is_empty() {
            encoder.bytes(self.at(Fact::Extra), said.extra, out);
        }
    }

    fn at(&self, fact: Fact) -> usize {
        self.facts + fact as usize
    }

    fn put_asked(&self, asked: &Asked, out: &mut Vec<u8>) {
        if let Some(id) = &asked.id {
            self.encoder.uint(self.at(Fact::CommandId), id.value, out);
        }
        if let Some(operation) = &asked.operation {
            self.encoder.bytes(self.at(Fact::Operation), operation.as_bytes(), out);
        }
        put_in_order(&self.encoder, &self.args, &asked.args, out);
    }

    fn put_data(&self, data: &Decoded, out: &mut Vec<u8>) {
        match &self.records {
            None => put_in_order(&self.encoder, &self.fields, &data.fields, out),
            Some((place, inside)) => {
                for record in data.fields.chunk_by(|a, b| a.record == b.record) {
                    let mut bytes = Vec::new();
                    put_in_order(inside, &self.fields, record, &mut bytes);
                    self.encoder.bytes(*place, &bytes, out);
                }
            }
        }
        let check = data.fit.map(|fit| match fit {
            Fit::Exact => "exact",
            Fit::Short => "short",
            Fit::Long => "long",
        });
        if let Some(check) = check {
            self.encoder.bytes(self.at(Fact::Check), check.as_bytes(), out);
        }
        if !data.extra.is_empty() {
            self.encoder.bytes(self.at(Fact::Extra), &data.extra, out);
        }
    }
}

/// Adds the fields of `payload`; where they are.
fn places(payload: &Payload, shape: &mut Shape) -> Places {
    let mut places = Places::new();
    for plan in &payload.fields {
        let (field, twin) = of_plan(plan);
        let place = push(shape, field);
        places.push((place, twin.map_or(usize::MAX, |twin| push(shape, twin))));
    }
    places
}

fn push(shape: &mut Shape, field: Field) -> usize {
    shape.fields.push(field);
    shape.fields.len() - 1
}

/// Puts the complete fields, which are the first ones of the definition.
fn put_in_order(encoder: &Encoder, places: &Places, fields: &[DecodedField], out: &mut Vec<u8>) {
    for ((place, twin), field) in places.iter().zip(fields) {
        encoder.value(*place, *twin, &field.plan, &field.value, out);
    }
}
