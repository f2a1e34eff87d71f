//! Messages of several frames, explained.

use serde_json::{Map, Value as Json, json};

use super::super::output;
use super::json::float;
use crate::decode::assembly::{Assembled, AssemblyField, Content, text as as_text};
use crate::frame::Timestamp;
use crate::protocol::json::digits;
use crate::protocol::payload::{Field, Value};
use crate::text::{printable, printable_json, rfc3339};

/// A line of JSON, or a line and one for each field.
pub fn text(
    assembled: &Assembled<'_>,
    time: Option<Timestamp>,
    bus: Option<&str>,
    json: bool,
) -> String {
    if json { to_json(assembled, time, bus) } else { plain(assembled, time, bus) }
}

fn to_json(assembled: &Assembled<'_>, time: Option<Timestamp>, bus: Option<&str>) -> String {
    let assembly = assembled.assembly;
    let mut object = Map::new();
    let mut put = |key: &str, value: Json| object.insert(key.to_owned(), value);
    put("time", json!(time.map(rfc3339)));
    put("bus", json!(bus));
    put("assembly", json!(&*assembly.kind));
    put("dir", json!(assembly.direction));
    put("complete", json!(assembled.complete));
    for (key, value) in &assembly.constants {
        put(key, json!(&**value));
    }
    let mut contents = contents(assembled);
    for (field, content) in assembly.fields.iter().zip(&mut contents) {
        let content = content.take();
        let label = content.as_ref().and_then(|content| label(field, content));
        put(
            &field.plan.name,
            match content {
                None => Json::Null,
                Some(Content::One(value)) => number(field, &value),
                Some(Content::Many(values)) => values.iter().map(|v| number(field, v)).collect(),
            },
        );
        if let Some(key) = &field.label {
            put(key, json!(label));
        }
    }
    if let Some(raw) = &assembly.raw {
        put(raw, json!(digits(assembled.bytes)));
    }
    // Its texts come from the bus.
    format!("{}\n", printable_json(&Json::Object(object).to_string()))
}

/// By field.
fn contents(assembled: &Assembled<'_>) -> Vec<Option<Content>> {
    let mut contents = vec![None; assembled.assembly.fields.len()];
    assembled.decode(|field, content| contents[field] = Some(content));
    contents
}

fn label(field: &AssemblyField, content: &Content) -> Option<String> {
    let Content::One(Value::Unsigned(value)) = content else { return None };
    field.plan.values.as_ref()?.get(value).map(ToString::to_string)
}

fn number(field: &AssemblyField, value: &Value) -> Json {
    if let (Some((scale, offset)), Some(number)) = (field.plan.scale, value.number()) {
        return float(number * scale + offset);
    }
    match value {
        Value::Unsigned(number) => json!(number),
        Value::Signed(number) => json!(number),
        Value::F32(bits) => float(f32::from_bits(*bits).into()),
        Value::F64(bits) => float(f64::from_bits(*bits)),
        Value::Text(bytes) => json!(as_text(bytes)),
        Value::Bytes(bytes) => json!(digits(bytes)),
    }
}

fn plain(assembled: &Assembled<'_>, time: Option<Timestamp>, bus: Option<&str>) -> String {
    let assembly = assembled.assembly;
    let mut head = Vec::new();
    head.extend(time.map(rfc3339));
    head.extend(bus.map(printable));
    head.push(format!("= {}", assembly.name));
    head.extend(assembly.direction.as_deref().map(printable));
    let state = if assembled.complete { "complete" } else { "incomplete" };
    let (bytes, frames) = (assembled.bytes.len(), assembled.frames);
    head.push(format!("{state}: {bytes} bytes in {frames} frames"));
    let mut rows = Vec::new();
    for (key, value) in &assembly.constants {
        rows.push(vec![format!(" {key}"), value.to_string()]);
    }
    for (field, content) in assembly.fields.iter().zip(contents(assembled)) {
        let Some(content) = content else { continue };
        let plan = &field.plan;
        let mut words = match &content {
            Content::One(value) => vec![shown(field, value)],
            Content::Many(values) => values.iter().map(|value| shown(field, value)).collect(),
        };
        words.extend(plan.unit.as_deref().map(str::to_owned));
        words.extend(label(field, &content));
        words.extend(flags(field, &content));
        rows.push(vec![format!(" {}", plan.name), words.join(" ")]);
    }
    if let Some(raw) = &assembly.raw {
        rows.push(vec![format!(" {raw}"), digits(assembled.bytes)]);
    }
    format!("{}\n{}", head.join("  "), output::table(&[], &[], rows))
}

fn shown(field: &AssemblyField, value: &Value) -> String {
    match number(field, value) {
        Json::String(text) if matches!(value, Value::Text(_)) => format!("\"{text}\""),
        Json::String(text) => text,
        other => other.to_string(),
    }
}

fn flags(field: &AssemblyField, content: &Content) -> Vec<String> {
    let Content::One(value) = content else { return Vec::new() };
    let field = Field { plan: field.plan.clone(), offset: 0, record: None, value: value.clone() };
    let (known, unknown) = field.flags().unwrap_or_default();
    let unknown = (unknown != 0).then(|| format!("and unknown bits {unknown:#x}"));
    known.into_iter().map(ToString::to_string).chain(unknown).collect()
}
