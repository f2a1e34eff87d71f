//! Compiles `[[assembly]]`.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;

use super::compile::{message, new_name};
use super::forms::{AssemblyForm, RulesForm};
use crate::decode::assembly::{Assembly, AssemblyField, LONGEST, Parts};
use crate::decode::can::key;
use crate::decode::dbc::{Database, Number};
use crate::protocol::definition::compile::tables;
use crate::protocol::definition::payloads::Context;
use crate::protocol::definition::values::{Tables, name, one_of};
use crate::protocol::definition::{FieldForm, ValuesForm};
use crate::protocol::error::Fault;
use crate::protocol::payload::{FieldPlan, FieldType, Payload};

/// Compiles all of them.
pub fn compile(
    form: &mut RulesForm,
    database: &Database,
    names: &mut HashSet<String>,
) -> Result<Vec<Assembly>, Fault> {
    let mut values = tables(&form.values)?;
    let flags = tables(&form.flags)?;
    for assembly in &form.assembly {
        add_tables(&assembly.get_ref().fields, database, &mut values);
    }
    let order = form.byte_order;
    let context = Context { values: &values, flags: &flags, order, assume: true };
    let mut assemblies = Vec::new();
    for spanned in std::mem::take(&mut form.assembly) {
        let span = spanned.span();
        let form = spanned.into_inner();
        let name = new_name(&form.name, names)?;
        assemblies.push(assembly(form, &span, name.into(), database, &context)?);
    }
    Ok(assemblies)
}

/// Fields may use the value table of a signal of the database, by the name `MESSAGE.SIGNAL`.
fn add_tables(fields: &[Spanned<FieldForm>], database: &Database, tables: &mut Tables) {
    for field in fields {
        let Some(ValuesForm::Name(wanted)) = &field.get_ref().values else { continue };
        let Some((message, signal)) = wanted.split_once('.') else { continue };
        let message = database.messages.iter().find(|m| m.name == message);
        let signal = message.and_then(|m| m.signals.iter().find(|s| s.name == signal));
        let Some(labels) = signal.filter(|s| s.number == Number::Unsigned).map(|s| &s.labels)
        else {
            continue;
        };
        let labels = labels.iter().flat_map(|labels| labels.iter());
        let known = labels.filter_map(|(value, text)| {
            Some((u64::try_from(*value).ok()?, Arc::from(text.as_ref())))
        });
        tables.insert(wanted.clone(), Arc::new(known.collect()));
    }
}

fn assembly(
    mut form: AssemblyForm,
    span: &Range<usize>,
    name: Arc<str>,
    database: &Database,
    context: &Context<'_>,
) -> Result<Assembly, Fault> {
    let repeated = repeated(&mut form.fields, context)?;
    let head = context.payload(&form.fields)?;
    if repeated.is_some() && head.fields.iter().any(|field| field.size.is_none()) {
        let text = "a field of all bytes that are left in front of a repeated one; expected a size";
        return Err(Fault::at(span.clone(), text));
    }
    let fields = fields(&form, &head, repeated)?;
    let parts = parts(&form, span, &head, database)?;
    let first = match &parts {
        Parts::Listed(list) => list.first().map(|(index, _)| *index),
        Parts::Counted { .. } => form.first.as_ref().and_then(|m| message(m, database).ok()),
    };
    let first = first.and_then(|index| database.messages.get(index));
    let constants = form
        .constants
        .iter()
        .map(|(key, value)| Ok((self::name(key, span)?, value.as_str().into())));
    let assembly = Assembly {
        name,
        kind: self::name(form.kind.get_ref(), &form.kind.span())?,
        title: form.title.as_deref().map(Into::into),
        direction: first.and_then(|message| message.direction(&database.nodes)),
        constants: constants.collect::<Result<_, Fault>>()?,
        fields,
        raw: form.raw.as_ref().map(|raw| self::name(raw.get_ref(), &raw.span())).transpose()?,
        head,
        parts,
        timeout: form.timeout_ms.map(|ms| ms.saturating_mul(1_000_000)),
    };
    unique(&assembly, span)?;
    Ok(assembly)
}

/// Every name is a key of the same JSON object.
fn unique(assembly: &Assembly, span: &Range<usize>) -> Result<(), Fault> {
    let mut names: HashSet<&str> =
        ["time", "bus", "assembly", "complete", "dir"].into_iter().collect();
    let labels = assembly.fields.iter().filter_map(|field| field.label.as_ref());
    let fields = assembly.fields.iter().map(|field| &field.plan.name);
    let constants = assembly.constants.iter().map(|(name, _)| name);
    for name in constants.chain(fields).chain(labels).chain(&assembly.raw) {
        if !names.insert(name) {
            let text = format!("the name \"{name}\" is used twice; expected it once");
            return Err(Fault::at(span.clone(), text));
        }
    }
    Ok(())
}

/// Takes the last field away if it repeats: its type ends in `[]`.
fn repeated(
    forms: &mut Vec<Spanned<FieldForm>>,
    context: &Context<'_>,
) -> Result<Option<Arc<FieldPlan>>, Fault> {
    let element = forms.last().and_then(|last| last.get_ref().kind.strip_suffix("[]"));
    let Some(element) = element.map(str::to_owned) else { return Ok(None) };
    let Some(mut last) = forms.pop() else { return Ok(None) };
    last.get_mut().kind = element;
    let span = last.span();
    let plan = context.payload(&[last])?.fields.into_iter().next();
    match plan {
        Some(plan) if plan.size.is_some() => Ok(Some(plan)),
        _ => Err(Fault::at(span, "a repeated field; expected a type with a size")),
    }
}

fn fields(
    form: &AssemblyForm,
    head: &Payload,
    repeated: Option<Arc<FieldPlan>>,
) -> Result<Vec<AssemblyField>, Fault> {
    let single = head.fields.iter().map(|plan| (plan.clone(), false));
    let all = single.chain(repeated.map(|plan| (plan, true)));
    let mut fields: Vec<AssemblyField> =
        all.map(|(plan, repeated)| AssemblyField { plan, repeated, label: None }).collect();
    for (field, label) in &form.labels {
        let known: Vec<&str> = fields
            .iter()
            .filter(|field| field.plan.values.is_some() && !field.repeated)
            .map(|field| &*field.plan.name)
            .collect();
        let Some(at) = fields
            .iter()
            .position(|known| &*known.plan.name == field && known.plan.values.is_some())
        else {
            let text = format!(
                "there is no field \"{field}\" with values; expected {}",
                one_of(&known, "one")
            );
            return Err(Fault::at(label.span(), text));
        };
        fields[at].label = Some(name(label.get_ref(), &label.span())?);
    }
    Ok(fields)
}

fn parts(
    form: &AssemblyForm,
    span: &Range<usize>,
    head: &Payload,
    database: &Database,
) -> Result<Parts, Fault> {
    match (form.messages.as_slice(), &form.first, &form.number, &form.length) {
        (messages @ [_, _, ..], None, None, None) => listed(messages, span, database),
        ([], Some(first), Some(number), Some(length)) => {
            let declared = &database.messages[message(first, database)?];
            let mask = *number.get_ref();
            let shifted = u64::from(mask) >> mask.trailing_zeros().min(31);
            let widest = if declared.extended { 0x1FFF_FFFF } else { 0x7FF };
            if mask == 0 || mask & !widest != 0 || !(shifted + 1).is_power_of_two() {
                let text = format!(
                    "number {mask:#x}; expected neighbouring bits of the identifier, like 0xFF"
                );
                return Err(Fault::at(number.span(), text));
            }
            let (wanted, add) = (&length.get_ref().field, length.get_ref().add);
            let field = head
                .fields
                .iter()
                .find(|field| *field.name == **wanted && field.kind == FieldType::Unsigned);
            let within = usize::from(declared.length);
            let field = field.filter(|field| field.at + field.size.unwrap_or(0) <= within);
            let Some(field) = field.cloned() else {
                let text = format!(
                    "length \"{wanted}\"; expected an unsigned field that lies in the first frame"
                );
                return Err(Fault::at(length.span(), text));
            };
            Ok(Parts::Counted {
                base: key(declared.id, declared.extended) & !mask,
                mask,
                first: (declared.id & mask) >> mask.trailing_zeros(),
                length: (field, add),
            })
        }
        _ => {
            let text = "an assembly; expected messages (two at least), or first, number and length";
            Err(Fault::at(span.clone(), text))
        }
    }
}

fn listed(
    messages: &[Spanned<String>],
    span: &Range<usize>,
    database: &Database,
) -> Result<Parts, Fault> {
    let mut list = Vec::new();
    let mut total = 0;
    for spanned in messages {
        let index = message(spanned, database)?;
        let length = usize::from(database.messages[index].length);
        if length == 0 || list.iter().any(|(other, _)| *other == index) {
            let text = format!(
                "\"{}\" is empty or stands twice; expected different messages with data",
                spanned.get_ref()
            );
            return Err(Fault::at(spanned.span(), text));
        }
        total += length;
        list.push((index, length));
    }
    if total > LONGEST {
        let text = format!("an assembly of {total} bytes; expected {LONGEST} at most");
        return Err(Fault::at(span.clone(), text));
    }
    Ok(Parts::Listed(list))
}
