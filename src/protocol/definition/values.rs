//! Names, numbers and value tables as a definition writes them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use super::super::error::Fault;
use super::super::word::Values;
use super::{Table, ValuesForm};

/// Named tables of a definition.
pub type Tables = BTreeMap<String, Arc<Values>>;

/// Names become names in JSON, in recordings and in columns.
pub fn name(name: &str, span: &Range<usize>) -> Result<Arc<str>, Fault> {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if !name.is_empty()
        && name.len() <= 100
        && name.chars().all(good)
        && !name.starts_with(|c: char| c.is_ascii_digit())
    {
        return Ok(name.into());
    }
    let text = format!(
        "\"{name}\" cannot be a name; expected letters a-z, digits and _, no digit first, at most \
         100 characters"
    );
    Err(Fault::at(span.clone(), text))
}

/// A table whose keys are numbers.
pub fn table(table: &Table, span: &Range<usize>) -> Result<Arc<Values>, Fault> {
    let mut values = Values::new();
    for (key, name) in table {
        let number = number(key).ok_or_else(|| {
            let text = format!("\"{key}\" is not a number; expected one like 20 or 0x14");
            Fault::at(span.clone(), text)
        })?;
        if let Some(other) = values.insert(number, name.as_str().into()) {
            let text = format!("{number} is both \"{other}\" and \"{name}\"; expected one name");
            return Err(Fault::at(span.clone(), text));
        }
    }
    Ok(Arc::new(values))
}

fn number(key: &str) -> Option<u64> {
    match key.strip_prefix("0x") {
        Some(digits) => u64::from_str_radix(digits, 16).ok(),
        None => key.parse().ok(),
    }
}

/// A table by name, or written in place. `kind` is the table of tables: `values` or `flags`.
pub fn resolve(
    form: Option<&ValuesForm>,
    tables: &Tables,
    kind: &str,
    span: &Range<usize>,
) -> Result<Option<Arc<Values>>, Fault> {
    match form {
        None => Ok(None),
        Some(ValuesForm::Table(written)) => table(written, span).map(Some),
        Some(ValuesForm::Name(name)) => tables.get(name).cloned().map(Some).ok_or_else(|| {
            let known: Vec<&str> = tables.keys().map(String::as_str).collect();
            let text = format!(
                "there is no table [{kind}.{name}]; expected {}",
                one_of(&known, "a table written in place")
            );
            Fault::at(span.clone(), text)
        }),
    }
}

/// `one of a, b, c`, or what to say when there is nothing to choose from.
pub fn one_of(names: &[&str], otherwise: &str) -> String {
    if names.is_empty() { otherwise.to_owned() } else { format!("one of {}", names.join(", ")) }
}
