//! Channels of a CAN bus: one for each message of its database.

use std::io;

use super::encoder::{Encoder, is_labelled, kind};
use super::names::{Scope, identifier};
use super::schema::{Schema, schema};
use super::shape::{Field, Kind, Shape};
use super::stream::{Decode, Out};
use crate::decode::can::CanDecoder;
use crate::decode::dbc::{Format, Message, Signal};
use crate::decode::j1939::Identifier;
use crate::frame::{CanFlags, Frame, Stamped, Timestamp};

/// Names of our own channels of a bus, which no message may take.
const OURS: [&str; 4] = ["raw", "gaps", "stats", "frames"];

/// A database, compiled to channels.
#[derive(Debug)]
pub struct CanChannels {
    decoder: CanDecoder,
    /// By index of the message.
    encoders: Box<[Encoder]>,
    /// By index of the message: its type's name within the package.
    types: Box<[String]>,
    j1939: bool,
    package: String,
}

impl CanChannels {
    /// Compiles the encoders. `j1939` as given to the decoder; types go into `package`.
    pub fn new(decoder: CanDecoder, j1939: bool, package: String) -> Self {
        let messages = &decoder.database().messages;
        let mut scope = Scope::default();
        let types = messages.iter().map(|message| {
            let name = identifier(&message.name);
            scope.take_exact(if name.is_empty() { "Message" } else { &name })
        });
        let types = types.collect();
        let encoder = |message| Encoder::new(message, is_group(message, j1939));
        let encoders = messages.iter().map(encoder).collect();
        Self { decoder, encoders, types, j1939, package }
    }

    /// The part of message number `index`'s topic behind the bus, and its schema.
    fn channel(&self, index: usize) -> Option<(String, Schema)> {
        let message = self.decoder.database().messages.get(index)?;
        let mut made = schema(&self.package, self.types.get(index)?, &shape(message, self.j1939));
        let mut say = |key: &str, text: String| made.facts.insert(key.to_owned(), text);
        let digits = if message.extended { 8 } else { 3 };
        say("id", format!("0x{:0digits$X}", message.id));
        if is_group(message, self.j1939) {
            say("pgn", Identifier::of(message.id).pgn.to_string());
        }
        if message.cycle_time > 0 {
            say("cycle_ms", message.cycle_time.to_string());
        }
        if !message.senders.is_empty() {
            say("sender", message.senders.join(", "));
        }
        if !message.comment.is_empty() {
            say("comment", message.comment.clone());
        }
        let name = &message.name;
        let taken = OURS.contains(&name.as_str());
        Some((if taken { format!("{name}_") } else { name.clone() }, made))
    }
}

impl Decode for CanChannels {
    #[inline]
    fn take(&mut self, frame: &Stamped<Frame>, out: &mut Out<'_>) -> io::Result<()> {
        let Frame::Can(can) = &frame.value else { return Ok(()) };
        let Some(found) = self.decoder.find(can) else {
            let data = !can.flags.has(CanFlags::REMOTE) && !can.flags.has(CanFlags::ERROR);
            out.counts.unknown += u64::from(data);
            return Ok(());
        };
        let Some(encoder) = self.encoders.get(found.index) else { return Ok(()) };
        let define = || self.channel(found.index);
        out.add(found.index, frame.time, define, |bytes| encoder.encode(&found, can, bytes))
    }

    // A frame is whole when it comes.
    fn pass(&mut self, _: Timestamp, _: &mut Out<'_>) -> io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, _: &mut Out<'_>) -> io::Result<()> {
        Ok(())
    }
}

/// True for messages that are recognised by their parameter group number.
fn is_group(message: &Message, j1939: bool) -> bool {
    message.extended && (j1939 || message.format == Format::J1939)
}

/// In the order that [`Encoder`] goes by.
fn shape(message: &Message, j1939: bool) -> Shape {
    let mut fields: Vec<Field> = message.signals.iter().map(field).collect();
    if is_group(message, j1939) {
        fields.push(Field::new("source_address", Kind::Uint32));
        fields.push(Field::new("destination_address", Kind::Uint32));
    }
    Shape { fields }
}

fn field(signal: &Signal) -> Field {
    let labels = signal.labels.iter().filter(|_| is_labelled(signal));
    let labels = labels.flat_map(|labels| labels.iter());
    // Both 0 is how a file says nothing.
    let said = signal.min != 0.0 || signal.max != 0.0;
    Field {
        name: signal.name.clone(),
        kind: kind(signal),
        unit: signal.unit.clone(),
        range: said.then_some((signal.min, signal.max)),
        labels: labels.map(|(value, text)| (*value, text.to_string())).collect(),
    }
}
