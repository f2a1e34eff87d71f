//! Channels of a serial line: every frame, and one for each command and kind of message.

use std::collections::HashMap;
use std::io;
use std::sync::Arc;

use super::names::{Scope, identifier};
use super::schema::{Schema, schema};
use super::sentences::Sentences;
use super::serial_shapes::{MessageShape, Said};
use super::stream::{Decode, Out};
use crate::frame::{Direction, Frame, Stamped, Timestamp};
use crate::protocol::deframer::Cut;
use crate::protocol::message::{Asked, Command, Message};
use crate::protocol::{Decoder, FrameItem, Item, ItemKind, Protocol};
use crate::recording::schema::{SERIAL_FRAME, bustape};
use crate::recording::{definition::Facts, wire};

/// Channels that belong to no command, by number; behind them three for each command.
const GENERAL: [&str; 7] = [
    "frames",
    "unknown_request",
    "unknown_response",
    "unpaired_response",
    "link",
    "link_reply",
    "malformed",
];

/// Which channel a message is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Place {
    General(usize),
    /// Command by number, and kind: 0 request, 1 response, 2 report.
    Command(usize, usize),
}

const KINDS: [&str; 3] = ["request", "response", "report"];

/// A serial protocol, with the state of one line.
pub struct SerialChannels {
    decoder: Decoder,
    items: Vec<Item>,
    messages: Messages,
    link: Sentences,
}

/// How messages are encoded.
struct Messages {
    protocol: Arc<Protocol>,
    package: String,
    /// Number of a command, by its address in memory.
    commands: HashMap<usize, usize>,
    /// By command and kind, then those of no command; made when first needed.
    shapes: HashMap<Place, MessageShape>,
    /// By command, what its topics begin with.
    topics: Vec<String>,
}

impl SerialChannels {
    /// Begins between frames. Types go into `package`.
    pub fn new(protocol: Arc<Protocol>, package: String) -> Self {
        let address = |command: &Arc<Command>| Arc::as_ptr(command) as usize;
        let commands = protocol.commands.iter().map(address).zip(0..).collect();
        let mut scope = Scope::default();
        let general = GENERAL.map(|name| scope.take_exact(name));
        debug_assert_eq!(general, GENERAL);
        let topics = protocol.commands.iter().map(|command| {
            let name = identifier(&command.name);
            scope.take_exact(if name.is_empty() { "command" } else { &name })
        });
        let topics = topics.collect();
        Self {
            decoder: Decoder::new(protocol.clone()),
            items: Vec::new(),
            messages: Messages { protocol, package, commands, shapes: HashMap::new(), topics },
            link: Sentences::default(),
        }
    }

    fn write(&mut self, out: &mut Out<'_>) -> io::Result<()> {
        for item in self.items.drain(..) {
            let wrong = self.messages.write(&item, out)?;
            if let Some(text) = wrong {
                out.counts.invalid += 1;
                self.link.say(item.time, text, out)?;
            }
        }
        Ok(())
    }
}

impl Decode for SerialChannels {
    fn take(&mut self, frame: &Stamped<Frame>, out: &mut Out<'_>) -> io::Result<()> {
        let items = &mut self.items;
        match &frame.value {
            Frame::Serial(bytes) => {
                let mut take = |item| items.push(item);
                self.decoder.feed(bytes.direction, frame.time, &bytes.data, &mut take);
            }
            // Nobody knows what was asked meanwhile.
            Frame::Gap(_) => self.decoder.finish(&mut |item| items.push(item)),
            Frame::Can(_) | Frame::Notice(_) => {}
        }
        self.write(out)
    }

    fn pass(&mut self, time: Timestamp, out: &mut Out<'_>) -> io::Result<()> {
        let items = &mut self.items;
        self.decoder.pass(time, &mut |item| items.push(item));
        self.write(out)
    }

    fn finish(&mut self, out: &mut Out<'_>) -> io::Result<()> {
        let items = &mut self.items;
        self.decoder.finish(&mut |item| items.push(item));
        self.write(out)?;
        self.link.end(out)
    }
}

impl Messages {
    /// Writes an item; what is wrong with it, if anything.
    fn write(&mut self, item: &Item, out: &mut Out<'_>) -> io::Result<Option<String>> {
        let mut message = bustape::SerialFrame::default();
        match &item.kind {
            ItemKind::Other(cut) => {
                let (text, bytes) = why(cut);
                (message.error, message.length) = (text, bytes);
            }
            ItemKind::Frame(frame) => {
                message.data.clone_from(&frame.bytes);
                message.valid = frame.link_error.is_none();
                frame.link_error.as_deref().unwrap_or_default().clone_into(&mut message.error);
                match self.place(frame) {
                    Some(place) => message.message = self.topic(place),
                    None => out.counts.unknown += u64::from(message.valid),
                }
            }
        }
        let direction = match item.direction {
            Direction::Rx => bustape::serial_frame::Direction::Rx,
            Direction::Tx => bustape::serial_frame::Direction::Tx,
        };
        message.direction = direction as i32;
        let write = |bytes: &mut Vec<u8>| wire::append(bytes, &message);
        out.add(0, item.time, || Some((GENERAL[0].to_owned(), frames_schema())), write)?;
        if let ItemKind::Frame(frame) = &item.kind {
            self.write_message(item.time, frame, out)?;
        }
        Ok((!message.error.is_empty()).then_some(message.error))
    }

    fn write_message(
        &mut self,
        time: Timestamp,
        frame: &FrameItem,
        out: &mut Out<'_>,
    ) -> io::Result<()> {
        let (Some(place), Some(message)) = (self.place(frame), &frame.message) else {
            return Ok(());
        };
        out.counts.unknown += u64::from(matches!(place, Place::General(1 | 2)));
        let number = match place {
            Place::General(number) => number,
            Place::Command(command, kind) => GENERAL.len() + command * KINDS.len() + kind,
        };
        let Self { protocol, shapes, .. } = self;
        shapes.entry(place).or_insert_with(|| {
            let (command, response) = match place {
                Place::General(_) => (None, true),
                Place::Command(command, kind) => (protocol.commands.get(command), kind == 1),
            };
            MessageShape::new(protocol, command.map(|command| &**command), response)
        });
        let Some(shape) = self.shapes.get(&place) else { return Ok(()) };
        let define = || Some((self.topic(place), self.schema(place, shape)));
        let said = said(message, &frame.data);
        out.add(number, time, define, |bytes| shape.encode(frame, &said, bytes))
    }

    /// Where the message of a frame goes.
    fn place(&self, frame: &FrameItem) -> Option<Place> {
        let of = |asked: &Asked, kind: usize| {
            let command = asked.command.as_ref();
            let number = command.and_then(|c| self.commands.get(&(Arc::as_ptr(c) as usize)));
            let unknown = Place::General(if kind == 1 { 2 } else { 1 });
            number.map_or(unknown, |number| Place::Command(*number, kind))
        };
        Some(match frame.message.as_ref()? {
            Message::Request(request) => of(&request.asked, 0),
            Message::Report(report) => of(&report.asked, 2),
            Message::Response(response) => match &response.asked {
                Ok(asked) => of(asked, 1),
                Err(_) => Place::General(3),
            },
            Message::Link { .. } => Place::General(4),
            Message::LinkReply { .. } => Place::General(5),
            Message::Malformed { .. } => Place::General(6),
        })
    }

    /// The last part of a topic.
    fn topic(&self, place: Place) -> String {
        match place {
            Place::General(number) => GENERAL[number].to_owned(),
            Place::Command(command, kind) => {
                let name = self.topics.get(command).map_or("command", String::as_str);
                format!("{name}_{}", KINDS[kind])
            }
        }
    }

    fn schema(&self, place: Place, shape: &MessageShape) -> Schema {
        let mut made = schema(&self.package, &self.topic(place), shape.shape());
        let Place::Command(command, kind) = place else { return made };
        let Some(command) = self.protocol.commands.get(command) else { return made };
        let mut say = |key: &str, text: String| made.facts.insert(key.to_owned(), text);
        say("command", command.name.to_string());
        say("kind", KINDS[kind].to_owned());
        let ids: Vec<String> = command.ids.iter().map(|id| format!("{id:#06x}")).collect();
        if !ids.is_empty() {
            say("id", ids.join(", "));
        }
        if let Some(title) = &command.title {
            say("title", title.clone());
        }
        made
    }
}

fn frames_schema() -> Schema {
    Schema {
        name: SERIAL_FRAME.name.to_owned(),
        descriptor: SERIAL_FRAME.descriptor.to_vec(),
        facts: Facts::new(),
    }
}

/// What a message says, as its shape wants it.
fn said<'a>(message: &'a Message, data: &'a [u8]) -> Said<'a> {
    match message {
        Message::Request(request) | Message::Report(request) => {
            Said { asked: Some(&request.asked), data: Some(&request.data), ..Said::default() }
        }
        Message::Response(response) => Said {
            asked: response.asked.as_ref().ok(),
            data: Some(&response.data),
            status: &response.status,
            paired: Some(response.asked.as_ref().map(|_| ()).map_err(AsRef::as_ref)),
            ..Said::default()
        },
        Message::Link { .. } => Said { extra: data, ..Said::default() },
        Message::LinkReply { answers, .. } => {
            let answered = answers.as_ref().ok().map(|answered| {
                let command = answered.asked.as_ref().and_then(|asked| asked.command.as_ref());
                let kind = answered.kind.as_ref().and_then(|kind| kind.label());
                command.map(|command| &command.name).or(kind).map_or("", AsRef::as_ref).to_owned()
            });
            let paired = answers.as_ref().map(|_| ()).map_err(AsRef::as_ref);
            Said { paired: Some(paired), answers: answered, extra: data, ..Said::default() }
        }
        Message::Malformed { .. } => Said { extra: data, ..Said::default() },
    }
}

/// What is wrong with something that is no frame, and how many bytes it has.
fn why(cut: &Cut) -> (String, u64) {
    let bytes = |bytes: &usize| *bytes as u64;
    match cut {
        Cut::Garbage { bytes } => (format!("{bytes} bytes outside of any frame"), *bytes),
        Cut::Truncated => ("a frame was given up because another one began".to_owned(), 0),
        Cut::Incomplete => ("a frame was not complete when the input ended".to_owned(), 0),
        Cut::BadEscape { byte } => (format!("byte {byte:#04x} must not follow the escape byte"), 0),
        Cut::CrcError { received, computed, .. } => {
            (format!("wrong check: {received:#x} received, {computed:#x} computed"), 0)
        }
        Cut::BadLength { bytes: count } => {
            (format!("a frame with an impossible length ({count} bytes of it)"), bytes(count))
        }
        Cut::TooLong { bytes } => {
            (format!("a frame longer than any can be: {bytes} bytes"), *bytes)
        }
        Cut::BadEncoding { bytes: count } => {
            (format!("{count} bytes that are not COBS"), bytes(count))
        }
        Cut::Frame(frame) => (String::new(), frame.len() as u64),
    }
}
