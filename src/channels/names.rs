//! Names that protobuf and its many readers accept.

use std::collections::{HashMap, HashSet};

/// Longest name that is made of a text.
const LONGEST: usize = 120;

/// Names that readers in JavaScript cannot have as keys of an object.
const TAKEN: [&str; 2] = ["__proto__", "constructor"];

/// The text as an identifier: letters and digits of ASCII, `_` for any run of others, none of them
/// at the ends. Empty when nothing is left.
pub fn identifier(text: &str) -> String {
    let mut name = String::with_capacity(text.len().min(LONGEST) + 1);
    let mut gap = false;
    for char in text.chars() {
        if name.len() >= LONGEST {
            break;
        }
        if !(char.is_ascii_alphanumeric() || char == '_') {
            gap = !name.is_empty();
            continue;
        }
        if std::mem::take(&mut gap) {
            name.push('_');
        }
        if name.is_empty() && char.is_ascii_digit() {
            name.push('_');
        }
        name.push(char);
    }
    if TAKEN.contains(&name.as_str()) {
        name.push('_');
    }
    name
}

/// The names of one scope. Those that differ only by case or by `_` count as the same: proto3 wants
/// the names of fields to differ as lower camel case, and those of enum values in any case.
#[derive(Debug, Default)]
pub struct Scope {
    exact: HashSet<String>,
    similar: HashSet<String>,
    /// The last number given to each name, so that many of one name do not take the square of it.
    numbers: HashMap<String, u64>,
    /// What a reader may strip off the front.
    prefix: &'static str,
}

impl Scope {
    /// A scope of values of an enum whose name, which is taken, some readers strip off.
    pub fn of_enum(name: &'static str) -> Self {
        let exact = HashSet::from([name.to_owned()]);
        Self { exact, prefix: name, ..Self::default() }
    }

    /// `name`, or the first free of `name_2`, `name_3` and so on.
    pub fn take(&mut self, name: &str) -> String {
        self.first_free(name, |scope, name| {
            let key = scope.key(name);
            if scope.exact.contains(name) || scope.similar.contains(&key) {
                return false;
            }
            scope.similar.insert(key)
        })
    }

    /// The same where only the same name is one, as for types.
    pub fn take_exact(&mut self, name: &str) -> String {
        self.first_free(name, |scope, name| !scope.exact.contains(name))
    }

    fn first_free(&mut self, name: &str, mut free: impl FnMut(&mut Self, &str) -> bool) -> String {
        let mut candidate = name.to_owned();
        while !free(self, &candidate) {
            let number = self.numbers.entry(name.to_owned()).or_insert(1);
            *number += 1;
            candidate = format!("{name}_{number}");
        }
        self.exact.insert(candidate.clone());
        candidate
    }

    fn key(&self, name: &str) -> String {
        let plain = |text: &str| -> String {
            text.chars().filter(|c| *c != '_').map(|c| c.to_ascii_lowercase()).collect()
        };
        let key = plain(name);
        let prefix = plain(self.prefix);
        match key.strip_prefix(&prefix) {
            Some(rest) if !prefix.is_empty() && !rest.is_empty() => rest.to_owned(),
            _ => key,
        }
    }
}
