//! Compiles `[framing]`, `[[header]]` and `[crc]`.

use std::ops::Range;

use toml::Spanned;

use super::super::crc::{Checksum, NAMES};
use super::super::error::Fault;
use super::super::framing::{Escape, FrameCheck, Framing, Kind, Layout, Total};
use super::super::word::Block;
use super::values::{Tables, one_of};
use super::{Definition, EscapeForm, FramingForm, words};

/// Longest frame that a definition may ask for, in bytes.
const LONGEST: usize = 1 << 20;
/// Longest frame when a definition says nothing: a 16-bit length and what it may not count.
const USUAL_LONGEST: usize = (1 << 16) + 64;
/// Longest start flag or delimiter, in bytes.
const LONGEST_FLAG: usize = 8;

/// Which keys the kinds take beside `kind`, `length`, `size` and `max`.
const KINDS: &[(&str, &[&str])] = &[
    ("start_flag", &["start", "escape"]),
    ("fixed", &["start", "escape"]),
    ("delimiter", &["start", "end", "escape"]),
    ("slip", &[]),
    ("cobs", &[]),
    ("silence", &["gap_us"]),
];

/// Compiles how frames are cut and what is in them.
pub fn framing(definition: &Definition, tables: &Tables) -> Result<Framing, Fault> {
    let (form, span) = (definition.framing.get_ref(), definition.framing.span());
    check_keys(form)?;
    let kind = kind(form, &span)?;
    let start = match &kind {
        Kind::Counted { start, .. } => start.len(),
        Kind::Delimited { start, .. } => usize::from(start.is_some()),
        Kind::Silence(_) => 0,
    };
    let header = words::block(&definition.header, start, tables)?;
    let max = form.max.as_ref().map_or(USUAL_LONGEST, |max| *max.get_ref());
    let mut layout = Layout { header, total: None, check: check(definition)?, max };
    let least = layout.overhead().max(1);
    if max < least || max > LONGEST {
        let at = form.max.as_ref().map_or(span, Spanned::span);
        let text = format!("a frame of {max} bytes at most; expected {least} to {LONGEST}");
        return Err(Fault::at(at, text));
    }
    layout.total = total(form, &layout, &span)?;
    Ok(Framing { kind, layout })
}

fn check_keys(form: &FramingForm) -> Result<(), Fault> {
    let kind = form.kind.get_ref().as_str();
    let Some((_, takes)) = KINDS.iter().find(|(name, _)| *name == kind) else {
        let names: Vec<&str> = KINDS.iter().map(|(name, _)| *name).collect();
        let text = format!("framing \"{kind}\" is not known; expected {}", one_of(&names, ""));
        return Err(Fault::at(form.kind.span(), text));
    };
    let given = [
        ("start", form.start.as_ref().map(Spanned::span)),
        ("end", form.end.as_ref().map(Spanned::span)),
        ("escape", form.escape.as_ref().map(Spanned::span)),
        ("gap_us", form.gap_us.as_ref().map(Spanned::span)),
    ];
    for (key, span) in given {
        let Some(span) = span.filter(|_| !takes.contains(&key)) else { continue };
        let text = format!(
            "framing \"{kind}\" has no {key}; expected {}",
            one_of(takes, "none of start, end, escape and gap_us")
        );
        return Err(Fault::at(span, text));
    }
    Ok(())
}

fn kind(form: &FramingForm, span: &Range<usize>) -> Result<Kind, Fault> {
    let start = form.start.as_ref();
    let escape = form.escape.as_ref();
    Ok(match form.kind.get_ref().as_str() {
        "start_flag" | "fixed" => {
            let start = flag(start, "start", span)?;
            Kind::Counted { escape: escaped(escape, &start)?, start }
        }
        "delimiter" => {
            let end = flag(form.end.as_ref(), "end", span)?;
            let escape = escaped(escape, &end)?;
            let start = match start.map(|start| (start.get_ref().as_slice(), start.span())) {
                None => None,
                Some(([byte], _)) => Some(*byte),
                Some((_, span)) => {
                    return Err(Fault::at(span, "a start in front of lines; expected one byte"));
                }
            };
            Kind::Delimited { start, end, escape, cobs: false }
        }
        "slip" => {
            let mut table = Box::new([None; 256]);
            (table[0xDC], table[0xDD]) = (Some(0xC0), Some(0xDB));
            let escape = Some(Escape { byte: 0xDB, table });
            Kind::Delimited { start: None, end: vec![0xC0], escape, cobs: false }
        }
        "cobs" => Kind::Delimited { start: None, end: vec![0], escape: None, cobs: true },
        _ => Kind::Silence(gap(form, span)?),
    })
}

/// Silence in ns.
fn gap(form: &FramingForm, span: &Range<usize>) -> Result<u64, Fault> {
    let gap = form.gap_us.as_ref();
    if let Some(gap) = gap.map(|gap| *gap.get_ref()).filter(|gap| (1..=60_000_000).contains(gap)) {
        return Ok(gap * 1000);
    }
    let at = gap.map_or(span.clone(), Spanned::span);
    Err(Fault::at(at, "the silence between frames; expected gap_us of 1 to 60000000"))
}

fn flag(form: Option<&Spanned<Vec<u8>>>, key: &str, span: &Range<usize>) -> Result<Vec<u8>, Fault> {
    let bytes = form.map_or(&[][..], |form| form.get_ref());
    if (1..=LONGEST_FLAG).contains(&bytes.len()) {
        return Ok(bytes.to_vec());
    }
    let at = form.map_or(span.clone(), Spanned::span);
    let text = format!("{key} of {} bytes; expected 1 to {LONGEST_FLAG}", bytes.len());
    Err(Fault::at(at, text))
}

fn escaped(form: Option<&Spanned<EscapeForm>>, flag: &[u8]) -> Result<Option<Escape>, Fault> {
    let Some(spanned) = form else { return Ok(None) };
    let (form, span) = (spanned.get_ref(), spanned.span());
    if flag.len() != 1 || flag == [form.byte] {
        let text = "an escape keeps one flag byte out of the frames; expected a flag of one byte \
                    that is not the escape byte";
        return Err(Fault::at(span, text));
    }
    let mut table = Box::new([None; 256]);
    let all = vec![(0x00, 0xFF)];
    for (from, to) in form.follows.as_ref().unwrap_or(&all) {
        for byte in *from..=*to {
            table[usize::from(byte)] = Some(byte ^ form.xor);
        }
    }
    Ok(Some(Escape { byte: form.byte, table }))
}

fn total(form: &FramingForm, layout: &Layout, span: &Range<usize>) -> Result<Option<Total>, Fault> {
    let needed = match form.kind.get_ref().as_str() {
        "start_flag" if form.length.is_none() => Some("length"),
        "fixed" if form.size.is_none() => Some("size"),
        _ => None,
    };
    if let Some(needed) = needed {
        let text = format!(
            "framing \"{}\" does not say where a frame ends; expected {needed}",
            form.kind.get_ref()
        );
        return Err(Fault::at(span.clone(), text));
    }
    match (&form.length, &form.size) {
        (None, None) => Ok(None),
        (Some(_), Some(size)) => {
            Err(Fault::at(size.span(), "a frame with length and size; expected one of them"))
        }
        (None, Some(size)) if (layout.overhead()..=layout.max).contains(size.get_ref()) => {
            Ok(Some(Total::Size(*size.get_ref())))
        }
        (None, Some(size)) => {
            let (least, most) = (layout.overhead(), layout.max);
            let text = format!("a frame of {} bytes; expected {least} to {most}", size.get_ref());
            Err(Fault::at(size.span(), text))
        }
        (Some(length), None) => {
            let (form, span) = (length.get_ref(), length.span());
            let quantity = header_number(&layout.header, &form.field, &span)?;
            let quantity = layout.header.quantities[quantity].clone();
            Ok(Some(Total::Length { quantity, add: form.add }))
        }
    }
}

/// The place of a number in the header, by its name.
pub fn header_number(header: &Block, name: &str, span: &Range<usize>) -> Result<usize, Fault> {
    header.quantities.iter().position(|quantity| &*quantity.name == name).ok_or_else(|| {
        let names: Vec<&str> = header.quantities.iter().map(|it| &*it.name).collect();
        let text = format!(
            "there is no \"{name}\" in the header; expected {}",
            one_of(&names, "a [[header]] that has it")
        );
        Fault::at(span.clone(), text)
    })
}

fn check(definition: &Definition) -> Result<Option<FrameCheck>, Fault> {
    let Some(spanned) = &definition.crc else { return Ok(None) };
    let (form, span) = (spanned.get_ref(), spanned.span());
    let sum = Checksum::by_name(&form.name).ok_or_else(|| {
        let same_width: Vec<&str> = NAMES
            .iter()
            .filter(|name| {
                form.name.get(..6).is_some_and(|start| name.starts_with(&start.to_uppercase()))
            })
            .copied()
            .collect();
        let text = format!(
            "CRC \"{}\" is not in the catalogue; expected {}",
            form.name,
            one_of(&same_width, "a name like CRC_16_MODBUS, CRC_8_SMBUS or SUM_8")
        );
        Fault::at(span.clone(), text)
    })?;
    if form.from > LONGEST_FLAG {
        let text = format!("a CRC from byte {} on; expected 0 to {LONGEST_FLAG}", form.from);
        return Err(Fault::at(span, text));
    }
    Ok(Some(FrameCheck { sum, order: form.byte_order, from: form.from }))
}
