//! The buses of a log, in the order of first mention.

/// Most buses of one log: a text that is no log must not fill the memory with names.
const MOST: usize = 256;
/// Characters of a name that are kept: a file may call a bus whatever it likes at any length.
const LONGEST: usize = 64;

/// Finds the index of a bus by its name.
#[derive(Debug, Default)]
pub struct Names {
    names: Vec<String>,
    /// Most frames are on the bus of the frame before.
    last: u16,
}

impl Names {
    /// The names.
    pub fn list(&self) -> &[String] {
        &self.names
    }

    /// The index of a name, of which the first 64 characters count; a new one is appended.
    /// The error says why it cannot be.
    pub fn index(&mut self, name: &str) -> Result<u16, String> {
        let end = name.char_indices().nth(LONGEST).map_or(name.len(), |(end, _)| end);
        let name = &name[..end];
        if self.names.get(usize::from(self.last)).is_some_and(|last| last == name) {
            return Ok(self.last);
        }
        let found = self.names.iter().position(|known| known == name);
        if found.is_none() && self.names.len() == MOST {
            return Err(format!(
                "bus \"{}\" would be one of more than {MOST}",
                name.escape_debug()
            ));
        }
        let index = found.unwrap_or(self.names.len());
        if found.is_none() {
            self.names.push(name.to_owned());
        }
        #[allow(clippy::cast_possible_truncation, reason = "at most MOST")]
        let index = index as u16;
        self.last = index;
        Ok(index)
    }

    /// The index of a bus that the log gives a number.
    pub fn numbered(&mut self, number: u64) -> Result<u16, String> {
        // Without a String for the number of the frame before.
        let last = self.names.get(usize::from(self.last)).map(String::as_bytes);
        if last.and_then(super::digits::decimal) == Some(number) {
            return Ok(self.last);
        }
        self.index(&number.to_string())
    }
}
