//! Lines on their way into a file, written many at a time.

use std::io::{self, Write};

/// Written at once.
const BUFFER: usize = 64 << 10;
/// Longer than any line.
const LINE: usize = 1 << 10;

/// What is written, and where to.
pub struct Lines<W> {
    out: W,
    buffer: Vec<u8>,
}

impl<W> Lines<W> {
    /// An empty text.
    pub fn new(out: W) -> Self {
        Self { out, buffer: Vec::with_capacity(BUFFER + LINE) }
    }

    /// Where the next bytes are added.
    pub fn text(&mut self) -> &mut Vec<u8> {
        &mut self.buffer
    }
}

impl<W: Write> Lines<W> {
    /// Ends a line with `end`.
    pub fn end(&mut self, end: &[u8]) -> io::Result<()> {
        self.buffer.extend_from_slice(end);
        if self.buffer.len() < BUFFER {
            return Ok(());
        }
        self.out.write_all(&self.buffer)?;
        self.buffer.clear();
        Ok(())
    }

    /// Writes what is left.
    pub fn finish(&mut self) -> io::Result<()> {
        self.out.write_all(&self.buffer)?;
        self.buffer.clear();
        self.out.flush()
    }
}
