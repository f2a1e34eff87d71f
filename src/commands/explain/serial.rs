//! What the bytes of a serial line say, for a person or as JSON: the serial half of `explain`.

use std::fs;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result, anyhow};

use crate::decode::rules;
use crate::frame::{Direction, Timestamp};
use crate::protocol::message::Message;
use crate::protocol::payload::{Field, Value};
use crate::protocol::{BUILT_IN, Decoder, Item, ItemKind, Protocol, Settings, json};
use crate::text::{printable, printable_json};

/// A protocol, and what it was made of.
pub struct SerialFiles {
    /// What bytes mean.
    pub protocol: Protocol,
    /// The file of the definition; `None` for those that come with the program.
    pub file: Option<String>,
    /// The definition.
    pub text: String,
}

/// Loads `zhongheng-09[:byte_order=little]` or a definition file `FILE.toml[:...]`; `None` when
/// `text` names no serial protocol, or a file that is about CAN.
pub fn load(text: &str) -> Result<Option<Protocol>> {
    Ok(load_files(text)?.map(|loaded| loaded.protocol))
}

/// The same, with the definition itself.
pub fn load_files(text: &str) -> Result<Option<SerialFiles>> {
    let (name, settings) = match text.rsplit_once(':') {
        Some((name, settings)) if settings.contains('=') => (name, settings),
        _ => (text, ""),
    };
    let settings = Settings::parse(settings).map_err(|why| anyhow!(why))?;
    if let Some(protocol) = Protocol::built_in(name, settings) {
        let built_in = BUILT_IN.iter().find(|(known, _)| *known == name);
        let text = built_in.map_or("", |(_, text)| text).to_owned();
        return Ok(Some(SerialFiles { protocol: protocol?, file: None, text }));
    }
    if Path::new(name).extension().is_none_or(|extension| extension != "toml") {
        return Ok(None);
    }
    let definition = fs::read_to_string(name).with_context(|| format!("cannot read {name}"))?;
    if rules::is_can(&definition) {
        return Ok(None);
    }
    let protocol = Protocol::parse(name, &definition, settings)?;
    Ok(Some(SerialFiles { protocol, file: Some(name.to_owned()), text: definition }))
}

/// Bytes from hexadecimal digits; blanks, colons, commas and `0x` between them do not matter.
pub fn from_hex(text: &str) -> Result<Vec<u8>> {
    let plain = text.replace("0x", " ").replace("0X", " ");
    let mut bytes = Vec::new();
    for word in plain.split(|c: char| c.is_ascii_whitespace() || matches!(c, ':' | ',' | '-')) {
        let digits = word.as_bytes();
        for pair in digits.chunks(2) {
            let pair = std::str::from_utf8(pair).unwrap_or("?");
            let byte = u8::from_str_radix(pair, 16).ok().filter(|_| pair.len() == 2);
            bytes.push(byte.ok_or_else(|| {
                anyhow!("\"{}\" is not hexadecimal; expected pairs of 0-9, a-f", printable(word))
            })?);
        }
    }
    Ok(bytes)
}

/// Prints what is in `input`, piece by piece, so that it may be of any length.
pub fn explain(
    protocol: Protocol,
    input: &mut impl Read,
    json: bool,
    out: &mut impl Write,
) -> Result<()> {
    let mut decoder = Decoder::new(Arc::new(protocol));
    let mut piece = vec![0; 64 << 10];
    let mut result = Ok(());
    loop {
        let length = input.read(&mut piece).context("cannot read the bytes to explain")?;
        let mut take = |item: Item| {
            if result.is_ok() {
                result = print(&item, json, out);
            }
        };
        if length == 0 {
            decoder.finish(&mut take);
            return result;
        }
        decoder.feed(Direction::Rx, Timestamp(0), &piece[..length], &mut take);
        std::mem::replace(&mut result, Ok(()))?;
    }
}

fn print(item: &Item, json: bool, out: &mut impl Write) -> Result<()> {
    let object = json::item(item);
    if json {
        writeln!(out, "{}", printable_json(&object.to_string()))?;
        return Ok(());
    }
    writeln!(out, "{}", printable(&sentence(&object)))?;
    let message = match &item.kind {
        ItemKind::Frame(frame) => frame.message.as_ref(),
        ItemKind::Other(_) => None,
    };
    for field in message.map_or(&[][..], Message::fields) {
        writeln!(out, "    {}", printable(&line(field)))?;
    }
    Ok(())
}

/// The keys of an item that are not fields, in one line.
fn sentence(object: &serde_json::Value) -> String {
    let mut words = Vec::new();
    add_words(object, &mut words);
    words.join(" ")
}

fn add_words(object: &serde_json::Value, words: &mut Vec<String>) {
    for (key, value) in object.as_object().into_iter().flatten() {
        match value {
            serde_json::Value::Null => {}
            _ if key == "fields" => {}
            // What is understood need not be shown as digits too.
            _ if key == "data" && !object["message"].is_null() => {}
            serde_json::Value::Object(_) => add_words(value, words),
            serde_json::Value::String(text) if text.is_empty() => {}
            serde_json::Value::String(text) if ["item", "kind", "op", "cmd"].contains(&&**key) => {
                words.push(text.clone());
            }
            serde_json::Value::String(text) => words.push(format!("{key} {text}")),
            other => words.push(format!("{key} {other}")),
        }
    }
}

/// A field: name, value, unit, meaning.
fn line(field: &Field) -> String {
    let plan = &field.plan;
    let record = field.record.map_or(String::new(), |record| format!("[{record}]"));
    let value = match (&field.value, plan.scale) {
        (Value::Text(bytes) | Value::Bytes(bytes), _) => match field.value.text() {
            Some(text) => format!("\"{text}\""),
            None => json::digits(bytes),
        },
        (Value::Unsigned(number), None) => number.to_string(),
        (Value::Signed(number), None) => number.to_string(),
        (Value::F32(bits), None) => f32::from_bits(*bits).to_string(),
        (value, scale) => {
            let (scale, offset) = scale.unwrap_or((1.0, 0.0));
            (value.number().unwrap_or(f64::NAN) * scale + offset).to_string()
        }
    };
    let mut text = format!("{:<40} {value}", format!("{}{record}", plan.name));
    let unit = plan.unit.as_deref();
    let (flags, unknown) = field.flags().unwrap_or_default();
    let meanings = field.label().into_iter().chain(flags).map(AsRef::as_ref);
    for word in unit.into_iter().chain(meanings) {
        text.push(' ');
        text.push_str(word);
    }
    if unknown != 0 {
        return format!("{text} and unknown bits {unknown:#x}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn explained(protocol: &str, hex: &str, json: bool) -> String {
        let bytes = from_hex(hex).unwrap();
        let mut out = Vec::new();
        explain(load(protocol).unwrap().unwrap(), &mut &bytes[..], json, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    /// Connect and acknowledge, as printed by the protocol's document.
    const LINK: &str = "7E 7D 20 7D 20 40 7D 21 7D 20 EB A3 7E000186:01FF17B0";

    #[test]
    fn frames_are_explained_in_a_line_each_or_as_json() {
        let text = explained("zhongheng-09", LINK, false);
        assert!(text.starts_with("frame addr 0 control 0x40 from master"), "{text}");
        assert_eq!(text.lines().count(), 2);
        let json = explained("zhongheng-09:byte_order=little", LINK, true);
        let second: serde_json::Value = serde_json::from_str(json.lines().nth(1).unwrap()).unwrap();
        assert_eq!(second["message"]["answers"]["dl_name"], "DL_CONNECT");
    }

    #[test]
    fn fields_have_their_unit_and_their_meaning() {
        // A set of the audible alarm, then one of a command that is only read.
        let alarm = "7E 00 09 45 03 82 8C 14 ";
        let meter = from_hex(alarm).unwrap();
        let crc = crate::protocol::crc::Checksum::by_name("CRC_16_XMODEM").unwrap().of(&meter);
        let text = explained("zhongheng-09:assume=true", &format!("{alarm}{crc:04x}"), false);
        assert!(text.contains("request set cmd_id 0x028c enable_audible_indication"), "{text}");
        let field = text.lines().nth(1).unwrap().split_whitespace().collect::<Vec<_>>();
        assert_eq!(field, ["audible_alarm_enable", "20", "enable"]);
    }

    #[test]
    fn what_is_no_protocol_and_no_hex_is_said() {
        assert!(load("station.dbc").unwrap().is_none());
        assert!(load("no-such.toml").unwrap_err().to_string().contains("cannot read no-such.toml"));
        assert!(load("zhongheng-09:order=big").unwrap_err().to_string().contains("not known"));
        assert!(from_hex("7E 0").unwrap_err().to_string().contains("\"0\" is not hexadecimal"));
    }
}
