//! Compiles `[[command]]`.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;

use super::super::error::Fault;
use super::super::message::{ByData, Command};
use super::super::payload::{FieldPlan, FieldType, Payload};
use super::values::{self, Tables};
use super::{ByDataForm, ByteOrder, CommandForm, FieldForm, OneOrMany};

/// Most fields of one command.
const MOST_FIELDS: usize = 4096;
/// Longest data of one command, in bytes.
const LONGEST: usize = 1 << 16;

/// What the fields of all commands share.
pub struct Context<'a> {
    /// `[values]`.
    pub values: &'a Tables,
    /// `[flags]`.
    pub flags: &'a Tables,
    /// Of fields that do not say their own.
    pub order: ByteOrder,
    /// Use assumed value tables.
    pub assume: bool,
}

impl Context<'_> {
    /// Compiles one command.
    pub fn command(&self, spanned: &Spanned<CommandForm>) -> Result<Command, Fault> {
        let (form, span) = (spanned.get_ref(), spanned.span());
        let name = values::name(&form.name, &span)?;
        let ids = match &form.id {
            None => Vec::new(),
            Some(OneOrMany::One(id)) => vec![*id],
            Some(OneOrMany::Many(ids)) => ids.clone(),
        };
        let mut fields = self.payload(&form.fields)?;
        if let Some(records) = &form.records {
            let fixed = fields.fields.iter().all(|field| field.size.is_some());
            if fields.size == 0 || !fixed || records.max == Some(0) {
                let text = format!(
                    "\"{name}\" repeats; expected at least one field, a size for each, and a max of \
                     at least 1"
                );
                return Err(Fault::at(span, text));
            }
            fields.records = Some(records.max.unwrap_or(usize::MAX));
        }
        let by_data = form.by_data.as_ref().map(|form| by_data(form, &span)).transpose()?;
        Ok(Command {
            ids,
            name,
            title: form.title.clone(),
            operations: form.operations.clone(),
            args: self.payload(&form.args)?,
            fields,
            by_data,
        })
    }

    /// Compiles fields that follow each other.
    pub fn payload(&self, forms: &[Spanned<FieldForm>]) -> Result<Payload, Fault> {
        let mut payload = Payload::default();
        let mut names = HashSet::new();
        for spanned in forms {
            let (form, span) = (spanned.get_ref(), spanned.span());
            if payload.fields.last().is_some_and(|last| last.size.is_none()) {
                let text = "the field before takes all bytes that are left; expected a size there";
                return Err(Fault::at(span, text));
            }
            let count = form.count.unwrap_or(1);
            if count == 0 || count > MOST_FIELDS - payload.fields.len() {
                let text = format!("{count} fields; expected 1 to {MOST_FIELDS} in a command");
                return Err(Fault::at(span, text));
            }
            let plan = self.plan(form, &span)?;
            for number in 0..count {
                let name = values::name(&numbered(form, number), &span)?;
                if !names.insert(name.clone()) {
                    let text = format!("the name \"{name}\" is used twice; expected it once");
                    return Err(Fault::at(span, text));
                }
                let at = payload.size;
                payload.size += plan.size.unwrap_or(0);
                payload.fields.push(Arc::new(FieldPlan { name, at, ..plan.clone() }));
            }
            if payload.size > LONGEST {
                let text = format!("data of {} bytes; expected {LONGEST} at most", payload.size);
                return Err(Fault::at(span, text));
            }
        }
        Ok(payload)
    }

    /// What all fields of a form share.
    fn plan(&self, form: &FieldForm, span: &Range<usize>) -> Result<FieldPlan, Fault> {
        let (kind, size) = kind(form, span)?;
        if size.is_none() && form.count.is_some() || size.is_some_and(|size| size > LONGEST) {
            let text = format!(
                "\"{}\"; expected a size of at most {LONGEST}, and no count without a size",
                form.name
            );
            return Err(Fault::at(span.clone(), text));
        }
        let resolve = |form, tables, kind| values::resolve(form, tables, kind, span);
        // A wrong name is an error even when the table is not used.
        let assumed = resolve(form.assumed.as_ref(), self.values, "values")?;
        let values = resolve(form.values.as_ref(), self.values, "values")?;
        let flags = resolve(form.flags.as_ref(), self.flags, "flags")?;
        let named = assumed.is_some() || values.is_some() || flags.is_some();
        if kind != FieldType::Unsigned && named {
            let text =
                format!("\"{}\" has values or flags; expected u8, u16, u32 or u64", form.name);
            return Err(Fault::at(span.clone(), text));
        }
        let scaled = form.scale.is_some() || form.offset.is_some();
        Ok(FieldPlan {
            name: "".into(),
            kind,
            size,
            at: 0,
            order: form.byte_order.unwrap_or(self.order),
            unit: form.unit.as_deref().map(Into::into),
            title: form.title.as_deref().map(Into::into),
            scale: scaled.then_some((form.scale.unwrap_or(1.0), form.offset.unwrap_or(0.0))),
            values: values.or(assumed.filter(|_| self.assume)),
            flags,
        })
    }
}

fn by_data(form: &ByDataForm, span: &Range<usize>) -> Result<ByData, Fault> {
    let mark = values::name(&form.mark, span)?;
    Ok(ByData { from: form.from.as_str().into(), to: form.to.as_str().into(), mark })
}

/// The name of one of `count` fields: the number replaces `{n}`, or stands behind the name.
fn numbered(form: &FieldForm, number: usize) -> String {
    let number = form.first.saturating_add(number).to_string();
    match form.count {
        None => form.name.clone(),
        Some(_) if form.name.contains("{n}") => form.name.replace("{n}", &number),
        Some(_) => format!("{}_{number}", form.name),
    }
}

fn kind(form: &FieldForm, span: &Range<usize>) -> Result<(FieldType, Option<usize>), Fault> {
    let number = |kind, size: usize| {
        if form.size.is_none() {
            return Ok((kind, Some(size)));
        }
        let text = format!("a {} with a size; expected size only for text and bytes", form.kind);
        Err(Fault::at(span.clone(), text))
    };
    match form.kind.as_str() {
        "u8" => number(FieldType::Unsigned, 1),
        "u16" => number(FieldType::Unsigned, 2),
        "u32" => number(FieldType::Unsigned, 4),
        "u64" => number(FieldType::Unsigned, 8),
        "i8" => number(FieldType::Signed, 1),
        "i16" => number(FieldType::Signed, 2),
        "i32" => number(FieldType::Signed, 4),
        "i64" => number(FieldType::Signed, 8),
        "f32" => number(FieldType::Float, 4),
        "f64" => number(FieldType::Float, 8),
        "text" | "bytes" if form.size == Some(0) => {
            Err(Fault::at(span.clone(), "a field of 0 bytes; expected at least 1, or no size"))
        }
        "text" => Ok((FieldType::Text, form.size)),
        "bytes" => Ok((FieldType::Bytes, form.size)),
        other => {
            let text = format!(
                "type \"{other}\" is not known; expected u8, u16, u32, u64, i8, i16, i32, i64, f32, \
                 f64, text or bytes"
            );
            Err(Fault::at(span.clone(), text))
        }
    }
}
