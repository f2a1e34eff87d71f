//! What the frames of a bus say, for those conditions that ask for it.

use std::sync::Arc;

use super::Comparison;
use crate::decode::assembly::Content;
use crate::decode::bus::{CanBus, CanItem};
use crate::decode::can::{Match, Value};
use crate::decode::definition::CanDefinition;
use crate::frame::{CanFrame, Frame, Stamped, Timestamp};
use crate::protocol::message::{Asked, Message};
use crate::protocol::payload::{Field, Value as PayloadValue};
use crate::protocol::{Command, Decoder, Item, ItemKind, Protocol};

/// What a bus is decoded with.
#[derive(Clone, Debug)]
pub enum Known {
    /// A CAN bus.
    Can(Arc<CanDefinition>),
    /// A serial line.
    Serial(Arc<Protocol>),
}

/// What a rule wants to know of a message.
#[derive(Clone, Copy, Debug)]
pub struct Probe {
    /// The rule.
    pub rule: usize,
    /// It is the rule's `until`.
    pub until: bool,
    /// The signal or field, how it is compared and with what; `None` if it matters that the message
    /// came.
    pub signal: Option<(usize, Comparison, f64)>,
    /// Of serial commands: of which kind of message; `None` for those that carry what was read.
    kind: Option<Kind>,
}

/// Kinds of messages of a serial command; their topics end so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Request,
    Response,
    Report,
}

const KINDS: [(&str, Kind); 3] =
    [("_request", Kind::Request), ("_response", Kind::Response), ("_report", Kind::Report)];

/// Gives each value that a signal or field (by its number) has to a function.
pub type Values<'a> = dyn Fn(usize, &mut dyn FnMut(f64)) + 'a;

/// Who wants to know of the assemblies, by their names.
type Assemblies = Vec<(Arc<str>, Vec<Probe>)>;

/// A message, and who wants to know of it.
pub struct Heard<'a> {
    /// Those that want to know of it.
    pub probes: Vec<&'a Probe>,
    /// When it was.
    pub time: Timestamp,
    /// Gives each value that a signal or field has in it, in physical units.
    pub values: &'a Values<'a>,
}

/// Decodes the frames of one bus.
pub enum Listener {
    /// A CAN bus: by message and by assembly of its definition.
    Can { bus: CanBus, messages: Vec<Vec<Probe>>, assemblies: Assemblies },
    /// A serial line: by command of its protocol.
    Serial { decoder: Decoder, protocol: Arc<Protocol>, commands: Vec<Vec<Probe>> },
}

impl Listener {
    /// Nobody asks for anything yet.
    pub fn new(known: Known) -> Self {
        match known {
            Known::Can(definition) => Self::Can {
                messages: vec![Vec::new(); definition.messages().len()],
                assemblies: definition
                    .assemblies()
                    .iter()
                    .map(|assembly| (assembly.name.clone(), Vec::new()))
                    .collect(),
                bus: CanBus::new(definition),
            },
            Known::Serial(protocol) => Self::Serial {
                decoder: Decoder::new(protocol.clone()),
                commands: vec![Vec::new(); protocol.commands.len()],
                protocol,
            },
        }
    }

    /// The names of its messages.
    pub fn names(&self) -> Vec<String> {
        match self {
            Self::Can { bus, .. } => {
                let definition = bus.definition();
                let messages = definition.messages().iter().map(|message| message.name.clone());
                messages.chain(definition.assemblies().iter().map(|a| a.name.to_string())).collect()
            }
            Self::Serial { protocol, .. } => {
                protocol.commands.iter().map(|command| command.name.to_string()).collect()
            }
        }
    }

    /// Lets a rule know of a message, and of a signal or field of it. `None` if there is no such
    /// message; an error with the names there are if it has no such signal.
    pub fn enter(
        &mut self,
        message: &str,
        signal: Option<(&str, Comparison, f64)>,
        (rule, until): (usize, bool),
    ) -> Option<Result<(), Vec<String>>> {
        let probe = |names: Vec<String>, kind| {
            let Some((name, comparison, value)) = signal else {
                return Ok(Probe { rule, until, signal: None, kind });
            };
            match names.iter().position(|known| known == name) {
                Some(at) => Ok(Probe { rule, until, signal: Some((at, comparison, value)), kind }),
                None => Err(names),
            }
        };
        let mut found = None;
        let mut add = |made: Result<Probe, Vec<String>>, to: &mut Vec<Probe>| {
            found = Some(made.map(|probe| to.push(probe)));
        };
        match self {
            Self::Can { bus, messages, assemblies } => {
                for (known, probes) in bus.definition().messages().iter().zip(messages) {
                    if known.name == message {
                        let names = known.signals.iter().map(|signal| signal.name.clone());
                        add(probe(names.collect(), None), probes);
                    }
                }
                for (known, (_, probes)) in bus.definition().assemblies().iter().zip(assemblies) {
                    if *known.name == *message {
                        let names = known.fields.iter().map(|field| field.plan.name.to_string());
                        add(probe(names.collect(), None), probes);
                    }
                }
            }
            Self::Serial { protocol, commands, .. } => {
                for (command, probes) in protocol.commands.iter().zip(commands) {
                    let Some(rest) = message.strip_prefix(&*command.name) else { continue };
                    let kind = KINDS.iter().find(|(ending, _)| *ending == rest);
                    if rest.is_empty() || kind.is_some() {
                        let names = command.fields.fields.iter().map(|plan| plan.name.to_string());
                        add(probe(names.collect(), kind.map(|(_, kind)| *kind)), probes);
                    }
                }
            }
        }
        found
    }

    /// Takes the next frame of the bus.
    pub fn take(&mut self, frame: &Stamped<Frame>, hear: &mut dyn FnMut(Heard<'_>)) {
        match (self, &frame.value) {
            (Self::Can { bus, messages, assemblies }, Frame::Can(can)) => {
                bus.feed(frame.time, can, &mut |item| {
                    hear_can(&item, can, frame.time, (messages, assemblies), hear);
                });
            }
            (Self::Serial { decoder, protocol, commands }, Frame::Serial(bytes)) => {
                decoder.feed(bytes.direction, frame.time, &bytes.data, &mut |item| {
                    hear_serial(&item, protocol, commands, hear);
                });
            }
            _ => {}
        }
    }

    /// Everything from before `time` has been taken.
    pub fn pass(&mut self, time: Timestamp, hear: &mut dyn FnMut(Heard<'_>)) {
        if let Self::Serial { decoder, protocol, commands } = self {
            decoder.pass(time, &mut |item| hear_serial(&item, protocol, commands, hear));
        }
    }

    /// Something was lost: what came before tells nothing about what follows.
    pub fn forget(&mut self) {
        match self {
            Self::Can { bus, .. } => bus.finish(&mut |_| {}),
            Self::Serial { decoder, .. } => decoder.finish(&mut |_| {}),
        }
    }
}

fn hear_can(
    item: &CanItem<'_>,
    frame: &CanFrame,
    time: Timestamp,
    (messages, assemblies): (&[Vec<Probe>], &Assemblies),
    hear: &mut dyn FnMut(Heard<'_>),
) {
    match item {
        CanItem::Message(found) => {
            let Some(probes) = messages.get(found.index).filter(|p| !p.is_empty()) else { return };
            let values =
                |signal, give: &mut dyn FnMut(f64)| signal_value(found, frame, signal, give);
            hear(Heard { probes: probes.iter().collect(), time, values: &values });
        }
        CanItem::Assembly(whole) if whole.complete => {
            let of_name = assemblies.iter().find(|(name, _)| *name == whole.assembly.name);
            let Some((_, probes)) = of_name.filter(|(_, probes)| !probes.is_empty()) else {
                return;
            };
            let values = |field, give: &mut dyn FnMut(f64)| {
                whole.decode(|at, content| {
                    if at == field {
                        let scale = whole.assembly.fields.get(at).and_then(|f| f.plan.scale);
                        let all = match content {
                            Content::One(value) => vec![value],
                            Content::Many(values) => values,
                        };
                        all.iter()
                            .filter_map(PayloadValue::number)
                            .for_each(|n| give(scaled(n, scale)));
                    }
                });
            };
            hear(Heard { probes: probes.iter().collect(), time: whole.ended, values: &values });
        }
        CanItem::Assembly(_) | CanItem::Remote(_) | CanItem::Unknown => {}
    }
}

fn signal_value(found: &Match<'_>, frame: &CanFrame, signal: usize, give: &mut dyn FnMut(f64)) {
    found.decode(frame, |reading| {
        if reading.signal == signal {
            give(match reading.value {
                Value::Unsigned(number) => number as f64,
                Value::Signed(number) => number as f64,
                Value::Float(number) => number,
            });
        }
    });
}

fn hear_serial(
    item: &Item,
    protocol: &Protocol,
    commands: &[Vec<Probe>],
    hear: &mut dyn FnMut(Heard<'_>),
) {
    let ItemKind::Frame(frame) = &item.kind else { return };
    let Some(message) = &frame.message else { return };
    let (asked, kind): (Option<&Asked>, Kind) = match message {
        Message::Request(request) => (Some(&request.asked), Kind::Request),
        Message::Report(report) => (Some(&report.asked), Kind::Report),
        Message::Response(response) => (response.asked.as_ref().ok(), Kind::Response),
        Message::Link { .. } | Message::LinkReply { .. } | Message::Malformed { .. } => return,
    };
    let Some(command) = asked.and_then(|asked| asked.command.as_ref()) else { return };
    let is_it = |known: &Arc<Command>| Arc::ptr_eq(known, command);
    let Some(number) = protocol.commands.iter().position(is_it) else { return };
    let Some(probes) = commands.get(number).filter(|probes| !probes.is_empty()) else { return };
    let wants = |probe: &&Probe| probe.kind.map_or(kind != Kind::Request, |wanted| wanted == kind);
    let values = |number: usize, give: &mut dyn FnMut(f64)| {
        let Some(plan) = command.fields.fields.get(number) else { return };
        let of_plan = message.fields().iter().filter(|field: &&Field| field.plan.name == plan.name);
        let numbers = of_plan.filter_map(|field| field.value.number());
        numbers.for_each(|number| give(scaled(number, plan.scale)));
    };
    hear(Heard { probes: probes.iter().filter(wants).collect(), time: item.time, values: &values });
}

fn scaled(number: f64, scale: Option<(f64, f64)>) -> f64 {
    scale.map_or(number, |(factor, offset)| number * factor + offset)
}
