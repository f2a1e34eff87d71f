//! Names that are used once only.

use std::collections::HashMap;

/// The names given so far in one scope.
#[derive(Debug, Default)]
pub struct Names(HashMap<Box<str>, u32>);

impl Names {
    /// Takes `name`, or the first free of `name_2`, `name_3` and so on.
    pub fn take(&mut self, name: &str) -> String {
        if !self.0.contains_key(name) {
            self.0.insert(name.into(), 1);
            return name.to_owned();
        }
        loop {
            let number = self.0.get_mut(name).map_or(2, |number| {
                *number += 1;
                *number
            });
            let candidate = format!("{name}_{number}");
            if !self.0.contains_key(candidate.as_str()) {
                self.0.insert(candidate.as_str().into(), 1);
                return candidate;
            }
        }
    }
}
