//! The lines of a text of any length, from a buffer of fixed size.

use std::io::{self, ErrorKind, Read};
use std::ops::Range;

use super::Skipped;

/// The longest line that can be a frame: 64 bytes of data and everything that tools write behind
/// them are below 1 KiB. Of a longer line only the beginning is given.
const MAX_LINE: usize = 16 << 10;
/// Read at once.
const BUFFER: usize = 256 << 10;

/// A line, without its end and the blanks before that.
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    /// Its number, from 1.
    pub number: u64,
    /// What stands in it.
    pub text: &'a [u8],
}

/// Gives one line after another.
pub struct Lines {
    input: Box<dyn Read>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    number: u64,
    ended: bool,
    /// The rest of a line that was too long is passed over.
    skipping: bool,
    whole: bool,
    trouble: Option<String>,
}

impl Lines {
    /// The lines of `input`.
    pub fn new(input: Box<dyn Read>) -> Self {
        Self {
            input,
            buffer: vec![0; BUFFER],
            start: 0,
            end: 0,
            number: 0,
            ended: false,
            skipping: false,
            whole: true,
            trouble: None,
        }
    }

    /// Says how the text ended, if not as it should.
    pub fn report_end(&self, skipped: &mut Skipped, notes: &mut Vec<String>) {
        if let Some(trouble) = &self.trouble {
            skipped.add(|| format!("after line {}", self.number), || trouble.clone());
        } else if !self.whole {
            notes.push("the last line has no end: the log may have been cut off in it".to_owned());
        }
    }

    /// The next line.
    ///
    /// # Errors
    /// The input gives no more bytes.
    pub fn next_line(&mut self) -> io::Result<Option<Line<'_>>> {
        // So far there is no end of line in what was searched.
        let mut searched = 0;
        loop {
            let open = &self.buffer[self.start + searched..self.end];
            if let Some(at) = memchr::memchr(b'\n', open) {
                let line = self.start..self.start + searched + at;
                self.start = line.end + 1;
                if std::mem::take(&mut self.skipping) {
                    searched = 0;
                    continue;
                }
                self.number += 1;
                let line = line.start..line.end.min(line.start + MAX_LINE);
                return Ok(Some(self.line(line)));
            }
            searched = self.end - self.start;
            if self.skipping {
                (self.start, self.end, searched) = (0, 0, 0);
            } else if searched >= MAX_LINE {
                let line = self.start..self.start + MAX_LINE;
                self.start = self.end;
                self.skipping = true;
                self.number += 1;
                return Ok(Some(self.line(line)));
            }
            if self.ended {
                let line = self.start..self.end;
                self.start = self.end;
                if trimmed(&self.buffer[line.clone()]).is_empty() {
                    return Ok(None);
                }
                self.whole = false;
                self.number += 1;
                return Ok(Some(self.line(line)));
            }
            self.fill()?;
        }
    }

    fn line(&self, place: Range<usize>) -> Line<'_> {
        Line { number: self.number, text: trimmed(&self.buffer[place]) }
    }

    fn fill(&mut self) -> io::Result<()> {
        self.buffer.copy_within(self.start..self.end, 0);
        (self.start, self.end) = (0, self.end - self.start);
        match self.input.read(&mut self.buffer[self.end..]) {
            Ok(0) => self.ended = true,
            Ok(count) => self.end += count,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            // What a damaged compressed file gave before the damage is good.
            Err(error)
                if matches!(error.kind(), ErrorKind::InvalidData | ErrorKind::UnexpectedEof) =>
            {
                self.trouble = Some(error.to_string());
                self.ended = true;
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }
}

fn trimmed(line: &[u8]) -> &[u8] {
    let end = line.iter().rposition(|byte| !matches!(byte, b' ' | b'\t' | b'\r'));
    &line[..end.map_or(0, |at| at + 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives a few bytes at a time.
    struct Drops(Vec<u8>, usize);

    impl Read for Drops {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            let count = self.0.len().min(self.1).min(into.len());
            into[..count].copy_from_slice(&self.0[..count]);
            self.0.drain(..count);
            Ok(count)
        }
    }

    #[test]
    fn lines_come_out_the_same_however_the_bytes_come_in() {
        let long = "x".repeat(3 * MAX_LINE);
        let text = format!("one\r\n\n  two \t\n{long}\nlast");
        for step in [1, 7, 1000, 1 << 20] {
            let mut lines = Lines::new(Box::new(Drops(text.clone().into_bytes(), step)));
            let mut found = Vec::new();
            while let Some(Line { number, text }) = lines.next_line().unwrap() {
                found.push((number, String::from_utf8(text.to_vec()).unwrap()));
            }
            let cut = "x".repeat(MAX_LINE);
            let expected = [(1, "one"), (2, ""), (3, "  two"), (4, &cut), (5, "last")];
            let expected = expected.map(|(number, line)| (number, line.to_owned()));
            assert_eq!(found, expected, "{step}");
            let mut notes = Vec::new();
            lines.report_end(&mut Skipped::default(), &mut notes);
            assert_eq!(notes.len(), 1);
        }
    }
}
