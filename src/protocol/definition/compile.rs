//! From the text of a definition to a protocol.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use toml::Spanned;

use super::super::error::Fault;
use super::super::message::Command;
use super::super::{Operation, Protocol, Settings};
use super::payloads::Context;
use super::values::{self, Tables};
use super::{Carries, Definition, Table, framing, messages};

/// Longest definition, in bytes.
pub const LONGEST: usize = 4 << 20;

/// Most fields of all commands.
const MOST_FIELDS: usize = 1 << 16;

/// Compiles a definition.
pub fn protocol(text: &str, settings: Settings) -> Result<Protocol, Fault> {
    if text.len() > LONGEST {
        let text = format!("a definition of {} bytes; expected {LONGEST} at most", text.len());
        return Err(Fault { span: None, text });
    }
    let definition: Definition = toml::from_str(text)?;
    let values = tables(&definition.values)?;
    let flags = tables(&definition.flags)?;
    let framing = framing::framing(&definition, &values)?;
    let header = &framing.layout.header;
    let order = settings.byte_order.unwrap_or(definition.byte_order);
    let context = Context { values: &values, flags: &flags, order, assume: settings.assume };
    let commands = commands(&definition, &context)?;
    let names: Vec<&str> = definition.operation.keys().map(String::as_str).collect();
    let unnamed = |carries| names.is_empty().then_some(carries);
    let message = |form: &Option<_>, carries| {
        form.as_ref()
            .map(|form| messages::message(form, header, &values, carries, &names))
            .transpose()
    };
    let request = message(&definition.request, unnamed(Carries::Args))?;
    let response = message(&definition.response, unnamed(Carries::Fields))?;
    let report = message(&definition.report, Some(Carries::Fields))?;
    let link = definition.link.as_ref();
    let link = link.map(|link| framing::header_number(header, &link.get_ref().name, &link.span()));
    let operations = definition.operation.iter().map(|(name, form)| {
        (name.as_str().into(), Operation { request: form.request, response: form.response })
    });
    let protocol = Protocol {
        direction: definition
            .direction
            .as_ref()
            .map(|form| messages::direction(form, header))
            .transpose()?,
        checks: definition
            .check
            .iter()
            .map(|form| messages::check(form, header))
            .collect::<Result<_, _>>()?,
        operations: operations.collect(),
        only_operation: only(&names),
        link: link.transpose()?,
        pairing: definition
            .pairing
            .as_ref()
            .map(|form| messages::pairing(form, header))
            .transpose()?,
        error_answer: definition
            .error_answer
            .as_ref()
            .map(|form| messages::error_answer(form, header))
            .transpose()?,
        by_id: by_id(&definition, &commands)?,
        name: definition.name,
        title: definition.title,
        line: definition.line,
        commands,
        request,
        response,
        report,
        framing: Arc::new(framing),
    };
    sides(&protocol, definition.request.as_ref().or(definition.response.as_ref()))?;
    Ok(protocol)
}

fn only(names: &[&str]) -> Option<Arc<str>> {
    match names {
        [name] => Some((*name).into()),
        _ => None,
    }
}

/// Compiles `[values]` or `[flags]`.
pub fn tables(forms: &BTreeMap<String, Spanned<Table>>) -> Result<Tables, Fault> {
    forms
        .iter()
        .map(|(name, form)| Ok((name.clone(), values::table(form.get_ref(), &form.span())?)))
        .collect()
}

fn commands(definition: &Definition, context: &Context<'_>) -> Result<Vec<Arc<Command>>, Fault> {
    let (mut commands, mut fields) = (Vec::new(), 0);
    for form in &definition.command {
        let command = context.command(form)?;
        let by_data = form.get_ref().by_data.as_ref();
        let named = by_data.map(|rule| [&rule.from, &rule.to]);
        for name in form.get_ref().operations.iter().chain(named.into_iter().flatten()) {
            if !definition.operation.contains_key(name) {
                let known: Vec<&str> = definition.operation.keys().map(String::as_str).collect();
                let known = values::one_of(&known, &format!("a table [operation.{name}]"));
                let text = format!("there is no operation \"{name}\"; expected {known}");
                return Err(Fault::at(form.span(), text));
            }
        }
        fields += command.fields.fields.len() + command.args.fields.len();
        if fields > MOST_FIELDS {
            let text = format!("{fields} fields in all; expected {MOST_FIELDS} at most");
            return Err(Fault::at(form.span(), text));
        }
        commands.push(Arc::new(command));
    }
    Ok(commands)
}

fn by_id(
    definition: &Definition,
    commands: &[Arc<Command>],
) -> Result<HashMap<u64, Arc<Command>>, Fault> {
    let mut by_id: HashMap<u64, Arc<Command>> = HashMap::new();
    let mut names = HashSet::new();
    for (command, form) in commands.iter().zip(&definition.command) {
        if !names.insert(&command.name) {
            let text = format!("command \"{}\" stands twice; expected it once", command.name);
            return Err(Fault::at(form.span(), text));
        }
        if command.ids.is_empty() && commands.len() > 1 {
            let text = format!("command \"{}\" has no id; expected one", command.name);
            return Err(Fault::at(form.span(), text));
        }
        for id in &command.ids {
            if let Some(other) = by_id.insert(*id, command.clone()) {
                let text = format!(
                    "id {id:#06x} is \"{}\" and \"{}\"; expected one command",
                    other.name, command.name
                );
                return Err(Fault::at(form.span(), text));
            }
        }
    }
    Ok(by_id)
}

/// Requests and responses can only be told apart when something says who sent a frame.
fn sides(protocol: &Protocol, asked: Option<&Spanned<super::MessageForm>>) -> Result<(), Fault> {
    match asked {
        Some(form) if protocol.direction.is_none() => {
            let text = "requests and responses, but nothing says who sent a frame; expected \
                        [direction]";
            Err(Fault::at(form.span(), text))
        }
        _ => Ok(()),
    }
}
