//! Items as JSON, one object each.

use serde_json::{Map, Value as Json, json};

use super::definition::Format;
use super::deframer::Cut;
use super::item::{FrameItem, Item, ItemKind};
use super::message::{Answered, Asked, Message, Request, Response};
use super::payload::{Decoded, Field, Fit, Value};
use super::word::{Reading, hex};

/// An item with the keys of its kind. Its time is the caller's to show.
pub fn item(item: &Item) -> Json {
    match &item.kind {
        ItemKind::Frame(frame) => self::frame(frame),
        ItemKind::Other(cut) => other(cut),
    }
}

fn other(cut: &Cut) -> Json {
    match cut {
        Cut::Garbage { bytes } => json!({"item": "garbage", "bytes": bytes}),
        Cut::Truncated => json!({"item": "truncated"}),
        Cut::Incomplete => json!({"item": "incomplete"}),
        Cut::BadEscape { byte } => {
            json!({"item": "bad_escape", "byte": hex(u64::from(*byte), 8)})
        }
        Cut::CrcError { received, computed, width } => json!({
            "item": "crc_error",
            "crc_received": hex(*received, *width),
            "crc_computed": hex(*computed, *width),
        }),
        Cut::BadLength { bytes } => json!({"item": "bad_length", "bytes": bytes}),
        Cut::TooLong { bytes } => json!({"item": "too_long", "bytes": bytes}),
        Cut::BadEncoding { bytes } => json!({"item": "bad_encoding", "bytes": bytes}),
        Cut::Frame(bytes) => json!({"item": "frame", "data": digits(bytes)}),
    }
}

fn frame(frame: &FrameItem) -> Json {
    let mut object = Map::new();
    object.insert("item".into(), "frame".into());
    for reading in &frame.header {
        show(reading, &mut object);
    }
    if let (Some(side), false) = (frame.side, object.contains_key("from")) {
        object.insert("side".into(), side.name().into());
    }
    object.insert("data".into(), digits(&frame.data).into());
    object.insert("link_error".into(), text(frame.link_error.as_deref()));
    object.insert("message".into(), frame.message.as_ref().map_or(Json::Null, message));
    object.into()
}

/// Adds a number in the way its definition asks for.
fn show(reading: &Reading, object: &mut Map<String, Json>) {
    let quantity = &reading.quantity;
    if quantity.hidden {
        return;
    }
    let label = text(reading.label().map(AsRef::as_ref));
    let shown = match quantity.format {
        Format::Number => reading.value.into(),
        Format::Hex => quantity.hex(reading.value).into(),
        Format::Label => {
            object.insert(quantity.name.to_string(), label);
            return;
        }
    };
    object.insert(quantity.name.to_string(), shown);
    if quantity.values.is_some() {
        object.insert(quantity.label.to_string(), label);
    }
}

fn message(message: &Message) -> Json {
    match message {
        Message::Request(request) => self::request("request", request),
        Message::Report(request) => self::request("report", request),
        Message::Response(response) => self::response(response),
        Message::Link { kind } => json!({"kind": "link", "name": kind_name(kind.as_ref())}),
        Message::LinkReply { kind, answers } => {
            let mut object = json!({"kind": "link_reply", "name": kind_name(kind.as_ref())});
            object["paired"] = answers.is_ok().into();
            match answers {
                Ok(answered) => object["answers"] = self::answered(answered),
                Err(reason) => object["reason"] = (**reason).into(),
            }
            object
        }
        Message::Malformed { response: false, .. } => {
            json!({"kind": "malformed", "reason": "request_too_short"})
        }
        Message::Malformed { response: true, paired } => {
            json!({"kind": "malformed", "reason": "response_too_short", "paired": paired})
        }
    }
}

fn request(kind: &str, request: &Request) -> Json {
    let mut object = Map::new();
    object.insert("kind".into(), kind.into());
    add_asked(&request.asked, &mut object);
    add_data(&request.data, &mut object);
    if let Some(mark) = &request.mark {
        object.insert(mark.to_string(), true.into());
    }
    object.into()
}

fn response(response: &Response) -> Json {
    let mut object = Map::new();
    object.insert("kind".into(), "response".into());
    object.insert("paired".into(), response.asked.is_ok().into());
    let mut status = Map::new();
    for reading in &response.status {
        show(reading, &mut status);
    }
    object.insert("status".into(), status.into());
    match &response.asked {
        Ok(asked) => {
            add_asked(asked, &mut object);
            add_data(&response.data, &mut object);
        }
        Err(reason) => {
            object.insert("reason".into(), (**reason).into());
            object.insert("extra".into(), digits(&response.data.extra).into());
        }
    }
    object.into()
}

fn answered(answered: &Answered) -> Json {
    let mut object = Map::new();
    if let Some(kind) = &answered.kind {
        object.insert(kind.quantity.label.to_string(), kind_name(Some(kind)));
    }
    if let Some(asked) = &answered.asked {
        object.insert("op".into(), text(asked.operation.as_deref()));
        object.insert("cmd_id".into(), id(asked));
    }
    object.into()
}

fn add_asked(asked: &Asked, object: &mut Map<String, Json>) {
    object.insert("op".into(), text(asked.operation.as_deref()));
    object.insert("cmd_id".into(), id(asked));
    object.insert("cmd".into(), text(asked.command.as_ref().map(|command| &*command.name)));
    let args = asked.args.iter().map(|arg| (arg.plan.name.to_string(), value(&arg.value)));
    object.insert("args".into(), Json::Object(args.collect()));
}

fn add_data(data: &Decoded, object: &mut Map<String, Json>) {
    object.insert("fields".into(), data.fields.iter().map(field).collect());
    let fit = data.fit.map(|fit| match fit {
        Fit::Exact => "exact",
        Fit::Short => "short",
        Fit::Long => "long",
    });
    object.insert("check".into(), text(fit));
    object.insert("extra".into(), digits(&data.extra).into());
}

fn field(field: &Field) -> Json {
    let plan = &field.plan;
    let mut object = Map::new();
    object.insert("name".into(), (*plan.name).into());
    object.insert("offset".into(), field.offset.into());
    object.insert("type".into(), plan.type_name().into());
    if let Some(record) = field.record {
        object.insert("record".into(), record.into());
    }
    object.insert("value".into(), value(&field.value));
    match &field.value {
        Value::F32(bits) => {
            object.insert("f32_bits".into(), hex(u64::from(*bits), 32).into());
        }
        Value::F64(bits) => {
            object.insert("f64_bits".into(), hex(*bits, 64).into());
        }
        _ => {}
    }
    if let (Some((scale, offset)), Some(number)) = (plan.scale, field.value.number()) {
        object.insert("scaled".into(), finite(number * scale + offset));
    }
    if plan.values.is_some() {
        object.insert("label".into(), text(field.label().map(AsRef::as_ref)));
    }
    if let Some((set, unknown)) = field.flags() {
        object.insert("flags".into(), set.into_iter().map(|name| Json::from(&**name)).collect());
        object.insert("unknown_flags".into(), unknown.into());
    }
    object.into()
}

fn value(value: &Value) -> Json {
    match value {
        Value::Unsigned(number) => (*number).into(),
        Value::Signed(number) => (*number).into(),
        Value::F32(bits) => finite(f32::from_bits(*bits).into()),
        Value::F64(bits) => finite(f64::from_bits(*bits)),
        Value::Text(bytes) => json!({"text": value.text(), "hex": digits(bytes)}),
        Value::Bytes(bytes) => digits(bytes).into(),
    }
}

/// JSON has no numbers that are not finite.
fn finite(number: f64) -> Json {
    match number {
        _ if number.is_nan() => "NaN".into(),
        f64::INFINITY => "Infinity".into(),
        f64::NEG_INFINITY => "-Infinity".into(),
        _ => number.into(),
    }
}

fn id(asked: &Asked) -> Json {
    asked.id.as_ref().map_or(Json::Null, |id| id.quantity.hex(id.value).into())
}

fn kind_name(kind: Option<&Reading>) -> Json {
    text(kind.and_then(Reading::label).map(AsRef::as_ref))
}

fn text(text: Option<&str>) -> Json {
    text.map_or(Json::Null, Json::from)
}

/// Bytes as hexadecimal digits, lower case, as JSON and people get them.
pub fn digits(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        text.extend([byte >> 4, byte & 15].map(|d| char::from_digit(d.into(), 16).unwrap_or('?')));
        text
    })
}
