//! Compiles `[[answer]]`.

use std::ops::Range;

use toml::Spanned;

use super::forms::{AssemblyForm, RulesForm};
use crate::decode::answers::{AnswerRule, FramePattern};
use crate::decode::dbc::Database;
use crate::decode::definition::RemoteMessage;
use crate::protocol::definition::OneOrMany;
use crate::protocol::error::Fault;

/// All bits of an identifier.
const ALL: u32 = 0x1FFF_FFFF;

/// Compiles all of them.
pub fn compile(
    form: &RulesForm,
    database: &Database,
    remotes: &[RemoteMessage],
) -> Result<Vec<AnswerRule>, Fault> {
    let mut rules = Vec::new();
    for rule in &form.answer {
        let rule = rule.get_ref();
        let names = |field: &Spanned<OneOrMany<String>>| match field.get_ref() {
            OneOrMany::One(name) => vec![name.clone()],
            OneOrMany::Many(names) => names.clone(),
        };
        let patterns = |field: &Spanned<OneOrMany<String>>| {
            let mut all = Vec::new();
            for name in names(field) {
                all.extend(patterns(&name, &field.span(), form, database, remotes)?);
            }
            Ok::<_, Fault>(all)
        };
        rules.push(AnswerRule {
            name: names(&rule.request).join(", "),
            request: patterns(&rule.request)?,
            answer: patterns(&rule.answer)?,
        });
    }
    Ok(rules)
}

/// The frames of a message of the database, of a remote message or of an assembly.
fn patterns(
    name: &str,
    span: &Range<usize>,
    form: &RulesForm,
    database: &Database,
    remotes: &[RemoteMessage],
) -> Result<Vec<FramePattern>, Fault> {
    if let Some(remote) = remotes.iter().find(|remote| remote.name == name) {
        let (id, extended) = (remote.id, remote.extended);
        return Ok(vec![FramePattern { id, mask: ALL, extended, remote: true }]);
    }
    let data = |name: &str, mask: u32| {
        let message = database.messages.iter().find(|message| message.name == name)?;
        let (id, extended) = (message.id, message.extended);
        Some(FramePattern { id, mask, extended, remote: false })
    };
    if let Some(pattern) = data(name, ALL) {
        return Ok(vec![pattern]);
    }
    let assembly = form.assembly.iter().map(Spanned::get_ref).find(|a| a.name.get_ref() == name);
    let parts: Vec<FramePattern> = match assembly {
        Some(AssemblyForm { first: Some(first), number, .. }) => {
            let mask = ALL & !number.as_ref().map_or(0, |number| *number.get_ref());
            data(first.get_ref(), mask).into_iter().collect()
        }
        Some(AssemblyForm { messages, .. }) => {
            messages.iter().filter_map(|message| data(message.get_ref(), ALL)).collect()
        }
        None => Vec::new(),
    };
    if parts.is_empty() {
        let text = format!(
            "there is no message \"{name}\"; expected one of the DBC file, a [[remote]] or an \
             [[assembly]]"
        );
        return Err(Fault::at(span.clone(), text));
    }
    Ok(parts)
}
