//! A message's shape as a protobuf schema, and what a schema cannot say as facts of the channel.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};

use super::labels::{ENUM, Values};
use super::names::{Scope, identifier};
use super::shape::{Field, Kind, Shape, numbers};
use crate::recording::definition::Facts;

/// A message's type, ready for a file.
#[derive(Debug)]
pub struct Schema {
    /// Full type name.
    pub name: String,
    /// A `google.protobuf.FileDescriptorSet`.
    pub descriptor: Vec<u8>,
    /// `unit.<field>`, `range.<field>`, `name.<field>`, `label.<field>.<value>`.
    pub facts: Facts,
}

/// The type `package.name` of messages that look like `shape`.
pub fn schema(package: &str, name: &str, shape: &Shape) -> Schema {
    let full = format!("{package}.{name}");
    let mut facts = Facts::new();
    let message = Builder { facts: &mut facts, path: String::new() }.message(name, &full, shape);
    let file = FileDescriptorProto {
        name: Some(format!("{}.proto", full.replace('.', "/"))),
        package: Some(package.to_owned()),
        message_type: vec![message],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    let set = FileDescriptorSet { file: vec![file] };
    Schema { name: full, descriptor: set.encode_to_vec(), facts }
}

/// Builds a message and those inside of it.
struct Builder<'a> {
    facts: &'a mut Facts,
    /// What the names of fields begin with in the facts.
    path: String,
}

impl Builder<'_> {
    fn message(&mut self, name: &str, full: &str, shape: &Shape) -> DescriptorProto {
        let mut scope = Scope::default();
        let mut message =
            DescriptorProto { name: Some(name.to_owned()), ..DescriptorProto::default() };
        let labelled: Vec<bool> = shape.fields.iter().map(|f| !f.labels.is_empty()).collect();
        let numbers = numbers(&labelled);
        // All fields before any label: a signal keeps its name, also beside one called x_label.
        let names: Vec<String> = shape.fields.iter().map(|field| take(&mut scope, field)).collect();
        for ((field, name), (number, _)) in shape.fields.iter().zip(&names).zip(&numbers) {
            self.say(field, name);
            let inside = if let Kind::Message(shape) = &field.kind { Some(shape) } else { None };
            let inner = inside.map(|shape| {
                let kind = scope.take_exact(&format!("{name}_fields"));
                let inner = format!("{full}.{kind}");
                let path = format!("{}{name}.", self.path);
                let built = Builder { facts: self.facts, path }.message(&kind, &inner, shape);
                message.nested_type.push(built);
                format!(".{inner}")
            });
            let kind = (field_type(&field.kind), field.repeated);
            add(&mut message, &mut scope, name, *number, kind, inner);
        }
        for ((field, name), (_, number)) in shape.fields.iter().zip(&names).zip(&numbers) {
            let Some(number) = number else { continue };
            let values = Values::of(&field.labels);
            let kind = scope.take_exact(&format!("{name}_values"));
            let label = scope.take(&format!("{name}_label"));
            for (value, text) in &values.texts {
                self.facts.insert(format!("label.{}{name}.{value}", self.path), text.clone());
            }
            message.nested_type.push(holder(&kind, values));
            let type_name = Some(format!(".{full}.{kind}.{ENUM}"));
            add(&mut message, &mut scope, &label, *number, (Type::Enum, false), type_name);
        }
        message
    }

    /// What a schema has no place for.
    fn say(&mut self, field: &Field, name: &str) {
        let mut say = |what: &str, text: String| {
            self.facts.insert(format!("{what}.{}{name}", self.path), text);
        };
        if *name != field.name {
            say("name", field.name.clone());
        }
        if !field.unit.is_empty() {
            say("unit", field.unit.clone());
        }
        if let Some((least, largest)) = field.range {
            say("range", format!("{least}..{largest}"));
        }
    }
}

/// The field's own name as far as protobuf allows.
fn take(scope: &mut Scope, field: &Field) -> String {
    let name = identifier(&field.name);
    scope.take(if name.is_empty() { "signal" } else { &name })
}

fn field_type(kind: &Kind) -> Type {
    match kind {
        Kind::Uint32 => Type::Uint32,
        Kind::Uint64 => Type::Uint64,
        Kind::Sint32 => Type::Sint32,
        Kind::Sint64 => Type::Sint64,
        Kind::Float => Type::Float,
        Kind::Double => Type::Double,
        Kind::Bool => Type::Bool,
        Kind::Text => Type::String,
        Kind::Bytes => Type::Bytes,
        Kind::Message(_) => Type::Message,
    }
}

/// Adds a field of a type that may repeat, and that can be absent; a message inside always can.
fn add(
    message: &mut DescriptorProto,
    scope: &mut Scope,
    name: &str,
    number: u32,
    (kind, repeated): (Type, bool),
    type_name: Option<String>,
) {
    let optional = kind != Type::Message && !repeated;
    // What `optional` is inside: a oneof with this field alone.
    let oneof_index = optional.then(|| {
        let name = Some(scope.take_exact(&format!("_{name}")));
        message.oneof_decl.push(OneofDescriptorProto { name, options: None });
        i32::try_from(message.oneof_decl.len() - 1).unwrap_or(i32::MAX)
    });
    message.field.push(FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: i32::try_from(number).ok(),
        label: Some(if repeated { Label::Repeated } else { Label::Optional } as i32),
        r#type: Some(kind as i32),
        type_name,
        oneof_index,
        proto3_optional: optional.then_some(true),
        ..FieldDescriptorProto::default()
    });
}

/// The message that an enum stands in.
fn holder(name: &str, values: Values) -> DescriptorProto {
    let value = values.named.into_iter().map(|(number, name)| EnumValueDescriptorProto {
        name: Some(name),
        number: Some(number),
        options: None,
    });
    DescriptorProto {
        name: Some(name.to_owned()),
        enum_type: vec![EnumDescriptorProto {
            name: Some(ENUM.to_owned()),
            value: value.collect(),
            ..EnumDescriptorProto::default()
        }],
        ..DescriptorProto::default()
    }
}
