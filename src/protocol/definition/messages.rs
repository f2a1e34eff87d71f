//! Compiles directions, checks, kinds of messages and pairing.

use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;

use super::super::condition::{Condition, Side, Subject};
use super::super::encoder::ErrorAnswer;
use super::super::error::Fault;
use super::super::pairing::PairingRules;
use super::super::word::{Block, Quantity};
use super::super::{CheckRule, DirectionRule, MessageRules};
use super::framing::header_number;
use super::values::{Tables, name, one_of};
use super::{
    Carries, CheckForm, ConditionForm, DirectionForm, ErrorAnswerForm, MessageForm, OneOrMany,
    PairingForm, Scalar, words,
};

/// Most data of an error answer, in bytes.
const LONGEST_ANSWER: usize = 256;

/// Compiles `[direction]`.
pub(in crate::protocol) fn direction(
    form: &Spanned<DirectionForm>,
    header: &Block,
) -> Result<DirectionRule, Fault> {
    let (form, span) = (form.get_ref(), form.span());
    match (form.by.as_str(), &form.request, &form.response) {
        ("line", None, None) => Ok(DirectionRule::Line),
        ("line", ..) => {
            Err(Fault::at(span, "direction by line; expected neither request nor response"))
        }
        (field, Some(request), Some(response)) => {
            let index = header_number(header, field, &span)?;
            let quantity = &header.quantities[index];
            let request = number(request, quantity, &span)?;
            let response = number(response, quantity, &span)?;
            if request == response {
                let text = "requests and responses with the same value; expected two values";
                return Err(Fault::at(span, text));
            }
            Ok(DirectionRule::Number(index, request, response))
        }
        (field, ..) => {
            let text =
                format!("direction by \"{field}\"; expected the values request and response");
            Err(Fault::at(span, text))
        }
    }
}

/// A number, or the number with that name.
fn number(scalar: &Scalar, quantity: &Quantity, span: &Range<usize>) -> Result<u64, Fault> {
    let wanted = match scalar {
        Scalar::Number(number) => return Ok(*number),
        Scalar::Name(wanted) => wanted,
    };
    let values = quantity.values.iter().flat_map(|values| values.iter());
    let found = values.clone().find(|(_, name)| &***name == wanted).map(|(number, _)| *number);
    found.ok_or_else(|| {
        let names: Vec<&str> = values.map(|(_, name)| &**name).collect();
        let text = format!(
            "\"{wanted}\" is not a value of \"{}\"; expected {}",
            quantity.name,
            one_of(&names, "a number")
        );
        Fault::at(span.clone(), text)
    })
}

/// Compiles a condition over numbers in some order.
fn condition(
    form: &ConditionForm,
    numbers: &[Arc<Quantity>],
    span: &Range<usize>,
) -> Result<Condition, Fault> {
    let mut terms = Vec::new();
    for (field, wanted) in form {
        let wanted = match wanted {
            OneOrMany::One(one) => std::slice::from_ref(one),
            OneOrMany::Many(many) => many,
        };
        let mut values = Vec::new();
        let subject = if field == "side" {
            for scalar in wanted {
                values.push(side(scalar, span)?);
            }
            Subject::Side
        } else {
            let index = find(numbers, field, span)?;
            for scalar in wanted {
                values.push(number(scalar, &numbers[index], span)?);
            }
            Subject::Number(index)
        };
        terms.push((subject, values));
    }
    Ok(Condition { terms })
}

fn side(scalar: &Scalar, span: &Range<usize>) -> Result<u64, Fault> {
    [Side::Request, Side::Response]
        .into_iter()
        .find(|side| matches!(scalar, Scalar::Name(name) if name == side.name()))
        .map(|side| side as u64)
        .ok_or_else(|| Fault::at(span.clone(), "side; expected \"request\" or \"response\""))
}

fn find(numbers: &[Arc<Quantity>], field: &str, span: &Range<usize>) -> Result<usize, Fault> {
    numbers.iter().position(|quantity| &*quantity.name == field).ok_or_else(|| {
        let names: Vec<&str> = numbers.iter().map(|quantity| &*quantity.name).collect();
        let known = one_of(&names, "a [[header]] or prefix that has it");
        Fault::at(span.clone(), format!("there is no number \"{field}\"; expected {known}"))
    })
}

/// Compiles `[[check]]`.
pub(in crate::protocol) fn check(
    form: &Spanned<CheckForm>,
    header: &Block,
) -> Result<CheckRule, Fault> {
    let (form, span) = (form.get_ref(), form.span());
    if form.when.is_empty() && form.unless.is_empty() {
        return Err(Fault::at(span, "a check without a condition; expected when or unless"));
    }
    Ok(CheckRule {
        name: name(&form.name, &span)?,
        when: condition(&form.when, &header.quantities, &span)?,
        unless: condition(&form.unless, &header.quantities, &span)?,
    })
}

/// Compiles `[request]`, `[response]` or `[report]`. `unnamed` is what the data are when there are
/// no operations; `operations` their names.
pub(in crate::protocol) fn message(
    form: &Spanned<MessageForm>,
    header: &Block,
    tables: &Tables,
    unnamed: Option<Carries>,
    operations: &[&str],
) -> Result<MessageRules, Fault> {
    let (form, span) = (form.get_ref(), form.span());
    let prefix = words::block(&form.prefix, 0, tables)?;
    let numbers: Vec<_> = header.quantities.iter().chain(&prefix.quantities).cloned().collect();
    let place = |field: &String| find(&numbers, field, &span);
    let operation = form.operation.as_ref().map(place).transpose()?;
    if let Some(index) = operation {
        let values = numbers[index].values.iter().flat_map(|values| values.values());
        for label in values {
            if !operations.contains(&&**label) {
                let known = one_of(operations, &format!("a table [operation.{label}]"));
                let text = format!("there is no operation \"{label}\"; expected {known}");
                return Err(Fault::at(span, text));
            }
        }
    }
    Ok(MessageRules {
        when: condition(&form.when, &header.quantities, &span)?,
        command: form.command.as_ref().map(place).transpose()?,
        operation,
        unnamed,
        ok: condition(&form.ok, &numbers, &span)?,
        prefix,
    })
}

/// Compiles `[error_answer]`.
pub(in crate::protocol) fn error_answer(
    form: &Spanned<ErrorAnswerForm>,
    header: &Block,
) -> Result<ErrorAnswer, Fault> {
    let (form, span) = (form.get_ref(), form.span());
    if form.data.len() > LONGEST_ANSWER {
        let text = format!(
            "an error answer with {} bytes of data; expected {LONGEST_ANSWER} at most",
            form.data.len()
        );
        return Err(Fault::at(span, text));
    }
    let mut set = Vec::new();
    for (field, value) in &form.set {
        let index = header_number(header, field, &span)?;
        set.push((index, number(value, &header.quantities[index], &span)?));
    }
    Ok(ErrorAnswer { set, data: form.data.clone() })
}

/// Compiles `[pairing]`.
pub(in crate::protocol) fn pairing(
    form: &Spanned<PairingForm>,
    header: &Block,
) -> Result<PairingRules, Fault> {
    let (form, span) = (form.get_ref(), form.span());
    let slot = header_number(header, &form.slot, &span)?;
    // One request waits in each slot, so their number bounds the memory.
    if header.quantities[slot].width > 16 {
        let text = format!("\"{}\" has more than 16 bits; expected at most 16", form.slot);
        return Err(Fault::at(span, text));
    }
    let (mut same, mut sequence) = (Vec::new(), Vec::new());
    for rule in &form.same {
        let index = header_number(header, &rule.field, &span)?;
        same.push((index, rule.reason.as_str().into()));
        if rule.sequence {
            sequence.push(index);
        }
    }
    Ok(PairingRules { slot, common: form.common.clone(), same, sequence })
}
