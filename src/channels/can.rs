//! Channels of a CAN bus: one for each message, remote message and message of several frames.

use std::io;
use std::sync::Arc;

use super::assembly::AssemblyShape;
use super::encoder::{Encoder, is_labelled, kind};
use super::names::{Scope, identifier};
use super::schema::{Schema, schema};
use super::sentences::Sentences;
use super::shape::{Field, Kind, Shape};
use super::stream::{Decode, Out};
use crate::decode::assembly::Assembled;
use crate::decode::bus::{CanBus, CanItem};
use crate::decode::can::{Match, Value};
use crate::decode::dbc::{Message, Signal};
use crate::decode::definition::{CanDefinition, Event, RemoteMessage};
use crate::decode::j1939::Identifier;
use crate::frame::{CanFlags, CanFrame, Frame, Notice, Stamped, Timestamp};

/// Names of our own channels of a bus, which no message may take.
const OURS: [&str; 5] = ["raw", "gaps", "stats", "frames", "errors"];

/// A CAN protocol, with the state of one bus.
pub struct CanChannels {
    bus: CanBus,
    messages: Messages,
    link: Sentences,
    /// Messages of one frame are written, too.
    single: bool,
}

/// How messages are encoded. Channels are numbered: messages, remote messages, assemblies.
struct Messages {
    definition: Arc<CanDefinition>,
    /// By message.
    encoders: Box<[Encoder]>,
    /// By message: whether it has addresses.
    grouped: Vec<bool>,
    /// By channel: the name of its type within the package.
    types: Box<[String]>,
    package: String,
    /// By assembly.
    assemblies: Vec<AssemblyShape>,
}

impl CanChannels {
    /// Compiles the encoders. Types go into `package`. Messages of one frame only with `single`.
    pub fn new(definition: Arc<CanDefinition>, package: String, single: bool) -> Self {
        let grouped = definition.grouped();
        let names = definition.messages().iter().map(|message| message.name.as_str());
        let names = names.chain(definition.remotes().iter().map(|remote| remote.name.as_str()));
        let names = names.chain(definition.assemblies().iter().map(|assembly| &*assembly.name));
        let mut scope = Scope::default();
        let types = names.map(|name| {
            let name = identifier(name);
            scope.take_exact(if name.is_empty() { "Message" } else { &name })
        });
        let types = types.collect();
        let encoders = definition.messages().iter().zip(&grouped);
        let encoders = encoders.map(|(message, grouped)| Encoder::new(message, *grouped)).collect();
        let assemblies = definition.assemblies().iter().map(AssemblyShape::new).collect();
        Self {
            bus: CanBus::new(definition.clone()),
            messages: Messages { definition, encoders, grouped, types, package, assemblies },
            link: Sentences::default(),
            single,
        }
    }
}

impl Decode for CanChannels {
    fn take(&mut self, frame: &Stamped<Frame>, out: &mut Out<'_>) -> io::Result<()> {
        let mut done = Ok(());
        match &frame.value {
            Frame::Can(can) if can.flags.has(CanFlags::ERROR) => {
                let text = format!("error frame of class 0x{:X}", can.id & ERROR_CLASS);
                self.link.say(frame.time, text, out)?;
            }
            Frame::Can(can) => {
                let (messages, single) = (&self.messages, self.single);
                self.bus.feed(frame.time, can, &mut |item| {
                    let wanted = single || !matches!(item, CanItem::Message(_));
                    if wanted && done.is_ok() {
                        done = messages.write(&item, frame.time, can, out);
                    }
                });
            }
            Frame::Gap(_) => self.give_up(out)?,
            Frame::Serial(_) | Frame::Notice(_) => {}
        }
        done
    }

    // A frame is whole when it comes.
    fn pass(&mut self, _: Timestamp, _: &mut Out<'_>) -> io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, out: &mut Out<'_>) -> io::Result<()> {
        self.give_up(out)?;
        self.link.end(out)
    }
}

/// The bits of an error frame's identifier (`linux/can/error.h`).
const ERROR_CLASS: u32 = 0x1FFF_FFFF;

impl CanChannels {
    /// What waits for more frames is written as far as it is there.
    fn give_up(&mut self, out: &mut Out<'_>) -> io::Result<()> {
        let messages = &self.messages;
        let mut done = Ok(());
        self.bus.finish(&mut |item| {
            if let (CanItem::Assembly(assembled), Ok(())) = (&item, &done) {
                done = messages.write_assembly(assembled, out);
            }
        });
        done
    }
}

impl Messages {
    #[inline]
    fn write(
        &self,
        item: &CanItem<'_>,
        time: Timestamp,
        frame: &CanFrame,
        out: &mut Out<'_>,
    ) -> io::Result<()> {
        match item {
            CanItem::Message(found) => {
                let Some(encoder) = self.encoders.get(found.index) else { return Ok(()) };
                let define = || self.message(found.index);
                out.add(found.index, time, define, |bytes| encoder.encode(found, frame, bytes))?;
                match self.definition.event(found.index) {
                    Some(event) => log_event(event, found, time, frame, out),
                    None => Ok(()),
                }
            }
            CanItem::Remote(remote) => self.write_remote(remote, time, frame, out),
            CanItem::Unknown => {
                // A remote frame asks for data and carries none.
                out.counts.unknown += u64::from(!frame.flags.has(CanFlags::REMOTE));
                Ok(())
            }
            CanItem::Assembly(assembled) => self.write_assembly(assembled, out),
        }
    }

    #[cold]
    fn write_remote(
        &self,
        remote: &RemoteMessage,
        time: Timestamp,
        frame: &CanFrame,
        out: &mut Out<'_>,
    ) -> io::Result<()> {
        let remotes = self.definition.remotes();
        let Some(at) = remotes.iter().position(|other| std::ptr::eq(other, remote)) else {
            return Ok(());
        };
        let channel = self.encoders.len() + at;
        let encoder = super::fields::Encoder::new(remote_shape());
        let define = || {
            let mut made = schema(&self.package, self.types.get(channel)?, encoder.shape());
            say_id(&mut made, remote.id, remote.extended);
            say(&mut made, "title", remote.title.as_deref());
            say(&mut made, "direction", remote.direction.as_deref());
            Some((remote.name.clone(), made))
        };
        out.add(channel, time, define, |bytes| encoder.uint(0, frame.dlc.into(), bytes))
    }

    #[cold]
    fn write_assembly(&self, assembled: &Assembled<'_>, out: &mut Out<'_>) -> io::Result<()> {
        let assembly = assembled.assembly;
        let all = self.definition.assemblies();
        let Some(at) = all.iter().position(|other| std::ptr::eq(other, assembly)) else {
            return Ok(());
        };
        let channel = self.encoders.len() + self.definition.remotes().len() + at;
        let Some(shape) = self.assemblies.get(at) else { return Ok(()) };
        let define = || {
            let mut made = schema(&self.package, self.types.get(channel)?, shape.shape());
            say(&mut made, "title", assembly.title.as_deref());
            say(&mut made, "direction", assembly.direction.as_deref());
            say(&mut made, "kind", Some(&assembly.kind));
            Some((assembly.name.to_string(), made))
        };
        out.add(channel, assembled.ended, define, |bytes| shape.encode(assembled, bytes))
    }

    /// The part of message number `index`'s topic behind the bus, and its schema.
    #[cold]
    fn message(&self, index: usize) -> Option<(String, Schema)> {
        let message = self.definition.messages().get(index)?;
        let grouped = self.grouped.get(index).copied().unwrap_or(false);
        let mut made = schema(&self.package, self.types.get(index)?, &shape(message, grouped));
        say_id(&mut made, message.id, message.extended);
        if grouped {
            say(&mut made, "pgn", Some(&Identifier::of(message.id).pgn.to_string()));
        }
        if message.cycle_time > 0 {
            say(&mut made, "cycle_ms", Some(&message.cycle_time.to_string()));
        }
        say(&mut made, "sender", Some(&message.senders.join(", ")));
        say(&mut made, "direction", self.definition.direction(message).as_deref());
        say(&mut made, "comment", Some(&message.comment));
        let name = &message.name;
        let taken = OURS.contains(&name.as_str());
        Some((if taken { format!("{name}_") } else { name.clone() }, made))
    }
}

/// Writes an event to the log: its name, and what its signals say.
#[cold]
fn log_event(
    event: &Event,
    found: &Match<'_>,
    time: Timestamp,
    frame: &CanFrame,
    out: &mut Out<'_>,
) -> io::Result<()> {
    let mut said = Vec::new();
    found.decode(frame, |reading| {
        let Some(signal) = found.message.signals.get(reading.signal) else { return };
        let number = match reading.value {
            Value::Unsigned(number) => number.to_string(),
            Value::Signed(number) => number.to_string(),
            Value::Float(number) => number.to_string(),
        };
        let gap = if signal.unit.is_empty() { "" } else { " " };
        let label = signal.label(reading.raw).map_or(String::new(), |text| format!(" ({text})"));
        said.push(format!("{} {number}{gap}{}{label}", signal.name, signal.unit));
    });
    let name = &found.message.name;
    let mut text = event.text.clone().unwrap_or_else(|| name.clone());
    if !said.is_empty() {
        text = format!("{text}: {}", said.join(", "));
    }
    out.log(time, name, &Notice { level: event.level, text })
}

fn say_id(made: &mut Schema, id: u32, extended: bool) {
    let digits = if extended { 8 } else { 3 };
    say(made, "id", Some(&format!("0x{id:0digits$X}")));
}

fn say(made: &mut Schema, key: &str, text: Option<&str>) {
    if let Some(text) = text.filter(|text| !text.is_empty()) {
        made.facts.insert(key.to_owned(), text.to_owned());
    }
}

fn remote_shape() -> Shape {
    Shape { fields: vec![Field::new("dlc", Kind::Uint32)] }
}

/// In the order that [`Encoder`] goes by.
fn shape(message: &Message, grouped: bool) -> Shape {
    let mut fields: Vec<Field> = message.signals.iter().map(field).collect();
    if grouped {
        fields.push(Field::new("source_address", Kind::Uint32));
        fields.push(Field::new("destination_address", Kind::Uint32));
    }
    Shape { fields }
}

fn field(signal: &Signal) -> Field {
    let labels = signal.labels.iter().filter(|_| is_labelled(signal));
    let labels = labels.flat_map(|labels| labels.iter());
    let labels = labels.map(|(value, text)| (*value, text.to_string())).collect();
    let mut field = Field::new(signal.name.as_str(), kind(signal)).labelled(labels);
    field.unit.clone_from(&signal.unit);
    // Both 0 is how a file says nothing.
    let said = signal.min != 0.0 || signal.max != 0.0;
    field.range = said.then_some((signal.min, signal.max));
    field
}
