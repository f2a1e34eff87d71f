//! What was odd about a file, and what was done about it.

/// So many are kept; the others are counted. A hostile file may have millions.
const KEPT: usize = 1000;

/// One thing that was not as it should be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Oddity {
    /// Line in the file, from 1.
    pub line: u32,
    /// What it is and what was done.
    pub text: String,
    /// Something the file says could not be loaded.
    pub lost: bool,
}

/// The oddities of a file.
#[derive(Debug, Default)]
pub struct Oddities {
    list: Vec<Oddity>,
    unlisted: u64,
    lost: u64,
}

impl Oddities {
    /// Something was read in another way than it is written.
    pub fn note(&mut self, line: u32, text: impl FnOnce() -> String) {
        self.add(line, false, text);
    }

    /// Something could not be loaded.
    pub fn lose(&mut self, line: u32, text: impl FnOnce() -> String) {
        self.lost += 1;
        self.add(line, true, text);
    }

    // The text is made only when it is kept.
    fn add(&mut self, line: u32, lost: bool, text: impl FnOnce() -> String) {
        if self.list.len() < KEPT {
            self.list.push(Oddity { line, text: text(), lost });
        } else {
            self.unlisted += 1;
        }
    }

    /// In the order of lines, as far as they were kept.
    pub fn list(&self) -> &[Oddity] {
        &self.list
    }

    /// How many are not in the list because there are too many.
    pub fn unlisted(&self) -> u64 {
        self.unlisted
    }

    /// How many of all are losses.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    pub(super) fn sort(&mut self) {
        self.list.sort_by_key(|oddity| oddity.line);
    }
}
