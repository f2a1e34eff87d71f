//! From the bytes of a line to what they say.

use std::sync::Arc;

use super::condition::Side;
use super::definition::Carries;
use super::deframer::{Cut, Deframer};
use super::item::{FrameItem, Item, ItemKind};
use super::message::{Answered, Asked, Command, Message, Reason, Request, Response};
use super::pairing::Pairing;
use super::payload::{Decoded, Payload};
use super::word::Reading;
use super::{MessageRules, Protocol};
use crate::frame::{Direction, Timestamp};

/// Decodes both directions of one line.
#[derive(Debug)]
pub struct Decoder {
    protocol: Arc<Protocol>,
    rx: Deframer,
    tx: Deframer,
    pairing: Pairing,
}

impl Decoder {
    /// Begins between frames, with no request waiting.
    pub fn new(protocol: Arc<Protocol>) -> Self {
        let framing = &protocol.framing;
        let (rx, tx) = (Deframer::new(framing.clone()), Deframer::new(framing.clone()));
        Self { protocol, rx, tx, pairing: Pairing::default() }
    }

    /// Takes bytes as one read returned them, and the time of that read.
    pub fn feed(
        &mut self,
        direction: Direction,
        time: Timestamp,
        bytes: &[u8],
        take: &mut dyn FnMut(Item),
    ) {
        let (deframer, other, back) = match direction {
            Direction::Rx => (&mut self.rx, &mut self.tx, Direction::Tx),
            Direction::Tx => (&mut self.tx, &mut self.rx, Direction::Rx),
        };
        let (protocol, pairing) = (&*self.protocol, &mut self.pairing);
        other.pass(time, &mut |time, cut| {
            take(protocol.item(pairing, back, time, cut));
        });
        deframer.feed(time, bytes, &mut |time, cut| {
            take(protocol.item(pairing, direction, time, cut));
        });
    }

    /// Says that it is `time` and nothing from before it will come any more; where silence ends
    /// frames, they may end now.
    pub fn pass(&mut self, time: Timestamp, take: &mut dyn FnMut(Item)) {
        let (protocol, pairing) = (&*self.protocol, &mut self.pairing);
        for (direction, deframer) in [(Direction::Tx, &mut self.tx), (Direction::Rx, &mut self.rx)]
        {
            deframer.pass(time, &mut |time, cut| {
                take(protocol.item(pairing, direction, time, cut));
            });
        }
    }

    /// Says that the input has ended, or that something was lost here: open frames end, requests
    /// are forgotten.
    pub fn finish(&mut self, take: &mut dyn FnMut(Item)) {
        let (protocol, pairing) = (&*self.protocol, &mut self.pairing);
        for (direction, deframer) in [(Direction::Tx, &mut self.tx), (Direction::Rx, &mut self.rx)]
        {
            deframer.finish(&mut |time, cut| take(protocol.item(pairing, direction, time, cut)));
        }
        self.pairing.clear();
    }
}

/// A frame on its way to becoming a message.
struct Seen<'a> {
    header: Vec<Reading>,
    values: Vec<u64>,
    data: &'a [u8],
    side: Option<Side>,
}

impl Protocol {
    fn item(&self, pairing: &mut Pairing, way: Direction, time: Timestamp, cut: Cut) -> Item {
        let kind = match cut {
            Cut::Frame(bytes) => ItemKind::Frame(Box::new(self.frame(pairing, way, bytes))),
            other => ItemKind::Other(other),
        };
        Item { time, direction: way, kind }
    }

    fn frame(&self, pairing: &mut Pairing, way: Direction, bytes: Vec<u8>) -> FrameItem {
        let layout = &self.framing.layout;
        let header = layout.header.read(&bytes);
        let values: Vec<u64> = header.iter().map(|reading| reading.value).collect();
        let side = self.direction.as_ref().and_then(|rule| rule.side(way, &values));
        let data = layout.data(&bytes);
        let number = |index: usize| values.get(index).copied();
        let link_error = self
            .checks
            .iter()
            .find(|check| {
                check.when.holds(side, number)
                    && (check.unless.is_empty() || !check.unless.holds(side, number))
            })
            .map(|check| check.name.clone());
        let seen = Seen { header, values, data, side };
        let message = match link_error {
            Some(_) => None,
            None => self.message(pairing, &seen),
        };
        let (header, data) = (seen.header, data.to_vec());
        FrameItem { bytes, header, data, side, link_error, message }
    }

    fn message(&self, pairing: &mut Pairing, seen: &Seen<'_>) -> Option<Message> {
        let is = |rules: &&MessageRules| {
            rules.when.holds(seen.side, |index| seen.values.get(index).copied())
        };
        if let Some(rules) = self.report.as_ref().filter(is) {
            let malformed = Message::Malformed { response: false, paired: None };
            return Some(self.request(rules, seen).map_or(malformed, Message::Report));
        }
        match (seen.side?, self.request.as_ref().filter(is), self.response.as_ref().filter(is)) {
            (Side::Request, Some(rules), _) => Some(self.ask(rules, pairing, seen)),
            (Side::Response, _, Some(rules)) => Some(self.answer(rules, pairing, seen)),
            (Side::Request, None, _) => {
                let kind = self.link_kind(seen);
                if let Some(rules) = &self.pairing {
                    let frame = Answered { kind: kind.clone(), asked: None };
                    pairing.ask(rules, &seen.values, frame);
                }
                Some(Message::Link { kind })
            }
            (Side::Response, _, None) => {
                let answers = self.pair(pairing, seen, false);
                Some(Message::LinkReply { kind: self.link_kind(seen), answers })
            }
        }
    }

    fn link_kind(&self, seen: &Seen<'_>) -> Option<Reading> {
        seen.header.get(self.link?).cloned()
    }

    fn pair(
        &self,
        pairing: &mut Pairing,
        seen: &Seen<'_>,
        response: bool,
    ) -> Result<Answered, Reason> {
        match &self.pairing {
            Some(rules) => pairing.answer(rules, &seen.values, response),
            None => Err(Pairing::none()),
        }
    }

    /// A request, which now waits for its answer.
    fn ask(&self, rules: &MessageRules, pairing: &mut Pairing, seen: &Seen<'_>) -> Message {
        let request = self.request(rules, seen);
        if let Some(pair) = &self.pairing {
            match &request {
                Some(request) => {
                    let asked = Some(request.asked.clone());
                    let frame = Answered { kind: self.link_kind(seen), asked };
                    pairing.ask(pair, &seen.values, frame);
                }
                None => pairing.forget(pair, &seen.values),
            }
        }
        match request {
            Some(request) => Message::Request(request),
            None => Message::Malformed { response: false, paired: None },
        }
    }

    /// Decodes a request or report; `None` when it is too short.
    fn request(&self, rules: &MessageRules, seen: &Seen<'_>) -> Option<Request> {
        let (prefix, data) = seen.data.split_at_checked(rules.prefix.end)?;
        let numbers: Vec<Reading> =
            seen.header.iter().cloned().chain(rules.prefix.read(prefix)).collect();
        let id = rules.command.and_then(|index| numbers.get(index).cloned());
        let command = self.command(id.as_ref());
        let said = match rules.operation {
            Some(index) => numbers.get(index).and_then(Reading::label),
            None => self.only_operation.as_ref(),
        };
        let by_data = command.as_ref().and_then(|command| command.by_data_of(said, data));
        let operation = by_data.map(|rule| &rule.to).or(said).cloned();
        let mark = by_data.map(|rule| rule.mark.clone());
        let carries = match &operation {
            Some(name) => self.operations.get(name).map(|operation| operation.request),
            None => rules.unnamed,
        };
        let mut decoded = decode(command.as_deref(), carries, data);
        let args = match carries {
            Some(Carries::Args) => std::mem::take(&mut decoded.fields),
            _ => Vec::new(),
        };
        let asked = Asked { operation, id, command, args };
        Some(Request { asked, data: decoded, mark })
    }

    fn answer(&self, rules: &MessageRules, pairing: &mut Pairing, seen: &Seen<'_>) -> Message {
        let paired = self.pair(pairing, seen, true);
        let Some((prefix, data)) = seen.data.split_at_checked(rules.prefix.end) else {
            return Message::Malformed { response: true, paired: Some(paired.is_ok()) };
        };
        let status = rules.prefix.read(prefix);
        let header = seen.values.len();
        let number = |index: usize| match index.checked_sub(header) {
            None => seen.values.get(index).copied(),
            Some(index) => status.get(index).map(|reading| reading.value),
        };
        let ok = rules.ok.holds(seen.side, number);
        let asked = paired.map(|frame| frame.asked.unwrap_or_default());
        let data = match &asked {
            Err(_) => Decoded::unknown(data),
            Ok(_) if !ok => Payload::default().decode(data),
            Ok(asked) => {
                let carries = match &asked.operation {
                    Some(name) => self.operations.get(name).map(|operation| operation.response),
                    None => rules.unnamed,
                };
                decode(asked.command.as_deref(), carries, data)
            }
        };
        Message::Response(Response { status, asked, data })
    }

    fn command(&self, id: Option<&Reading>) -> Option<Arc<Command>> {
        match id {
            Some(id) => self.by_id.get(&id.value).cloned(),
            None => self.commands.first().cloned(),
        }
    }
}

/// Decodes data of a command that may be unknown.
fn decode(command: Option<&Command>, carries: Option<Carries>, data: &[u8]) -> Decoded {
    match (carries, command) {
        (None, _) => Decoded::unknown(data),
        (Some(Carries::Nothing), _) => Payload::default().decode(data),
        (Some(_), None) => Decoded::unknown(data),
        (Some(Carries::Args), Some(command)) => command.args.decode(data),
        (Some(Carries::Fields), Some(command)) => command.fields.decode(data),
    }
}
