//! Cuts what an adapter sends into lines.

/// Longer than any line of the protocol (CAN FD, 29 bits, 64 bytes, stamp: 146).
const LONGEST: usize = 200;

/// One line and how it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut<'a> {
    /// Ended by CR.
    Line(&'a [u8]),
    /// BELL: the adapter refused what it was asked.
    Refused,
    /// More bytes than a line can have; dropped up to the next end of a line.
    TooLong,
}

/// Collects bytes until a line is complete. Holds at most one line.
#[derive(Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
    too_long: bool,
}

impl Lines {
    /// Calls `take` for every line that `bytes` complete.
    pub fn feed(&mut self, bytes: &[u8], mut take: impl FnMut(Cut<'_>)) {
        for &byte in bytes {
            match byte {
                b'\r' if std::mem::take(&mut self.too_long) => take(Cut::TooLong),
                b'\r' => take(Cut::Line(&self.line)),
                0x07 => {
                    self.too_long = false;
                    take(Cut::Refused);
                }
                // Some firmware ends lines with CR LF.
                b'\n' => continue,
                _ if self.line.len() >= LONGEST => {
                    self.too_long = true;
                    continue;
                }
                _ => {
                    self.line.push(byte);
                    continue;
                }
            }
            self.line.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cut(reads: &[&[u8]]) -> Vec<String> {
        let (mut lines, mut all) = (Lines::default(), Vec::new());
        for read in reads {
            lines.feed(read, |cut| {
                all.push(match cut {
                    Cut::Line(line) => String::from_utf8_lossy(line).into_owned(),
                    Cut::Refused => "BELL".to_owned(),
                    Cut::TooLong => "TOO LONG".to_owned(),
                });
            });
            assert!(lines.line.len() <= LONGEST);
        }
        all
    }

    #[test]
    fn lines_end_with_cr_and_refusals_with_bell() {
        assert_eq!(cut(&[b"\rt10", b"00\r\x07\r\nF00\r\nz"]), ["", "t1000", "BELL", "", "F00"]);
        let flood = vec![b'A'; 1 << 20];
        assert_eq!(cut(&[&flood, b"\rt1000\r"]), ["TOO LONG", "t1000"]);
        assert_eq!(cut(&[&flood, b"\x07t1000\r"]), ["BELL", "t1000"]);
    }

    proptest! {
        #[test]
        fn cutting_does_not_depend_on_the_reads(
            bytes in "[tz0-9\r\n\u{7}]{0,300}", at in 0_usize..300,
        ) {
            let (head, tail) = bytes.as_bytes().split_at(at.min(bytes.len()));
            prop_assert_eq!(cut(&[head, tail]), cut(&[bytes.as_bytes()]));
        }
    }
}
